"""Shape of the drive's classes: every attribute is born in the constructor, and none has too many."""

import ast
from pathlib import Path

import pytest

import plant_emulator.drive

ROOM = Path(plant_emulator.drive.__file__).parent
MOST_ATTRIBUTES = 20


def classes():
    """Every class of the room with its definition, by name."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ROOM.rglob("*.py"))]
    return {node.name: node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}


def assigned(function):
    """Names of the attributes that a method assigns to `self`."""
    return {
        node.attr
        for node in ast.walk(function)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id == "self"
    }


def methods(definition):
    return [node for node in definition.body if isinstance(node, ast.FunctionDef)]


def born(definition, known):
    """Attributes of a class from its fields, its constructor and those of its bases in this room, and its setters."""
    names = {node.target.id for node in definition.body if isinstance(node, ast.AnnAssign)}
    for method in methods(definition):
        if method.name == "__init__" or any(
            isinstance(by, ast.Attribute) and by.attr == "setter" for by in method.decorator_list
        ):
            names |= assigned(method)
    for base in definition.bases:
        if isinstance(base, ast.Name) and base.id in known:
            names |= born(known[base.id], known)
    return names


@pytest.mark.slow
def test_no_attribute_is_born_outside_a_constructor():
    known = classes()
    late = {
        f"{name}.{attribute} in {method.name}"
        for name, definition in known.items()
        for method in methods(definition)
        for attribute in assigned(method) - born(definition, known)
    }
    assert not late


def test_a_drive_has_no_more_attributes_than_can_be_kept_in_mind():
    known = classes()
    assert len(born(known["Drive"], known)) <= MOST_ATTRIBUTES
