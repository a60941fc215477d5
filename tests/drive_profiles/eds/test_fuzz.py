"""Damaged files: whatever the damage, a description or a `FileError`, and soon."""

import os
import random
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.eds import export as eds_export
from drive_profiles.errors import FileError

QUIRKS = sorted((Path(__file__).parent / "quirks").iterdir())
INSERTS = (
    b"-",
    b"0x",
    b"0",
    b"9" * 30,
    b"9" * 5000,
    b"$NODEID",
    b"\x00",
    b"\xff",
    b"e9",
    b"\x1b[2J",
    b"=",
    b"#",
    b"0xFE\nCompactSubObj=0xFE\n",
)
HEADS = (b"0", b"F", b"sub", b"]", b"zz", b"1016Value]\n[", b"[")
LONGEST_S = 30.0
"""No measure of speed, but the end of a reader that has lost its way: damage must not make the work grow without bound."""
LINES = (
    "[1000]", "[1000sub1]", "[1000sub0]", "[1000Value]", "[1000Name]", "[A0]", "[00A0sub1]", "[MandatoryObjects]",
    "[DummyUsage]", "[DeviceInfo]", "ObjectType=8", "ObjectType=7", "ObjectType=9", "DataType=2", "DataType=0x1000",
    "DataType=0xA0", "DefaultValue=0xFF", "LowLimit=1", "HighLimit=-1", "AccessType=rw", "ParameterValue=$NODEID",
    "CompactSubObj=3", "SubNumber=1", "1=5", "NrOfEntries=1", "SupportedObjects=1", "1=0x1000", "ParameterName=x",
    "Dummy0005=1", "NrOfRXPDO=99999", "NrOfTXPDO=-3", "CompactPDO=0xFFFF",
)  # fmt: skip


def damaged(data: bytes, chance: random.Random) -> bytes:
    """One to twenty faults in a file."""
    content = bytearray(data)
    for _ in range(chance.choice((1, 3, 20))):
        if not content:
            break
        at = chance.randrange(len(content))
        kind = chance.choice(("flip", "flip", "cut", "repeat", "drop", "line", "number", "head"))
        if kind == "flip":
            content[at] ^= 1 << chance.randrange(8)
        elif kind == "cut":
            del content[at:]
        elif kind == "repeat":
            content[at:at] = content[at : at + chance.randrange(300)]
        elif kind == "drop":
            del content[at : at + chance.randrange(80)]
        elif kind == "line":
            lines = bytes(content).splitlines(keepends=True)
            lines.insert(chance.randrange(len(lines)), chance.choice(lines))
            content = bytearray(b"".join(lines))
        else:
            mark, inserts = (b"=", INSERTS) if kind == "number" else (b"[", HEADS)
            found = bytes(content).find(mark, at)
            content[found + 1 : found + 1] = chance.choice(inserts)
    return bytes(content)


def survives(paths: list[Path], count: int, seed: int) -> float:
    """Read so many damaged files; gives the longest time that one took (CPU time: other jobs are none of the reader's doing)."""
    chance = random.Random(seed)
    contents = {path: path.read_bytes() for path in paths}
    longest = 0.0
    for _ in range(count):
        path = chance.choice(paths)
        data = damaged(contents[path], chance)
        start = time.process_time()
        try:
            description = eds.loads(data, path, node_id=chance.choice((None, 5)))
        except FileError as error:
            assert error.problems  # noqa: PT017 - most damaged files are read; those that are not have a reason
        else:
            assert len(description.dictionary) > 0
            if chance.random() < 0.05:
                eds.loads(eds_export.as_text(description, "dcf").encode(), "again.dcf")
        longest = max(longest, time.process_time() - start)
    return longest


@pytest.mark.ci
def test_damaged_files_are_read_or_refused():
    assert survives(QUIRKS, 400, seed=1) < LONGEST_S


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ten_thousand_damaged_files_are_read_or_refused():
    assert survives(QUIRKS, 8_000, seed=2) < LONGEST_S
    corpus = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[4] / "shared" / "eds"))
    real = sorted(path for path in corpus.glob("*") if path.suffix.lower() in {".eds", ".dcf", ".xdd"})
    assert survives(real or QUIRKS, 2_000, seed=3) < LONGEST_S


@settings(max_examples=100)
@given(st.lists(st.sampled_from(LINES), max_size=40))
def test_any_order_of_sensible_lines_is_read_or_refused(lines):
    try:
        eds.loads("\n".join(lines).encode())
    except FileError as error:
        assert error.problems  # noqa: PT017 - as above
