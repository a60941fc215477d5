"""The passport of gears: what is read into it, that nothing is lost or twice, where orders come from, and the command."""

import json
import sqlite3
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.bench.model import Identified, IdentifiedError
from hil.cli.main import app
from hil.passport.gather import gather
from hil.passport.store import OrderLine, PassportFileError, PassportRun, add, read
from hil.results.learning import LearningResult, LearntAxis
from hil.results.recorded_ate import RecordedAteResult
from hil.robot_tables import TransmissionErrorTable
from tests.hil.results.made import measured_bench

pytestmark = pytest.mark.usefixtures("without_pictures")


def error(a2=5.0, day=1, note="", month=1):
    return IdentifiedError(
        values=TransmissionErrorTable.of({2: a2, 4: 3.0}, {2: 222.0, 4: 126.0}),
        standard_error={"a2_arcsec": 0.02, "phi2_deg": 0.3, "a4_arcsec": 0.02, "phi4_deg": 0.5},
        note=f"identified 2026-{month:02d}-{day:02d}T10:00:00+00:00{note}",
    )


def model(path, *parts, axis=2):
    for number, part in enumerate(parts):
        file = path / f"run-{number}" / "model.toml"
        file.parent.mkdir(parents=True)
        Identified(robot="arm").with_part(axis, part).save(file)


def called(*words):
    return CliRunner().invoke(app, ["passport", *map(str, words)])


def test_a_run_in_a_result_and_in_its_model_file_is_one(tmp_path: Path):
    part = error()
    result = LearningResult(
        bench=measured_bench(), model="m.toml", learnt=[LearntAxis(axis=2, reduction_fraction=0.9, passes=(), ate=part)]
    )
    result.write(tmp_path / "result.json")
    Identified(robot="reference").with_part(2, part).save(tmp_path / "m.toml")
    [run] = gather([tmp_path]).runs
    assert run.measured_utc == "2025-01-01T12:00:00+00:00", "the result says when"
    assert [(line.order, line.a_arcsec) for line in run.lines] == [(2.0, 5.0), (4.0, 3.0)]
    passport = tmp_path / "p.sqlite"
    assert (add(passport, [run]), add(passport, [run]), len(read(passport))) == (1, 0, 1)


def test_what_a_note_says_of_load_temperature_and_direction_is_kept(tmp_path: Path):
    model(tmp_path, error(note=", 22.5 °C, 3 kg, forwards"), error(note=", −5 °C, no load", day=2), error(day=3))
    first, second, third = gather([tmp_path]).runs
    assert (first.temperature_c, first.load_kg, first.direction) == (22.5, 3.0, "forward")
    assert (second.temperature_c, second.load_kg, second.direction) == (-5.0, 0.0, None)
    assert (third.temperature_c, third.load_kg) == (None, None)
    assert third.measured_utc == "2026-01-03T10:00:00+00:00"


def test_a_note_of_the_command_is_for_runs_that_say_nothing_themselves(tmp_path: Path):
    model(tmp_path, error(note=", 30 °C"), error(day=2), error(note=", 3 kg", day=3))
    first, second, third = gather([tmp_path], "22 °C, no load").runs
    assert [(run.temperature_c, run.load_kg) for run in (first, second, third)] == [(30.0, 0.0), (22.0, 0.0), (22.0, 3.0)]
    assert first.content == gather([tmp_path]).runs[0].content, "the same run all the same"


def test_other_files_are_left_alone_and_broken_ones_are_named(tmp_path: Path):
    (tmp_path / "bench.toml").write_text('robot = "x"\n[axis.2.model]\nate = 1\n')
    (tmp_path / "bad.toml").write_text('robot = "x"\n[axis.2.ate]\nvalues = 3\n')
    (tmp_path / "worse.toml").write_text("= =")
    (tmp_path / "result.json").write_text("[1, 2")
    found = gather([tmp_path])
    assert found.runs == ()
    assert sorted(Path(each.partition(":")[0]).name for each in found.left_out) == ["bad.toml", "result.json", "worse.toml"]


def test_nothing_is_ever_taken_from_a_passport(tmp_path: Path):
    passport = tmp_path / "p.sqlite"
    add(
        passport,
        [PassportRun("h", "arm", 2, "2026-01-01T00:00:00+00:00", "identify", "", lines=(OrderLine(2.0, 5.0, 0.1, 1.0, 1.0),))],
    )
    with sqlite3.connect(passport) as connection:
        for statement in ("DELETE FROM run", "DELETE FROM line", "UPDATE run SET axis = 3", "UPDATE line SET a_arcsec = 0"):
            with pytest.raises(sqlite3.IntegrityError, match="a passport"):
                connection.execute(statement)
    connection.close()
    assert read(passport)[0].lines[0].a_arcsec == 5.0


def test_a_file_that_is_no_passport_is_refused_with_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hil.passport.store.PATIENCE_S", 0.05)
    (tmp_path / "text").write_bytes(b"no database at all, " * 100)
    with pytest.raises(PassportFileError, match="not a passport, or a damaged one"):
        read(tmp_path / "text")
    other = sqlite3.connect(tmp_path / "other.sqlite")
    other.execute("CREATE TABLE a (b)")
    other.commit()
    other.close()
    with pytest.raises(PassportFileError, match="of another program"):
        read(tmp_path / "other.sqlite")
    good = tmp_path / "good.sqlite"
    add(good, [])
    holder = sqlite3.connect(good, isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    with pytest.raises(PassportFileError, match="another program is writing it"):
        add(good, [])
    holder.close()
    data = bytearray(good.read_bytes())
    data[4096:] = b"\xff" * (len(data) - 4096)
    (tmp_path / "damaged.sqlite").write_bytes(data)
    with pytest.raises(PassportFileError, match="damaged"):
        add(tmp_path / "damaged.sqlite", [PassportRun("h", "arm", 2, "2026", "identify", "")])
    with pytest.raises(PassportFileError, match="cannot be used"):
        read(tmp_path / "nowhere" / "p.sqlite")


@pytest.mark.ci
def test_the_command_keeps_tells_and_ends_with_9_on_a_change(tmp_path: Path):
    model(tmp_path / "old", *(error(5.0 + 0.02 * (-1) ** day, day) for day in range(1, 10)))
    words = (tmp_path / "old", "--file", tmp_path / "p.sqlite")
    quiet = called(*words)
    assert quiet.exit_code == 0, quiet.output
    assert "9 new runs, 9 in all" in quiet.output
    assert "No gear has changed" in (tmp_path / "passport.html").read_text(encoding="utf-8")
    again = called(*words)
    assert "0 new runs, 9 in all" in again.output
    model(tmp_path / "new", error(6.0, 1, month=3))
    worn = called(tmp_path / "new", "--file", tmp_path / "p.sqlite", "--json")
    assert worn.exit_code == 9, worn.output
    assert "A_2 = 6.00 arcsec on 2026-03-01" in worn.stderr
    assert "+20 %" in worn.stderr
    alarmed = [each for each in json.loads(worn.stdout) if each["alarmed_since"]]
    assert [(each["order"], each["quantity"]) for each in alarmed] == [(2.0, "a_arcsec")]
    assert "A gear has changed" in (tmp_path / "passport.html").read_text(encoding="utf-8")
    fresh = called(tmp_path / "new", "--file", tmp_path / "p.sqlite", "--since", "2026-02-01")
    assert fresh.exit_code == 0, fresh.output
    assert "too few runs" in fresh.output


@pytest.mark.parametrize(
    "words", [("--since", "soon"), ("--pole-pairs", "five"), ("--slots", "2=0"), ("--pole-pairs", "2=99999")]
)
def test_what_is_no_date_or_number_is_a_mistake_of_usage(tmp_path: Path, words):
    assert called(tmp_path, *words).exit_code == 2


def test_a_folder_without_identifications_is_refused_and_nothing_is_written(tmp_path: Path):
    for _ in range(2):
        done = called(tmp_path)
        assert done.exit_code == 3, done.output
        assert f"no identified transmission error below {tmp_path}" in done.stderr
        assert "run one of these, or name its folder" in done.stderr
        assert list(tmp_path.iterdir()) == []
    add(tmp_path / "passport.sqlite", [])
    assert called(tmp_path).exit_code == 3, "a passport without a run is none either"
    assert not (tmp_path / "passport.html").exists()
    add(tmp_path / "passport.sqlite", [PassportRun("h", "arm", 2, "2026-01-01T00:00:00+00:00", "identify", "")])
    assert called(tmp_path).exit_code == 0, "without new runs it shows those that it has"


def test_what_was_identified_from_a_recording_is_kept_too(tmp_path: Path):
    part = error().model_copy(update={"learnt_by": "recording", "note": "from jogging.csv"})
    RecordedAteResult(
        robot="arm", axis=3, started_utc="2026-02-01T09:00:00+00:00", versions={}, form="two encoders", reduction_ratio=101.0,
        orders=(2.0, 4.0), files=(), ate=part, is_identified=True,
    ).write(tmp_path / "result.json")  # fmt: skip
    [run] = gather([tmp_path]).runs
    assert (run.robot, run.axis, run.learnt_by, run.measured_utc) == ("arm", 3, "recording", "2026-02-01T09:00:00+00:00")
