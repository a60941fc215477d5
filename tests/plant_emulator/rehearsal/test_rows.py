"""Rows are kept whole or not at all, and a folder holds one rehearsal; the table holds what the rows do."""

import csv
import io
import json
import math

import numpy as np
import pytest

from drive_profiles.errors import FileError, RefusedError
from drive_profiles.standard.shown import spans
from plant_emulator.rehearsal.many.rows import MAX_ROW_BYTES, SETTINGS_FILE, Kept, RehearsalSettings
from plant_emulator.rehearsal.many.seeds import LARGEST_SEED, MOST_SEEDS, seeds_of
from plant_emulator.trials.rows import csv_text, parquet_bytes, plain, steady, write_table
from tests.plant_emulator.rehearsal.made import refused, row

SETTINGS = RehearsalSettings("both", over_bus=False)


@pytest.fixture
def kept(tmp_path):
    found = Kept(tmp_path / "rehearsal")
    found.begin(SETTINGS, resume=False)
    return found


def test_rows_come_back_as_they_were_kept_in_the_order_of_their_seeds(kept):
    rows = [row(10), refused(9, "φ₂ is not known"), row(2, cpu_s=0.1 + 0.2)]
    for each in rows:
        kept.keep(each)
    assert kept.seeds() == {2, 9, 10}
    assert kept.rows() == [rows[2], rows[1], rows[0]]


def test_a_row_that_was_not_written_to_its_end_is_not_there(kept):
    kept.keep(row(3))
    (kept.folder / "robots" / ".seed-4.json.a1b2c3").write_text('{"seed": 4, "kin')
    assert kept.seeds() == {3}


def test_a_rehearsal_that_walked_nobody_is_no_rehearsal(kept):
    other = RehearsalSettings("real", over_bus=True)
    kept.begin(other, resume=False)
    assert kept.settings() == other


def test_a_folder_with_a_rehearsal_is_not_taken_for_another(kept):
    kept.keep(row(3))
    with pytest.raises(RefusedError, match="already holds a rehearsal; give --resume to continue it"):
        kept.begin(SETTINGS, resume=False)
    kept.begin(SETTINGS, resume=True)
    with pytest.raises(RefusedError, match="over_bus was False, now True"):
        kept.begin(RehearsalSettings("both", over_bus=True), resume=True)
    with pytest.raises(RefusedError, match="kind was both, now real"):
        kept.begin(RehearsalSettings("real", over_bus=False), resume=True)


@pytest.mark.parametrize("name", ["robots.csv", "report.html"])
def test_a_folder_with_the_files_of_another_command_keeps_them(tmp_path, name):
    (tmp_path / name).write_text("of a fleet, or of a run")
    with pytest.raises(RefusedError, match=f"has a {name} of another command; choose another folder"):
        Kept(tmp_path).begin(SETTINGS, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_whose_settings_are_lost_is_not_mixed(kept):
    kept.keep(row(3))
    (kept.folder / SETTINGS_FILE).unlink()
    with pytest.raises(RefusedError, match=f"has robots but no {SETTINGS_FILE}"):
        kept.begin(SETTINGS, resume=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "is not JSON"),
        ("[1]", "is not a flat JSON object"),
        ('{"seed": 3, "tip": {"k": 1}}', "is not a flat JSON object"),
        ('{"seed": 3, "tip": NaN}', "is not a flat JSON object"),
        ('{"seed": 4}', "is the row of seed 4"),
        ('{"seed": 3, "words": "' + "x" * MAX_ROW_BYTES + '"}', "is larger than 1000000 bytes"),
    ],
)
def test_a_row_that_somebody_spoilt_is_said_with_its_file(kept, text, words):
    kept.keep(row(3))
    (kept.folder / "robots" / "seed-3.json").write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        kept.rows()
    assert "seed-3.json" in str(caught.value)


@pytest.mark.parametrize("text", ['{"kind": "both"}', '{"kind": 3, "over_bus": false}', "{}"])
def test_settings_that_somebody_spoilt_are_said(kept, text):
    (kept.folder / SETTINGS_FILE).write_text(text)
    with pytest.raises(FileError, match=SETTINGS_FILE):
        kept.settings()


def test_what_is_no_number_is_none_and_what_is_no_value_is_refused():
    assert [plain(value) for value in (math.nan, math.inf, np.float64(0.5), np.int32(3), np.True_, "a", None)] == [
        None, None, 0.5, 3, True, "a", None,
    ]  # fmt: skip
    assert type(plain(np.float64(0.5))) is float
    with pytest.raises(TypeError, match="is not a value of a row"):
        plain([1.0])


def test_what_follows_from_the_seed_leaves_processor_time_out():
    assert {name for name in row(1) if name not in steady(row(1))} >= {"cpu_s", "plant_cpu_s", "learn_cpu_s"}
    assert "tip_none_k2_mm" in steady(row(1))


# -- the table ---------------------------------------------------------------------------------------------------------


def test_the_csv_has_a_line_per_robot_and_every_digit():
    rows = [row(2, cpu_s=0.1 + 0.2), {"seed": 3, "walk": "crashed", "walk_words": 'said "no", and\nended'}]
    read = list(csv.DictReader(io.StringIO(csv_text(rows))))
    assert [each["seed"] for each in read] == ["2", "3"]
    assert float(read[0]["cpu_s"]) == 0.1 + 0.2
    assert read[0]["is_quiet"] == "yes"
    assert (read[1]["walk_words"], read[1]["cpu_s"]) == ('said "no", and\nended', "")


def test_the_parquet_file_has_the_same_robots(tmp_path):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    rows = [row(2), refused(3, "no"), {"seed": 4, "walk": "crashed", "walk_words": "died"}]
    (tmp_path / "robots.parquet").write_bytes(parquet_bytes(rows))
    read = pyarrow.read_table(tmp_path / "robots.parquet").to_pylist()
    assert [each["seed"] for each in read] == [2, 3, 4]
    for given, found in zip(rows, read, strict=True):
        assert {name: value for name, value in found.items() if value is not None} == {
            name: value for name, value in given.items() if value is not None
        }


def test_a_column_of_whole_and_broken_numbers_is_one_of_numbers(tmp_path):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    (tmp_path / "t.parquet").write_bytes(parquet_bytes([{"seed": 1, "x": 1}, {"seed": 2, "x": 0.5}, {"seed": 3, "x": None}]))
    assert pyarrow.read_table(tmp_path / "t.parquet").column("x").to_pylist() == [1.0, 0.5, None]


def test_both_tables_are_written_anew_each_time(tmp_path):
    pytest.importorskip("pyarrow")
    write_table(tmp_path, [row(1)])
    names = [path.name for path in write_table(tmp_path, [row(1), row(2)])]
    assert names == ["robots.csv", "robots.parquet"]
    assert len((tmp_path / "robots.csv").read_text().splitlines()) == 3


# -- seeds -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a comma-separated list"),
        ("a", "expected a comma-separated list"),
        ("-1", "expected a comma-separated list"),
        ("1-2-3", "expected a comma-separated list"),
        ("١", "expected a comma-separated list"),
        ("5-3", "ends before it begins"),
        ("1-5,3", "seed 3 is given twice"),
        (f"{LARGEST_SEED + 1}", f"seeds from 0 to {LARGEST_SEED}"),
        (f"1-{MOST_SEEDS + 1}", f"expected at most {MOST_SEEDS} seeds"),
        ("1-2147483647", f"expected at most {MOST_SEEDS} seeds"),
    ],
)
def test_seeds_that_are_none_are_refused(text, words):
    with pytest.raises(ValueError, match=words):
        seeds_of(text)


def test_seeds_and_their_words_say_the_same():
    assert seeds_of(spans([1, 2, 3, 9, 11, 12])) == (1, 2, 3, 9, 11, 12)


def test_a_row_s_file_is_one_flat_object(kept):
    kept.keep(row(3))
    assert json.loads((kept.folder / "robots" / "seed-3.json").read_text())["seed"] == 3
