"""The documents of the project: they cite the paper, and name only files that are here."""

import re
import tomllib
from pathlib import Path

import pytest

from hil.design.paper import CITATION

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [
    path
    for folder in ("drive_profiles", "hil", "plant_emulator", "tests", "benchmarks")
    for path in sorted((ROOT / folder).rglob("*.py"))
]
TITLE = "Vibration Suppression for Angular Transmission Errors in Harmonic Drive Gearings and Application to Industrial Robots"
LINK = re.compile(r"\]\((?!https?:|#|mailto:)([^)#]+)(?:#[^)]*)?\)")
OF_THE_PROJECT = re.compile(
    r"(?<![\w/.<{-])((?:docs|tests|hil|drive_profiles|plant_emulator|benchmarks|examples|\.ci)/[\w./-]+\.(?:md|py|toml|eds|svg|j2))\b"
)
ELSEWHERE = {"docs/yaml_config_guide.md"}
"""Files of other projects that a page cites as its source."""


@pytest.mark.parametrize("name", ["README.md", "docs/theory.md", "CITATION.cff"])
def test_the_paper_is_cited_with_title_authors_venue_and_year(name):
    words = " ".join((ROOT / name).read_text(encoding="utf-8").split())
    assert TITLE in words
    for fact in ("Iwasaki", "Nakamura", "IFAC", "2014"):
        assert fact in words


def test_every_report_cites_it():
    assert TITLE in CITATION
    for fact in ("Iwasaki", "Nakamura", "IFAC", "2014"):
        assert fact in CITATION
    assert "{{ citation }}" in (ROOT / "hil" / "report" / "pages" / "report.html.j2").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_links_only_to_what_is_here(page):
    missing = [target for target in LINK.findall(page.read_text(encoding="utf-8")) if not (page.parent / target).exists()]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_names_only_files_of_the_project_that_exist(page):
    named = set(OF_THE_PROJECT.findall(page.read_text(encoding="utf-8"))) - ELSEWHERE
    assert {name for name in named if not (ROOT / name).exists()} == set()


def test_code_and_tests_cite_only_documents_that_are_here():
    missing = {
        (str(path.relative_to(ROOT)), name)
        for path in SOURCES
        for name in re.findall(r"(?<![\w/.<{\"-])((?:docs)/[\w./-]+\.md)\b", path.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    }
    assert missing == set()


def test_the_readme_is_short_and_says_at_once_for_whom_it_is():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    without_links = re.sub(r"\]\([^)]*\)", " ", text)
    words = re.findall(r"[^\s|`*>#\[\]-][^\s|`*\[\]]*", without_links)
    assert len(words) <= 700
    assert {"robot", "arms", "CANopen", "vibration"} <= set(re.findall(r"\w+", " ".join(words[:60])))


@pytest.mark.parametrize("package", ["drive_profiles", "hil", "plant_emulator"])
def test_the_rooms_of_the_architecture_stand_in_the_layers_of_the_contracts(package):
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    [layers] = [each["layers"] for each in contracts if each.get("containers") == [package]]
    held = [set(layer.split(" | ")) - {"__main__"} for layer in reversed(layers)]
    text = (ROOT / "docs" / "architecture-rooms.md").read_text(encoding="utf-8")
    [section] = re.findall(rf"^## {package}:.*?(?=^## )", text, re.MULTILINE | re.DOTALL)
    shown = {}
    for number, rooms in re.findall(r"^\| (\d+) \| (.*?) \|", section, re.MULTILINE):
        shown.setdefault(int(number), set()).update(re.findall(r"`(\w+)/?`", rooms))
    assert shown == dict(enumerate(filter(None, held), start=1))
