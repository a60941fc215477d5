"""Reading of recordings that others have made: formats, columns, units, angles that begin anew."""

import gzip
from pathlib import Path

import asammdf
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from hil.recordings import MissingPackageError, RecordingFileError, Said, choose_columns, read_recording
from hil.recordings.units import unit_of

ROWS = 200
TIME = np.arange(ROWS) * 0.004
MOTOR = np.linspace(0.0, 40.0, ROWS)


def text_of(delimiter=",", decimal=".", names="time_s,motor_rad,load_rad"):
    lines = [names.replace(",", delimiter)]
    lines += [
        delimiter.join(f"{value:.9f}".replace(".", decimal) for value in row)
        for row in zip(TIME, MOTOR, MOTOR / 100, strict=True)
    ]
    return "\n".join(lines) + "\n"


def with_cell(row, cell):
    lines = text_of().splitlines()
    lines[row] = ",".join([lines[row].split(",")[0], cell, "0.0"])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", text_of().encode()),
        ("a.tsv", text_of("\t").encode()),
        ("a.csv", text_of(";").encode()),
        ("a.csv", text_of(";", ",").encode()),
        ("a.csv", b"\xef\xbb\xbf" + text_of().replace("\n", "\r\n").encode()),
        ("a.csv.gz", gzip.compress(text_of().encode())),
    ],
)
def test_all_kinds_of_text_say_the_same(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    recorded = read_recording(path, Said(), 1)
    assert recorded.motor_rad == pytest.approx(MOTOR, abs=1e-8)
    assert recorded.period_s == pytest.approx(0.004)


def test_parquet_says_the_same_with_stamps_of_its_own_type(tmp_path):
    stamps = pyarrow.array((TIME * 1e6 + 1.7e15).astype("int64"), pyarrow.timestamp("us"))
    path = tmp_path / "a.parquet"
    parquet.write_table(pyarrow.table({"time_s": stamps, "motor_rad": MOTOR, "load_rad": MOTOR / 100.0}), path)
    recorded = read_recording(path, Said(), 1)
    assert recorded.motor_rad == pytest.approx(MOTOR)
    assert recorded.time_s == pytest.approx(TIME, abs=1e-6)


def test_parquet_with_words_in_a_column_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    parquet.write_table(pyarrow.table({"time_s": TIME, "motor_rad": ["x"] * ROWS}), path)
    with pytest.raises(RecordingFileError, match="'motor_rad' holds string; expected numbers"):
        read_recording(path, Said(), 1)


def test_a_format_without_its_package_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "asammdf", None)
    path = tmp_path / "a.mf4"
    path.write_bytes(b"MDF     4.10")
    with pytest.raises(MissingPackageError, match=r"pip install 'hil-bench\[mf4\]'"):
        read_recording(path, Said(), 1)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (text_of(names="time_s,motor_rad,motor_rad"), "'motor_rad' names two columns"),
        (text_of(names="1.0,2.0,3.0"), "its first line has numbers"),
        (with_cell(7, "seven"), "line 8: 'seven' in the column 'motor_rad' is not a number"),
        ("\n".join([*text_of().splitlines()[:51], "0.2"]), "line 52 has 1 cells; expected 3"),
        ("time_s,motor_rad,load_rad\n" + "0.0,,0.0\n" * 100, "a number is missing in 100 of 100 rows"),
        ("time_s,motor_rad,load_rad\n" + "0.0,1.0,0.0\n" * 100, "does not increase"),
        ("time_s,motor_rad,load_rad\n0.0,1.0,0.0\n", "1 rows are too few"),
        (text_of() + "0.0,1.0,1.0\n", "the time goes back by 0.796 s from row 200 to 201"),
        ("", "the file is empty"),
        ("\n", "its first line holds"),
    ],
)
def test_a_text_file_that_cannot_be_used_says_where(tmp_path, content, said):
    path = tmp_path / "a.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(RecordingFileError) as refused:
        read_recording(path, Said(), 1)
    assert said in str(refused.value)


def test_a_damaged_archive_is_refused(tmp_path):
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text_of().encode())[:-40])
    with pytest.raises(RecordingFileError, match="cannot be read"):
        read_recording(path, Said(), 1)


def test_an_archive_with_a_wrong_byte_is_refused(tmp_path):
    path = tmp_path / "a.csv.gz"
    packed = bytearray(gzip.compress(text_of().encode()))
    packed[40:60] = bytes(range(235, 255))
    path.write_bytes(packed)
    with pytest.raises(RecordingFileError, match=r"cannot be read|in the column"):
        read_recording(path, Said(), 1)


@pytest.mark.slow
def test_a_number_with_stamps_that_go_back_is_refused(tmp_path):
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(MOTOR, TIME, name="motor_rad")])
        file.append([asammdf.Signal(MOTOR, np.concatenate([TIME[:90], TIME[80:-10]]), name="load_rad")])
        file.save(tmp_path / "a.mf4")
    with pytest.raises(RecordingFileError, match=r"the stamps of 'load_rad' go back by 0\.036 s from its number 90 to 91"):
        read_recording(tmp_path / "a.mf4", Said(), 1)


@pytest.mark.slow
@pytest.mark.parametrize("left", [0.3, 0.6, 0.99])
def test_an_mf4_file_that_was_cut_off_is_refused_and_prints_nothing_else(tmp_path, capsys, left):
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(MOTOR, TIME, name="motor_rad")])
        path = file.save(tmp_path / "a.mf4")
    path.write_bytes(path.read_bytes()[: int(left * path.stat().st_size)])
    with pytest.raises(RecordingFileError):
        read_recording(path, Said(), 1)
    assert capsys.readouterr().err == ""


def test_few_rows_without_a_number_are_left_out_and_said(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(with_cell(7, ""), encoding="utf-8")
    recorded = read_recording(path, Said(), 1)
    assert len(recorded.time_s) == ROWS - 1
    assert recorded.notes == ("1 rows without a number are left out",)


def test_an_angle_that_begins_anew_goes_on(tmp_path):
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{t:.3f},{a % 360.0:.6f}" for t, a in zip(TIME, np.degrees(MOTOR), strict=True))
    path.write_text("time_s,motor_deg\n" + rows, encoding="utf-8")
    assert read_recording(path, Said(), 1).motor_rad == pytest.approx(MOTOR, abs=1e-6)


@pytest.mark.parametrize(
    ("angles", "said"),
    [
        (np.mod(np.arange(ROWS) * 160.0, 360.0), "rev shows the direction"),
        (np.where(np.arange(ROWS) < 100, 0.0, 1300.0) + np.arange(ROWS), "does not wrap after one revolution"),
    ],
)
def test_an_angle_that_cannot_be_followed_is_refused(tmp_path, angles, said):
    path = tmp_path / "a.csv"
    path.write_text(
        "time_s,motor_deg\n" + "\n".join(f"{t:.3f},{a:.6f}" for t, a in zip(TIME, angles, strict=True)), encoding="utf-8"
    )
    with pytest.raises(RecordingFileError, match=said):
        read_recording(path, Said(), 1)


def test_of_two_columns_that_could_be_meant_none_is_guessed():
    with pytest.raises(RecordingFileError, match="no column is recognised as motor"):
        choose_columns(Path("a.csv"), ("time_s", "motor_rad", "motor_angle_rad"), Said(), 1)


def test_columns_of_a_run_of_this_bench_are_known():
    names = ("time_s", "axis2_reference_rad", "axis2_position_rad", "axis2_torque_nm", "tip_x_m_s2", "tip_z_m_s2", "missing")
    chosen = choose_columns(Path("a.csv"), names, Said(), 2)
    assert {role: column.name for role, column in chosen.items()} == {
        "time": "time_s", "motor": "axis2_position_rad", "acceleration": "tip_z_m_s2", "torque": "axis2_torque_nm",
    }  # fmt: skip


@pytest.mark.parametrize(("text", "factor"), [("2^10/rev", 1024), ("-4096/rev", -4096)])
def test_increments_are_a_unit_with_a_sign(text, factor):
    assert unit_of("load", text).factor == pytest.approx(2.0 * np.pi / factor)


@pytest.mark.ci
def test_channels_of_an_mf4_file_are_read_at_the_stamps_of_the_motor(tmp_path):
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(MOTOR, TIME, name="motor_rad")])
        file.append([asammdf.Signal(10.0 * MOTOR, TIME, name="torque_nm")])
        file.save(tmp_path / "a.mf4")
    opened = len(list(Path("/dev/fd").iterdir()))
    recorded = read_recording(tmp_path / "a.mf4", Said(), 1)
    assert len(list(Path("/dev/fd").iterdir())) == opened, "the file stays open"
    assert recorded.value["torque"] == pytest.approx(10.0 * recorded.motor_rad)
