"""Tables: no word broken, nothing lost, no line wider than the terminal where that can be."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.cli.tables import lines

HEADER = ("name", "answer", "reason")
ESSAY = "Frequency and Q of zeros and poles are apart, but zero Q up to 5 is a damping of 0.1 at least, and 0.028 is needed."
ROWS = [("kollmorgen_akd", "approximate", ESSAY), ("harmonic_drive_yukondrive", "exact", "")]

words = st.lists(st.text("abcäß_./-19", min_size=1, max_size=12), max_size=8).map(" ".join)
tables = st.integers(1, 6).flatmap(
    lambda count: st.tuples(st.tuples(*[words] * count), st.lists(st.tuples(*[words] * count), min_size=1, max_size=5))
)


def test_columns_are_aligned_and_numbers_stand_right():
    assert lines(("frame", "bits", "what"), [("SYNC", "47", "a"), ("sum", "1021", "")]) == [
        "frame  bits  what",
        "SYNC     47  a",
        "sum    1021",
    ]  # fmt: skip


def test_a_terminal_gets_a_rule_below_the_header():
    assert lines(("a", "b"), [("x", "1")], 80) == ["a  b", "─  ─", "x  1"]


def test_a_table_without_a_header_has_only_rows():
    assert lines(("", ""), [("tip", "0.05")], 80) == ["tip  0.05"]


def test_long_cells_wrap_below_themselves_and_names_stay_whole():
    shown = lines(HEADER, ROWS, 70)
    assert max(map(len, shown)) <= 70
    assert shown[2].startswith("kollmorgen_akd             approximate  Frequency and Q of")
    assert shown[3].startswith(" " * len("kollmorgen_akd             approximate  ") + "")
    assert shown[-1] == "harmonic_drive_yukondrive  exact"


def test_off_a_terminal_each_row_is_a_line():
    assert [line.split()[0] for line in lines(HEADER, ROWS)] == ["name", "kollmorgen_akd", "harmonic_drive_yukondrive"]


def test_what_no_column_can_hold_becomes_a_block():
    assert lines(("object", "type", "unit", "access"), [("a_name_of_some_length", "UNSIGNED32", "", "rw")], 30) == [
        "a_name_of_some_length",
        "  type: UNSIGNED32 · access: rw"[:30].rsplit(" ·", 1)[0],
        "  access: rw",
    ]


def test_rows_that_would_wrap_into_more_lines_than_a_block_has_become_blocks():
    header = ("axis", "period ms", "delay", "M_s", "gain margin dB", "phase margin °", "verdict")
    row = ("2", "0.25", "1", "-", "-", "-", f"not known: {ESSAY}")
    shown = lines(header, [row], 80)
    assert shown[0] == "axis 2", "a number alone says nothing"
    assert len(shown) < 5
    assert max(map(len, shown)) <= 80


@pytest.mark.slow
@given(tables, st.integers(8, 120))
def test_no_word_is_broken_or_lost_and_no_line_too_wide(table, width):
    header, rows = table
    shown = lines(header, rows, width)
    kept = " ".join(shown).split()
    wanted = sorted(word for row in rows for cell in row for word in cell.split())
    for word in set(wanted):
        assert kept.count(word) >= wanted.count(word)
    longest = max((len(word) for row in (header, *rows) for cell in row for word in cell.split()), default=0)
    # a block's line is indented, and a name with its colon is not parted from what follows
    assert all(len(line) <= width or len(line.split()) <= 3 or longest + 8 > width for line in shown)


@pytest.mark.parametrize("cell", ["12", "-0.5", "+1.25", "−3", "1e-05", "26 %", "1,5", "-"])
def test_these_are_numbers(cell):
    assert lines(("name", "a wide head"), [("x", cell), ("y", "1")])[1] == f"x     {cell:>11}"


@pytest.mark.parametrize("cell", ["080h", "0x10", "no bound", "1.5 N·m"])
def test_and_these_are_not(cell):
    assert lines(("name", "a wide head"), [("x", cell), ("y", "1")])[1] == f"x     {cell}"
