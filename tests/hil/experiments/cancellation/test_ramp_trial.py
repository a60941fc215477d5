"""Orders that a motion hides: a slow ramp through their resonance shows them, within the motion's travel and all limits."""

import math
from dataclasses import replace

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, with_identified
from hil.errors import NotPossibleError
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.ramp_trial import ramp_through
from hil.experiments.cancellation.trial import Choice, choose
from hil.experiments.cancellation.verdict import PartVerdict
from hil.experiments.motions import constant_acceleration
from hil.reporter import SILENT, Reporter
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.rehearsal.survey import session_on

BENCH = load_bench("reference")
F_AL_HZ = 11.8
MOTION = constant_acceleration(BENCH, 2, 0.002)


@pytest.mark.parametrize("orders", [(4.0,), (2.0, 4.0), (2.9,)])
def test_the_ramp_passes_each_resonance_and_stays_in_the_motions_travel(orders: tuple[float, ...]) -> None:
    found = ramp_through(BENCH, 2, orders, F_AL_HZ, MOTION, 0.0)
    assert found.ramp.end_rps >= 1.15 * F_AL_HZ / min(orders)
    own, ramp = (each.motor_angle_rad[:, 0] for each in (MOTION, found.motion))
    assert own.min() <= ramp.min()
    assert ramp.max() <= own.max()
    # an order passes its resonance in many periods, unlike in the ramp that the bench asks for
    assert BENCH.constant_acceleration is not None
    assert found.ramp.acceleration_rps_s <= BENCH.constant_acceleration.acceleration_rps_s


def test_it_begins_where_the_motor_stands() -> None:
    found = ramp_through(BENCH, 2, (4.0,), F_AL_HZ, MOTION, 1.0)
    assert found.motion.motor_angle_rad[0, 0] == 0.0
    assert not found.motion.starts_at_home
    assert found.low_rev * math.tau == pytest.approx(1.0 + found.motion.motor_angle_rad[found.forward.start, 0])


def test_without_room_it_says_what_is_needed() -> None:
    limits = BENCH.axis[2].limits.model_copy(update={"position_min_rev": -0.6, "position_max_rev": 0.6})
    narrow = BENCH.model_copy(update={"axis": {**BENCH.axis, 2: BENCH.axis[2].model_copy(update={"limits": limits})}})
    with pytest.raises(NotPossibleError, match=r"axis 2 needs 6\.79 rev/s for it; .* it reaches .* rev/s"):
        ramp_through(narrow, 2, (2.0,), F_AL_HZ, MOTION, 0.0)


def test_a_ramp_is_no_faster_and_no_longer_than_the_motion_that_was_allowed() -> None:
    with pytest.raises(NotPossibleError, match=r"it reaches 10\.00 rev/s"):
        ramp_through(BENCH, 2, (1.0,), F_AL_HZ, MOTION, 0.0)
    short = replace(MOTION, motor_angle_rad=0.02 * MOTION.motor_angle_rad)
    with pytest.raises(NotPossibleError, match="travel and speed of the motion"):
        ramp_through(BENCH, 2, (4.0,), F_AL_HZ, short, 0.0)


class Steps(Reporter):
    """Steps of a trial."""

    def __init__(self) -> None:
        self.steps: list[str] = []

    def step(self, sentence: str) -> None:
        self.steps.append(sentence)


def choice_with(seed: int, turned: dict[float, float], times_noise: float = 1.0, reporter: Reporter = SILENT) -> Choice:
    """The trial's choice on a drawn robot with the true model, but for some phases and a noisier accelerometer."""
    robot, text = drawn(seed, "both")
    noisier = {"noise_m_s2": times_noise * robot.accelerometer.noise_m_s2}
    robot = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update=noisier)})
    bench, axis = loads(text, Bench, "bench"), min(robot.axis)
    true = robot.axis[axis].apparent_ate
    phases = {order: phase + turned.get(order, 0.0) for order, phase in true.phases_deg().items()}
    model: Identified = model_of(robot, bench, axis, TransmissionErrorTable.of(true.amplitudes_arcsec(), phases))
    with session_on(robot, bench) as session:
        session.adopt(with_identified(bench, model))
        motion = constant_acceleration(bench, axis, bench.bus.sync_period_s)
        cancellation = cancellation_on(session, model, motion)
        return choose(session, cancellation, motion, shows_filter=False, reporter=reporter)


def verdict_on(order: float, choice: Choice) -> PartVerdict:
    return next(each for each in choice.verification.verdicts if each.part.order == order)


@pytest.mark.slow
def test_an_order_hidden_in_the_ramps_jolt_is_judged_on_a_slow_ramp() -> None:
    """Order 4 of this robot passes its resonance while the ramp's start still rings."""
    right = choice_with(10282, {})
    assert verdict_on(4.0, right).verdict == "accepted"
    assert "order 4: with slow ramps, with 100 % of its cancellation it fell by" in verdict_on(4.0, right).words
    assert right.cancellation is not None
    assert 4.0 in {part.order for part in right.cancellation.parts}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10262, 10282])
@pytest.mark.parametrize("degrees", [60.0, 180.0])
def test_a_wrong_order_hidden_in_the_ramps_jolt_is_refused(seed: int, degrees: float) -> None:
    """With φ_4 60° off the tip of 10262 falls by a third at the resonance of order 4, by chance."""
    wrong = choice_with(seed, {4.0: degrees})
    assert verdict_on(4.0, wrong).verdict == "refused"
    assert wrong.cancellation is not None
    assert 4.0 not in {part.order for part in wrong.cancellation.parts}


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "verdict"), [(0.0, "accepted"), (60.0, "refused")])
def test_a_ramp_that_does_not_decide_is_run_again(degrees: float, verdict: str) -> None:
    """Six times the sensor's noise leaves one pair of ramps undecided, right or wrong."""
    told = Steps()
    made = choice_with(50273, {4.0: degrees}, 6.0, told)
    assert verdict_on(4.0, made).verdict == verdict
    ramps = [step for step in told.steps if "4: hidden; a ramp" in step]
    assert 4 <= len(ramps) <= 8
    assert all("once more, for the mean" in step for step in ramps[2:])


@pytest.mark.slow
def test_a_trial_whose_samples_do_not_show_the_arm_is_refused_in_words() -> None:
    """An arm of 39 Hz and a SYNC period of 8 ms, to which a caller comes with a model but without the check of a run."""
    with pytest.raises(NotPossibleError, match=r"a trial of the cancellation at a SYNC period of 8 ms: .* shorten sync_period_s"):
        choice_with(50105, {})


def test_words_name_the_ramp() -> None:
    seen = PartVerdict(Part(2, 4.0), 1.0, 0.97, 0.02, 0.03, 0.02, 0.0, 1.0, 0.02, 0.0, 1.0, "accepted")
    assert replace(seen, where="with slow ramps, ").words.startswith("axis 2, order 4: with slow ramps, with 100 %")
