"""Each folder of the packages is a package, or holds data."""

from pathlib import Path

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")


def test_a_folder_with_modules_is_a_package():
    folders = {path.parent for package in PACKAGES for path in (PROJECT / package).rglob("*.py")}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_what_runs_a_module_stands_at_its_end():
    """Functions behind it do not exist yet when it runs."""
    guard = 'if __name__ == "__main__":'
    texts = {path: path.read_text("utf-8") for package in PACKAGES for path in (PROJECT / package).rglob("*.py")}
    behind = {path: text.partition(guard)[2].strip().splitlines()[1:] for path, text in texts.items() if guard in text}
    assert [path for path, lines in behind.items() if any(line and not line.startswith(" ") for line in lines)] == []
