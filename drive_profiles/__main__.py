"""`drive-profiles`, also as `python -m drive_profiles`."""

from drive_profiles.cli.entry import start


def main() -> None:
    """Entry point of the console script."""
    start("drive_profiles")


if __name__ == "__main__":
    main()
