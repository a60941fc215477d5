"""One idea has one word: what the glossary calls *never* is no name in code, and no word of the command line's help."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import typer

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")
PAGE = (PROJECT / "docs" / "glossary.md").read_text(encoding="utf-8")
NEVER = {
    word for line in PAGE.splitlines() if line.startswith("| **") for word in re.findall(r"`([a-z]+)`", line.rsplit("|", 2)[1])
}
"""The words of the column *never*, as they are marked there."""
ALLOWED: dict[str, set[str]] = {
    "correction": {"reference_correction"},  # a key of drive profiles: what a drive's maker calls it
    "place": {"place", "checksum_place"},  # keys of drive profiles and bench files
    "share": {"offset_share", "gear_reaction_share"},  # keys of robot files and of JSON that users have
    "tick": {"tick"},  # of a figure's axis
    "ticks": {"ticks"},
}
"""Names that have such a word for another idea, by word."""


@cache
def names() -> frozenset[tuple[str, str]]:
    """Every name that the packages define, and the file that does."""
    return frozenset(defined())


def defined() -> Iterator[tuple[str, str]]:
    for package in PACKAGES:
        for path in sorted((PROJECT / package).rglob("*.py")):
            where = path.relative_to(PROJECT).as_posix()
            yield where, path.stem
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    yield where, node.name
                elif isinstance(node, ast.arg):
                    yield where, node.arg
                elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
                    yield where, node.id if isinstance(node, ast.Name) else node.attr


def words(name: str) -> set[str]:
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def test_the_page_says_which_words_are_not_used():
    assert {"compensation", "corrector", "beat", "tick", "share", "personality", "place"} <= NEVER


@pytest.mark.ci
@pytest.mark.parametrize("word", sorted(NEVER))
def test_a_word_that_is_never_used_names_nothing(word):
    found = {(where, name) for where, name in names() if word in words(name) and name not in ALLOWED.get(word, set())}
    assert found == set()


@pytest.mark.parametrize("word", sorted(ALLOWED))
def test_what_is_allowed_is_used(word):
    assert ALLOWED[word] <= {name for _, name in names()}


def commands(group: typer.main.TyperGroup, path: str) -> Iterator[tuple[str, str]]:
    """The help of each command below a group, hidden options left out."""
    for name, command in group.commands.items():
        if isinstance(command, typer.main.TyperGroup):
            yield from commands(command, f"{path} {name}")
            continue
        options = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
        yield f"{path} {name}", " ".join([command.help or "", *(str(getattr(each, "help", "") or "") for each in options)])


@pytest.mark.ci
@pytest.mark.parametrize("tool", ["hil.cli.main", "drive_profiles.cli.main", "plant_emulator.cli.main"])
def test_the_help_has_none_of_them(tool):
    import importlib  # noqa: PLC0415 - the tools' own start-up is looked at elsewhere

    group = typer.main.get_group(importlib.import_module(tool).app)
    found = {
        (command, word)
        for command, text in commands(group, tool.split(".", maxsplit=1)[0])
        for word in NEVER & {part.lower() for part in re.findall(r"[A-Za-z]+", text)}
    }
    assert found == set()


SAME_IDEA = {"ExitStatus", "NodeError", "NoAnswerError", "SdoAbortedError"}
"""Classes of one name in two packages: the same idea, of each tool its own, or derived from one another."""


@pytest.mark.slow
def test_a_class_name_stands_for_one_class():
    places: dict[str, set[str]] = {}
    for package in PACKAGES:
        for path in sorted((PROJECT / package).rglob("*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places.setdefault(node.name, set()).add(path.relative_to(PROJECT).as_posix())
    assert {name for name, where in places.items() if len(where) > 1} == SAME_IDEA


SPELLINGS = {r"\brps\b": "rev/s", r"\brps/s\b": "rev/s²", r"(?<=\d )deg\b|^deg$": "°", r"(?<=\d )us\b": "µs"}
"""Spellings of units that people never read, and those that they do; names and keys of files end in _rps, _deg, _us."""


@pytest.mark.slow
@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_unit_has_one_spelling_in_what_people_read(spelling):
    found = []
    for package in PACKAGES:
        for path in sorted((PROJECT / package).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
            for node in ast.walk(tree):
                is_prose = isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped
                if is_prose and re.search(spelling, re.sub(r"--\S+|[a-z]+_rps", "", node.value)):
                    found.append(f"{path.relative_to(PROJECT).as_posix()}:{node.lineno}: {node.value!r}")
    assert [each for each in found if not each.startswith("drive_profiles/standard/shown.py")] == []
