"""The command line ``drive-profiles``."""
