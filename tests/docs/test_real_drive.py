"""docs/real-drive.md followed word for word, from the box to a quiet axis, with drives that are not its example.

Its commands are typed as they stand there; the one line that says "your drive's profile" has another name. What the page has a
reader write into the bench file, this test writes as an editor does: from the page's own blocks.
"""

import json
import re
import tomllib

import pytest

from tests.docs.pages import ROOT, SERVER, blocks_in, commands_in

PAGE = ROOT / "docs" / "real-drive.md"
EXAMPLE = "harmonic_drive_yukondrive"
FAMILIES = {
    "maxon_epos2": "the maker's own position mode, a current in place of a torque, no counts",
    "kollmorgen_akd": "CSP, none of the limits held, no rated torque, no counts",
}
"""Drives by what sets them apart from the example, which has IP, a rated torque and counts.

Every family is moved, identified and cancelled by tests/bench/test_families.py.
"""
LIMIT_S = 900
BENCH, AS_FOUND = "bench.toml", 'control = "as found"'


def filled_in(text, values):
    """A bench file in which each line that is still to be typed has the page's value.

    Args:
        text: The file.
        values: The page's values, as they stand there, by dotted key.
    """
    table, lines = "", []
    for line in text.splitlines():
        if head := re.match(r"\[([\w.]+)\]", line):
            table = f"{head[1]}."
        key, _, value = line.partition(" = ")
        lines.append(f"{key} = {values[table + key]}" if value.startswith('"TYPE:') else line)
    return "\n".join(lines) + "\n"


def edited(text, block):
    """The bench file after what the page says to write into it."""
    if block.startswith("axis."):
        return filled_in(text, dict(line.split(" = ", 1) for line in block.splitlines()))
    (line,) = (line for line in text.splitlines(keepends=True) if line.startswith(AS_FOUND))
    return text.replace(line, block)


def tip_mm(folder):
    """The largest peak of the tip in any window that was judged, and whether all are within what the bench file asks."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    peaks = [run["tip_peak_mm"] for run in result["runs"] if run["tip_peak_mm"] is not None]
    assert peaks, f"{folder.name}: nothing was judged"
    return max(peaks), all(run["within_spec"] for run in result["runs"])


def held(folder, name):
    """What a pulled file says that the drive holds; its header has the date."""
    document = tomllib.loads((folder / name).read_text(encoding="utf-8"))
    return {key: table for key, table in document.items() if key != "header"}


def test_the_page_is_long_enough_for_one_sitting_and_names_its_example_once():
    text = PAGE.read_text(encoding="utf-8")
    assert len(text.split()) <= 1200
    assert text.count(EXAMPLE) == 1
    assert EXAMPLE not in FAMILIES


@pytest.mark.slow
@pytest.mark.parametrize("family", [EXAMPLE, *FAMILIES])
def test_the_page_leads_from_the_box_to_a_quiet_axis(family, shell):
    said = ""
    for block in blocks_in(PAGE):
        if block.language == "toml":
            bench = shell.folder / BENCH
            bench.write_text(edited(bench.read_text(encoding="utf-8"), block.body), encoding="utf-8")
        for command in commands_in(block) if block.language == "sh" else ():
            text = command.text.replace(EXAMPLE, family)
            if text.startswith(SERVER):
                shell.serve(text, LIMIT_S)
                continue
            status, said = shell.run(text, LIMIT_S)
            assert status == command.status, f"{PAGE.name}:{command.line}: {text}\nended with {status}:\n{said}"
            assert "Traceback (most recent call last)" not in said, said
    (before, _), (quiet, is_within) = tip_mm(shell.folder / "before"), tip_mm(shell.folder / "quiet")
    assert is_within
    assert quiet < 0.5 * before
    status, said = shell.run("drive-profiles pull --node $NODE --profile $PROFILE --out afterwards.toml", LIMIT_S)
    assert status == 0, said
    assert held(shell.folder, "afterwards.toml") == held(shell.folder, "as-found.toml")
