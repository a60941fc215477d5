"""Pictures of the documents: named for those who do not see them, dark where the reader's screen is, and words as words."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

SVG = "{http://www.w3.org/2000/svg}"
PICTURES = sorted((Path(__file__).parents[1] / "docs").rglob("*.svg"))


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.name)
def test_a_picture_has_a_name_words_and_a_dark_side(path):
    text = path.read_text(encoding="utf-8")
    root = ElementTree.fromstring(text)  # noqa: S314 - our own
    by_id = {element.get("id"): element for element in root.iter() if element.get("id") is not None}
    for name in root.get("aria-labelledby").split():
        assert "".join(by_id[name].itertext()).strip()
    for reference in re.findall(r'(?:href="|url\()#([^")]+)', text):
        assert reference in by_id
    assert len(list(root.iter(f"{SVG}text"))) > 10
    assert "@media screen and (prefers-color-scheme: dark)" in text
    assert not re.search(r"#[0-9a-fA-F]{6}\b", text[text.index("</style>") :])


def test_there_are_pictures():
    assert {path.name for path in PICTURES} >= {"arm.svg", "bus.svg", "line.svg"}
