"""Units have one spelling in what people read; names and keys of files end in _rps, _deg, _us."""

import ast
import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")
SPELLINGS = {r"\brps\b": "rev/s", r"\brps/s\b": "rev/s²", r"(?<=\d )deg\b|^deg$": "°", r"(?<=\d )us\b": "µs"}
"""Spellings that people never read, and those that they do."""


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
