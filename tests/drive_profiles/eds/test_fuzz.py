"""Damaged files: whatever the damage, a description or a `FileError`, and soon."""

import os
import random
import time
from functools import cache
from pathlib import Path

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.eds import export as eds_export
from drive_profiles.errors import FileError

QUIRKS = sorted((Path(__file__).parent / "quirks").iterdir())
CORPUS = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[4] / "shared" / "eds"))
REAL = sorted(path for path in CORPUS.glob("*") if path.suffix.lower() in {".eds", ".dcf", ".xdd"})
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


@cache
def content_of(path: Path) -> bytes:
    """A file before it is damaged."""
    return path.read_bytes()


def survives(paths: list[Path], seed: int) -> None:
    """Read a damaged file, in a bounded time of the processor: other jobs are none of the reader's doing."""
    chance = random.Random(seed)
    path = chance.choice(paths)
    data = damaged(content_of(path), chance)
    start = time.process_time()
    try:
        description = eds.loads(data, path, node_id=chance.choice((None, 5)))
    except FileError as error:
        assert error.problems  # noqa: PT017 - most damaged files are read; those that are not have a reason
    else:
        assert len(description.dictionary) > 0
        if chance.random() < 0.05:
            eds.loads(eds_export.as_text(description, "dcf").encode(), "again.dcf")
    assert time.process_time() - start < LONGEST_S


SEEDS = st.integers(0, 2**64 - 1)
AS_DRAWN = (Phase.reuse, Phase.generate)
"""A smaller seed is no simpler one."""


@pytest.mark.ci
@pytest.mark.part
@settings(max_examples=200, phases=AS_DRAWN)
@given(SEEDS)
def test_damaged_files_are_read_or_refused(seed):
    survives(QUIRKS, seed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@settings(max_examples=2_000, phases=AS_DRAWN)
@given(SEEDS)
def test_two_thousand_damaged_files_are_read_or_refused(seed):
    survives(QUIRKS, seed)


@pytest.mark.slow
@settings(max_examples=400, phases=AS_DRAWN)
@given(SEEDS)
def test_damaged_files_of_vendors_are_read_or_refused(seed):
    survives(REAL or QUIRKS, seed)


@settings(max_examples=100)
@given(st.lists(st.sampled_from(LINES), max_size=40))
def test_any_order_of_sensible_lines_is_read_or_refused(lines):
    try:
        eds.loads("\n".join(lines).encode())
    except FileError as error:
        assert error.problems  # noqa: PT017 - as above
