"""Device descriptions of any vendor, EDS, DCF and XDD, read tolerantly: every repair is said, with its line."""

from drive_profiles.eds.description import Description, load, loads

__all__ = ["Description", "load", "loads"]
