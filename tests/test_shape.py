"""Shape of the tree: no folder, module or function is longer than a reader can hold, and the folder says where a file belongs."""

import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")
MODULES = [path for package in PACKAGES for path in sorted((PROJECT / package).rglob("*.py"))]
MOST_MODULES, LONGEST_MODULE, LONGEST_FUNCTION = 20, 450, 60
ROOMS_IN_NAMES = ("cli", "figures", "robustness", "vendor", "drive", "master", "page", "tables", "serial")
"""Words that once stood before the name of a file instead of in its path."""


def name_of(path: Path) -> str:
    return path.relative_to(PROJECT).as_posix()


def test_no_folder_has_more_modules_than_can_be_looked_over():
    folders = {path.parent for path in MODULES}
    counts = {name_of(folder): sum(path.parent == folder and path.stem != "__init__" for path in MODULES) for folder in folders}
    assert {name: count for name, count in counts.items() if count > MOST_MODULES} == {}


def test_no_module_is_too_long():
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert {name: length for name, length in lengths.items() if length > LONGEST_MODULE} == {}


@pytest.mark.slow
def test_no_function_is_too_long():
    lengths = {
        f"{name_of(path)}: {node.name}": node.end_lineno - node.lineno + 1
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None
    }
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}


@pytest.mark.parametrize("word", ROOMS_IN_NAMES)
def test_no_file_says_in_its_name_where_it_should_live(word):
    assert [name_of(path) for path in MODULES if path.stem.startswith(f"{word}_")] == []


def test_each_folder_of_the_packages_is_a_package_or_holds_data():
    folders = {path.parent for path in MODULES}
    assert [name_of(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []
