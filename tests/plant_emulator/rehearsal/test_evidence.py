"""Kept recordings of a drawn robot, and what is estimated from them again."""

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from plant_emulator.rehearsal.evidence import replay as recordings
from plant_emulator.rehearsal.evidence.__main__ import errors_table, given
from plant_emulator.rehearsal.evidence.replay import HELD_OUT_FROM, REPLAYED, record, recorded_robots, replayed
from plant_emulator.rehearsal.many.one import drawn


@pytest.mark.slow
def test_a_replay_gives_what_the_bus_gave_and_its_truth_is_the_drawn_robots(tmp_path):
    assert list(record([40_002], "linear", tmp_path)) == [(40_002, ())]
    assert list(record([40_002], "linear", tmp_path)) == []
    (kept,) = recorded_robots(tmp_path)
    assert (kept.kind, kept.robot) == ("linear", drawn(40_002, "linear")[0])
    assert kept.bench == loads(drawn(40_002, "linear")[1], Bench)
    row, axis = replayed(kept), min(kept.bench.axis)
    known = kept.files.identified().axis[axis]
    assert (row["words"], row["seed"]) == ("", 40_002)
    for name, value in known.ate.values.model_dump(exclude_none=True).items():
        if name in REPLAYED:
            assert row[f"{name}_estimate"] == pytest.approx(value, rel=1e-4)
            assert row[f"{name}_error"] == pytest.approx(known.ate.standard_error[name], rel=1e-3)
            assert row[f"{name}_true"] == getattr(kept.robot.axis[axis].apparent_ate, name)
    assert row["ramps_arm_hz_estimate"] == pytest.approx(known.ate.arm_hz, rel=1e-5)
    assert row["antiresonance_hz_estimate"] == known.plant.antiresonance_hz
    again = errors_table([row], [row]).markdown()
    assert "linear: 1 robots, 0 without an estimate" in again
    assert "| a2_arcsec | 1 (1) |" in again


def test_no_evidence_is_made_of_a_robot_that_is_held_out(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "drawn", None)
    with pytest.raises(ValueError, match=f"seed {HELD_OUT_FROM} is held out; expected seeds below {HELD_OUT_FROM}"):
        next(record([7, HELD_OUT_FROM], "linear", tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_a_robot_that_was_refused_has_words_and_no_estimate(tmp_path):
    robot, text = drawn(40_002, "linear")
    folder = tmp_path / "linear-40002"
    folder.mkdir()
    (folder / "bench.toml").write_text(text)
    (folder / "robot.toml").write_text(recordings.file_text(robot))
    row = replayed(recorded_robots(tmp_path)[0])
    assert row["words"]
    assert {row[f"{name}_estimate"] for name in REPLAYED} == {None}
    assert row["a2_arcsec_true"] == robot.axis[2].apparent_ate.a2_arcsec


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("record", "evidence", "--kind", "linear", "--seeds", str(HELD_OUT_FROM)), f"seed {HELD_OUT_FROM} is held out"),
        (("record", "evidence", "--kind", "linear", "--seeds", "x"), "x: expected a comma-separated list"),
        (("replay", "nowhere", "--rows", "rows.json"), "nowhere has no recorded robot"),
    ],
)
def test_the_command_refuses_with_the_reason_and_writes_nothing(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["evidence", *words])
    with pytest.raises(SystemExit) as ended:
        given()
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
