"""`hil`, also as `python -m hil`."""

from drive_profiles.cli.entry import start


def main() -> None:
    """Entry point of the console script."""
    start("hil")


if __name__ == "__main__":
    main()
