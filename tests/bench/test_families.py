"""Every drive family is moved by a run, also several of them on one bus; an axis that stands need not be complete."""

from collections.abc import Mapping

import numpy as np
import pytest

from drive_profiles.family.profile import Profile
from drive_profiles.family.runs import family_runs
from drive_profiles.standard.cia402 import State
from hil.bench.bench import AS_FOUND, Bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedError
from hil.errors import NotPossibleError
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.master.drive.limits import LIMITS, holders
from hil.master.drive.mapping import mode_of
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.families.made import bench_of, family_alone, family_run, robot_of, vendor_families
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World
from tests.bench.conftest import with_bus

AXIS = 2
OTHERS = {"kollmorgen_akd", "maxon_epos2", "schunk_pilz_prbt"}
"""Families of the everyday run: none of the limits held, a mode of the maker's own, and IP."""


def session_of(robot: Robot, bench: Bench, families: Mapping[int, str]) -> tuple[Session, InProcessChannel]:
    """A session on the robot whose drives are of these families."""
    changed = robot_of(robot, bench, families)
    channel = InProcessChannel(World(changed))
    return Session(with_bus(bench_of(changed, bench, families), answer_timeout_s=1.0), channel, BusLog(None)), channel


def moved(session: Session) -> RunResult:
    with session:
        session.bring_up()
        motion = constant_acceleration(session.bench, AXIS, session.bench.bus.sync_period_s)
        return session.run(motion, "none", "drive")


@pytest.mark.parametrize(
    "family", [pytest.param(name, marks=() if name in OTHERS else pytest.mark.ci) for name in vendor_families()]
)
def test_a_run_moves_the_family_and_leaves_it_as_it_was(family: str, short_bench: Bench, reference_robot: Robot) -> None:
    session, channel = session_of(reference_robot, short_bench, {AXIS: family})
    result = moved(session)
    assert result.stopped is None
    assert not session.not_restored
    assert channel.world.drives[AXIS].state is not State.OPERATION_ENABLED
    position, reference = (result.recording.axis(AXIS, f"{name}_rad") for name in ("position", "reference"))
    assert np.ptp(position) > 6.0
    assert np.max(np.abs(position - reference)) < 1.5, "the lag of the loop, no more"
    torque = result.recording.axis(AXIS, "torque_nm")
    assert 0.05 < np.max(np.abs(torque)) < session.bench.axis[AXIS].limits.torque_nm
    table, held = family_runs()[family], holders(session.axes[AXIS].profile)
    mode = mode_of("drive", session.axes[AXIS].profile)
    assert (mode is not None, table.is_moved, table.mode) == (True, True, mode.name if mode else "")
    assert (*table.held_by_drive,) == tuple(held.get("drive", ()))
    assert (*table.held_by_master,) == tuple(held.get("master alone", ()))
    assert (*table.kept_by_drive,) == tuple(held.get("drive, as found", ()))


@pytest.mark.slow
@pytest.mark.parametrize("family", vendor_families())
def test_the_table_of_runs_is_what_doing_it_again_gives(family: str) -> None:
    kept, anew = family_runs()[family], family_run(family)
    assert (anew.is_identified, anew.is_cancelled, anew.plant_refusal) == (
        kept.is_identified, kept.is_cancelled, kept.plant_refusal
    )  # fmt: skip
    assert anew.tip_mm == pytest.approx(kept.tip_mm, rel=0.05)
    assert anew.cancelled_tip_mm == pytest.approx(kept.cancelled_tip_mm, abs=0.002)


@pytest.mark.parametrize("family", ["maxon_epos4", "elmo_gold"])
def test_what_a_drive_is_to_hold_it_holds_during_the_run(family: str, short_bench: Bench, reference_robot: Robot) -> None:
    session, channel = session_of(reference_robot, short_bench, {AXIS: family})
    dictionary, seen = channel.world.drives[AXIS].slave.dictionary, {}
    profile = Profile.load(family)
    held = {limit.key: profile.parameters[name] for limit in LIMITS if (name := limit.held_by(profile)) is not None}

    def look(number: int) -> None:
        if channel.world.drives[AXIS].state is State.OPERATION_ENABLED and not seen:
            seen.update({key: dictionary.cell(*parameter.address).value for key, parameter in held.items()})

    channel.on_sync = look
    assert moved(session).stopped is None
    counts = session.axes[AXIS].scaling.encoder_counts_per_rev
    assert seen["position_max_rev"] == round(short_bench.axis[AXIS].limits.position_max_rev * counts)
    assert seen["following_error_rev"] == round(short_bench.axis[AXIS].limits.following_error_rev * counts)


@pytest.mark.ci
def test_an_error_that_was_identified_alone_is_cancelled_and_judged_by_the_ramp_of_its_trial(tmp_path) -> None:
    """Without a plant f_al comes from the trial's run without the cancellation: a quiet tip does not show it."""
    alone = family_alone("maxon_epos2")
    table = alone.bench.axis[AXIS]
    assert table.model is not None
    error = IdentifiedError(values=table.model.ate, arm_hz=12.45, damping=0.0385)
    identified = Identified(robot=alone.bench.name, axis={AXIS: IdentifiedAxis(ate=error)})
    stated = table.model_copy(update={"model": None, "motor_inertia_kg_m2": table.model.motor_inertia_kg_m2})
    outcome = run_experiments(
        alone.bench.model_copy(update={"axis": {AXIS: stated}}),
        [Experiment("constant-acceleration", AXIS, "cancellation")],
        tmp_path,
        knowledge=Knowledge(identified),
        channel=InProcessChannel(World(alone.robot)),
    )
    assert outcome.failure is None
    peaks = {run.order: run.tip_peak_mm for run in outcome.result.runs}
    assert peaks.keys() == {2, 4}
    assert all(peak is not None and peak < 0.01 for peak in peaks.values())
    assert all(run.within_spec and run.f_al_source == "own" for run in outcome.result.runs)


def test_families_of_three_makers_move_the_tip_along_a_line_together(short_bench: Bench, reference_robot: Robot) -> None:
    """CSP, IP and the maker's own mode with one SYNC; the tip follows as it does with our own drives."""
    families = {2: "maxon_epos4", 3: "schunk_pilz_prbt", 5: "elmo_gold"}
    session, _ = session_of(reference_robot, short_bench, families)
    with session:
        session.bring_up()
        motion = line_motion(session.bench, session.bench.bus.sync_period_s)
        result = session.run(motion, "none", "drive")
    assert result.stopped is None
    assert not session.not_restored
    own = Session(short_bench, InProcessChannel(World(reference_robot)), BusLog(None))
    with own:
        own.bring_up()
        same = own.run(motion, "none", "drive").recording
    for number in families:
        other = result.recording.axis(number, "position_rad")
        assert np.max(np.abs(other - same.axis(number, "position_rad"))) < 0.2


def test_an_axis_that_stands_need_not_be_complete(short_bench: Bench, reference_robot: Robot, tmp_path) -> None:
    """Axis 5 has a drive of which neither profile nor bench file says how it counts."""
    families = {5: "kollmorgen_akd"}
    robot = robot_of(reference_robot, short_bench, families)
    table = short_bench.axis[5].model_copy(update={"profile": "kollmorgen_akd", "control": AS_FOUND, "notch": ()})
    bench = short_bench.model_copy(update={"axis": {**short_bench.axis, 5: table}})
    outcome = run_experiments(
        bench, [Experiment("constant-acceleration", AXIS, "none")], tmp_path, channel=InProcessChannel(World(robot))
    )
    assert outcome.failure is None
    with pytest.raises(NotPossibleError, match="axis 5: profile kollmorgen_akd has no scale of positions"):
        run_experiments(bench, [Experiment("constant-acceleration", 5, "none")], tmp_path, channel=InProcessChannel(World(robot)))


def test_a_limit_that_the_master_holds_alone_is_said_and_written_into_the_result(
    short_bench: Bench, reference_robot: Robot, tmp_path
) -> None:
    families = {AXIS: "harmonic_drive_yukondrive"}
    robot = robot_of(reference_robot, short_bench, families)
    outcome = run_experiments(
        bench_of(robot, short_bench, families),
        [Experiment("constant-acceleration", AXIS, "none")],
        tmp_path,
        channel=InProcessChannel(World(robot)),
    )
    said = outcome.result.drive_remarks or ()
    assert any(words.startswith("axis 2: the master alone holds limits.speed_rps") for words in said)
    assert any("has no CSP and runs in IP" in words for words in said)
