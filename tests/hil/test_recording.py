"""Columns of a recording that was stopped."""

import numpy as np
import pytest

from hil.recording import load_columns, save_columns


def test_columns_come_back(tmp_path):
    columns = {"time_s": np.arange(3.0), "speed_rps": np.array([0.5, np.nan, 2.0])}
    save_columns(tmp_path / "run.csv", columns)
    found = load_columns(tmp_path / "run.csv")
    assert list(found) == list(columns)
    assert all(np.array_equal(found[name], columns[name], equal_nan=True) for name in columns)


def test_columns_without_a_row_say_so(tmp_path):
    path = tmp_path / "run.csv"
    save_columns(path, {"time_s": np.empty(0), "speed_rps": np.empty(0)})
    with pytest.raises(ValueError, match=r"run\.csv: no row of numbers; a run that is stopped at once"):
        load_columns(path)


@pytest.mark.parametrize("junk", [b"\xd0\x00,b\n1,2\n", b"time_s\n\xd0\n"])
def test_a_file_that_is_no_text_is_named(tmp_path, junk):
    path = tmp_path / "run.csv"
    path.write_bytes(junk)
    with pytest.raises(ValueError, match=r"run\.csv: not a recording: not text in UTF-8"):
        load_columns(path)
