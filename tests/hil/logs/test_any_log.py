"""Whatever stands in a file, a log is read or refused by its own error, and what is read can be explained."""

import contextlib
import gc
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import LogError
from hil.logs.explain import explain
from hil.logs.opening import open_log

STAMP = st.floats(0.0, 100.0).map(lambda stamp: f"({stamp:.6f})")
IDENTIFIER = st.sampled_from([0x000, 0x080, 0x182, 0x202, 0x282, 0x582, 0x602, 0x702, 0x7FF])
DATA = st.binary(max_size=8)
MAPPED = st.sampled_from([0x60400010, 0x607A0020, 0x60410010, 0x60640020]).map(lambda value: value.to_bytes(4, "little"))
COMMAND = st.sampled_from([0x22, 0x23, 0x2B, 0x2F, 0x40, 0x43, 0x4B, 0x4F, 0x60, 0x80, 0x00, 0x21, 0xA0, 0xC0])
INDEX = st.sampled_from([0x1400, 0x1600, 0x1800, 0x1A00, 0x1017, 0x6040, 0x6060, 0x6072, 0x607D, 0x608F, 0x60C2, 0x6080])
CONTENT = st.one_of(st.binary(min_size=4, max_size=4), MAPPED)
SDO = st.tuples(COMMAND, INDEX, st.integers(0, 3), CONTENT).map(
    lambda part: bytes([part[0]]) + part[1].to_bytes(2, "little") + bytes([part[2]]) + part[3]
)


def line_of(stamp, can_id, data):
    return f"{stamp} can0 {can_id:03X}#{data.hex().upper()}".encode()


FRAME = st.builds(line_of, STAMP, IDENTIFIER, DATA)
SETUP = st.builds(line_of, STAMP, st.sampled_from([0x602, 0x582]), SDO)
SPACED = st.builds(
    lambda stamp, can_id, data: f" {stamp}  can1  {can_id:03X}   [{len(data)}]  {data.hex(' ').upper()}".encode(),
    STAMP, IDENTIFIER, DATA,
)  # fmt: skip
CUT = st.tuples(FRAME, st.integers(0, 30)).map(lambda part: part[0][: part[1]])
FLEXIBLE = st.builds(lambda stamp: f"{stamp} can0 182##1{'00' * 12}".encode(), STAMP)
LINE = st.one_of(FRAME, SETUP, SPACED, CUT, FLEXIBLE, st.binary(max_size=60))
RHYTHM = st.integers(20, 60).flatmap(
    lambda count: st.lists(st.binary(min_size=8, max_size=8), min_size=count, max_size=count).map(
        lambda contents: [
            each
            for number, data in enumerate(contents)
            for each in (line_of(f"({0.002 * number:.6f})", 0x080, b""), line_of(f"({0.002 * number:.6f})", 0x182, data),
                line_of(f"({0.002 * number + 0.001:.6f})", 0x202, data))
        ]
    )
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=60)
@given(st.lists(LINE, max_size=40), st.one_of(st.just([]), RHYTHM), st.sampled_from([b"\n", b"\r\n"]))
def test_lines_of_any_kind_are_read_or_refused(lines, rhythm, end):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "any.log")
        path.write_bytes(end.join([*lines, *rhythm]))
        try:
            log = open_log(path)
        except LogError:
            return
        found = explain(log, {}, 1_000_000)
        assert len(log) > 0
        assert all(each.words and each.remedy for each in found.findings)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # python-can leaves open what it cannot read
@settings(max_examples=25)
@given(st.sampled_from([(".blf", b"LOGG"), (".asc", b""), (".trc", b"")]), st.binary(max_size=400))
def test_bytes_of_any_kind_in_a_foreign_format_are_read_or_refused(kind, content):
    suffix, begin = kind
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"any{suffix}")
        path.write_bytes(begin + content)
        with contextlib.suppress(LogError):
            explain(open_log(path), {})
        gc.collect()


def test_a_directory_is_no_log(tmp_path):
    with pytest.raises(LogError, match="is a folder; expected a log of a bus"):
        open_log(tmp_path)
