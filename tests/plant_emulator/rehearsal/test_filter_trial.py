"""The trial of filters on a drawn robot with hysteresis and a low resonance: a filter for order 2 raises order 1."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from drive_profiles.files.toml import loads
from hil.analysis import TipScale, tip_scale
from hil.bench.bench import Bench
from hil.bench.design import DesignedAxis, Designs
from hil.errors import NotPossibleError
from hil.experiments import runner
from hil.experiments.filter_trial import try_filters
from hil.experiments.motions import constant_acceleration
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.recording import Recording
from hil.results.runs import FilterTrial
from hil.robot_tables import NotchTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.survey import session_on
from plant_emulator.rehearsal.truth import quiet, tip_by_order_mm, true_f_al_hz, with_true_models
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World

SEED, AXIS, TRIALS = 1102, 2, 30


def paper_filter(f_al_hz: float) -> NotchTable:
    """The paper's filter, in proportion to the robot's own f_al."""
    speed_rps, offset_hz = f_al_hz / 2.0, 0.5 * f_al_hz / 11.84
    return NotchTable(
        order=2, start_rps=0.676 * speed_rps, end_rps=1.5 * speed_rps, offset_hz=offset_hz, zeta_rn=0.028, zeta_rdth=0.1
    )


def with_filter(bench: Bench, f_al_hz: float) -> Bench:
    axis = bench.axis[AXIS].model_copy(update={"notch": (paper_filter(f_al_hz),)})
    return bench.model_copy(update={"axis": {**bench.axis, AXIS: axis}})


@pytest.fixture(scope="module")
def tried() -> tuple[Robot, Bench, TipScale, dict[bool, Recording]]:
    """The robot, its bench, its scale, and its motion on a quiet sensor, without the filter and with it."""
    robot, text = drawn(SEED, "real")
    bench = loads(text, Bench, "blank bench")
    scale = tip_scale(true_f_al_hz(bench, robot, AXIS))
    recordings = {}
    for acts in (False, True):
        with session_on(quiet(robot), with_filter(bench, scale.f_al_hz)) as session:
            motion = constant_acceleration(bench, AXIS, bench.bus.sync_period_s)
            recordings[acts] = session.run(motion, "notch" if acts else "none", "drive", shows_filter=False).recording
    return robot, bench, scale, recordings


@pytest.mark.ci
def test_a_filter_that_raises_an_order_it_is_not_for_is_refused_whatever_the_noise(
    tried: tuple[Robot, Bench, TipScale, dict[bool, Recording]],
) -> None:
    """Of 30 trials with the robot's own noise 9 would accept it after one pair of runs in which no rise stands out."""
    robot, bench, scale, recordings = tried
    before, after = (tip_by_order_mm(recordings[acts], AXIS, scale.f_al_hz) for acts in (False, True))
    assert robot.axis[AXIS].hysteresis_torque_nm > 0.2
    assert scale.f_al_hz < 7.0
    assert after[1] > 1.07 * before[1], "the order that the filter is not for"
    assert after[2] < 0.95 * before[2]
    rng = np.random.default_rng(20261124)

    def run(acts: bool) -> Recording:
        made = recordings[acts]
        noise = robot.accelerometer.noise_m_s2 * rng.standard_normal(len(made.time_s))
        return Recording({**made.columns, "tip_z_m_s2": made.columns["tip_z_m_s2"] + noise})

    trials = [try_filters(bench, scale, [run]) for _ in range(TRIALS)]
    assert sum(trial.is_good for trial in trials) == 0
    words = next(trial.words for trial in trials if trial.words)
    assert re.search(r"in the window of order 1 rises from 0\.5\d* to 0\.[56]\d* ± 0\.\d+ mm", words)


def designed_for(bench: Bench, robot: Robot) -> Knowledge:
    """A design file with that filter."""
    axis = DesignedAxis(
        notch=(paper_filter(true_f_al_hz(bench, robot, AXIS)),),
        sensitivity_peak=1.4,
        phase_margin_deg=50.0,
        gain_margin_db=9.0,
        period_s=bench.bus.sync_period_s,
    )
    return Knowledge(designs=Designs(robot=bench.name, axis={AXIS: axis}))


def test_a_run_with_designed_filters_tries_them_first_and_goes_on_without_those_that_are_refused(tmp_path: Path) -> None:
    robot, text = drawn(SEED, "real")
    bench = with_true_models(loads(text, Bench, "blank bench"), robot)
    designed = [Experiment("constant-acceleration", AXIS, "notch-designed")]
    channel = InProcessChannel(World(robot), is_logged=False)
    outcome = run_experiments(bench, designed, tmp_path, knowledge=designed_for(bench, robot), channel=channel)
    trials = [run.filter_trial for run in outcome.result.runs if run.filter_trial is not None]
    assert trials
    assert all(not trial.is_good and "in the window of order 1 rises" in trial.words for trial in trials)
    assert all(run.filters == () for run in outcome.result.runs), "none acted in what is stated as the result"


def with_room(bench: Bench, room_rev: float) -> Bench:
    """The bench with so much travel beyond the end of its motion from zero."""
    axis = bench.axis[AXIS]
    travel_rev = float(constant_acceleration(bench, AXIS, bench.bus.sync_period_s).motor_angle_rad.max()) / (2.0 * np.pi)
    limits = axis.limits.model_copy(update={"position_max_rev": travel_rev + room_rev})
    return bench.model_copy(update={"axis": {**bench.axis, AXIS: axis.model_copy(update={"limits": limits})}})


@pytest.mark.parametrize(("room_rev", "turns_deg"), [(2.0, 112.5), (0.5, -112.5)])
def test_runs_of_a_trial_start_at_the_angle_of_their_pair_with_the_arm_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room_rev: float, turns_deg: float
) -> None:
    """From run to run the axis slips in its brake, whose release lets a soft arm ring longer than the bench waits."""
    robot, text = drawn(SEED, "real")
    robot = quiet(robot)
    bench = with_room(with_true_models(loads(text, Bench, "blank bench"), robot), room_rev)
    made: list[list[Recording]] = []

    def tried(_bench: Bench, _scale: TipScale, runs: Sequence[Callable[[bool], Recording]], *_: object) -> FilterTrial:
        made.extend([run(acts) for acts in (False, True)] for run in runs)
        return FilterTrial(is_good=False, runs=len(runs), peaks=(), words="enough")

    monkeypatch.setattr(runner, "try_filters", tried)
    designed = [Experiment("constant-acceleration", AXIS, "notch-designed")]
    channel = InProcessChannel(World(robot), is_logged=False)
    run_experiments(bench, designed, tmp_path, knowledge=designed_for(bench, robot), channel=channel)
    starts = np.array([[float(each.axis(AXIS, "position_rad")[0]) for each in pair] for pair in made])
    assert np.ptp(starts, axis=1).max() < 0.002, "rad: the axis slips by more"
    assert np.degrees(np.diff(starts[:, 0])) == pytest.approx([turns_deg] * 3, abs=0.2)
    for pair in made:
        dwell = [each.felt_m_s2[: round(0.15 / each.period_s)] for each in pair]
        assert max(np.ptp(each) for each in dwell) < 0.002 * np.ptp(pair[0].felt_m_s2)


def test_designed_filters_are_refused_before_any_motion_where_no_f_al_is_known(tmp_path: Path) -> None:
    robot, text = drawn(SEED, "real")
    bench = loads(text, Bench, "blank bench")
    designed = [Experiment("constant-acceleration", AXIS, "notch-designed")]
    channel, known = InProcessChannel(World(robot), is_logged=False), designed_for(bench, robot)
    with pytest.raises(NotPossibleError, match=r"notch-designed: designed filters are tried on the robot first.*f_al"):
        run_experiments(bench, designed, tmp_path, knowledge=known, channel=channel)
    assert not list(tmp_path.iterdir())
