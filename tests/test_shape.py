"""Each folder of the packages is a package, or holds data."""

from pathlib import Path

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")


def test_a_folder_with_modules_is_a_package():
    folders = {path.parent for package in PACKAGES for path in (PROJECT / package).rglob("*.py")}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []
