"""Each package and each room says in its `__init__` what it offers, with an example that runs."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

ROOTS = ("drive_profiles", "hil", "plant_emulator")
WITHOUT_EXAMPLE = {
    "drive_profiles.cli",
    "hil.cli",
    "plant_emulator.cli",
    "plant_emulator.pytest_plugin",
}
"""Rooms without an example: command lines, rooms that a user does not call, and rooms that still lack theirs."""


def packages():
    """The names of all packages, found by walking: a new room is covered at once."""
    for root in ROOTS:
        yield root
        paths = importlib.import_module(root).__path__
        yield from (found.name for found in pkgutil.walk_packages(paths, f"{root}.") if found.ispkg)


PACKAGES = sorted(packages())
ROOMS = [name for name in PACKAGES if name.count(".") <= 1]


@pytest.mark.ci
@pytest.mark.parametrize("name", PACKAGES)
def test_the_examples_of_a_face_run(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0, "the report is in the captured output"


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_has_an_example(name):
    has_example = ">>> " in (importlib.import_module(name).__doc__ or "")
    assert has_example == (name not in WITHOUT_EXAMPLE)


def test_the_list_of_rooms_without_an_example_names_rooms_that_are_there():
    assert set(ROOMS) >= WITHOUT_EXAMPLE


@pytest.mark.parametrize("name", PACKAGES)
def test_the_names_that_a_face_exports_are_there_and_have_a_docstring(name):
    package = importlib.import_module(name)
    exported = getattr(package, "__all__", [])
    assert sorted(exported) == sorted(set(exported))
    for each in exported:
        value = getattr(package, each)
        assert not callable(value) or value.__doc__, each


@pytest.mark.parametrize("root", ROOTS)
def test_a_package_tells_type_checkers_that_it_is_typed(root):
    assert Path(importlib.import_module(root).__file__).with_name("py.typed").is_file()
