"""`plant-emulator`, also as `python -m plant_emulator`."""

from drive_profiles.cli.entry import start


def main() -> None:
    """Entry point of the console script."""
    start("plant_emulator")


if __name__ == "__main__":
    main()
