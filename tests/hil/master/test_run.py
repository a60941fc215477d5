"""A cycle of a run: set-points, checks and rows are those of the specification in plain Python, to the last bit."""

import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.errors import OutOfRangeError
from drive_profiles.standard.units import POSITION_REVERSED, Scaling
from hil.bench.bench import load_bench
from hil.can.frame import Frame
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import ServoConfig
from hil.control.servo_bank import ServoBank
from hil.core.library import CORE
from hil.master.cyclic import FEEDBACK, FILTER_STATE, CyclicExchange
from hil.master.motion import Motion
from hil.master.run import ADDED_UP_TO, Run, RunStopError
from tests.oracles import run as specification
from tests.oracles.guard import Guard

PERIOD_S = 0.002
BENCH = load_bench("reference")
TABLE = BENCH.axis[2]
MISSING_LIMIT = 3
QUICK = BENCH.model_copy(
    update={"settle_s": 0.1, "approach_rps": 1.0, "bus": BENCH.bus.model_copy(update={"missing_limit": MISSING_LIMIT})}
)
SCALINGS = (
    Scaling(131072, 1.27),
    Scaling(4096, 0.5, polarity=POSITION_REVERSED),
    Scaling(1000, 3.0, gear_motor_revs=7, gear_shaft_revs=3, feed=360),
)
COUNT = len(SCALINGS)
CONFIGS = [ServoConfig(Cascade(25.0, 0.01 * n, 0.1 * n), TABLE.limits.torque_nm, (Notch(),)) for n in (1, 2, 3)]
STEP_RAD = ADDED_UP_TO * math.tau * TABLE.limits.speed_rps * PERIOD_S


class Adder:
    """Adds what the test says."""

    uses_torque = True

    def __init__(self):
        self.next = [0.0] * COUNT, [0.0] * COUNT
        self.told = []

    def step(self, references, positions, torques):
        self.told.append((references, positions, torques))
        return self.next


class Rig:
    """A run of three axes whose answers the test gives; nothing is sent."""

    def __init__(self, *, rows=64, adder=None, bank=None, torque_offset_nm=None):
        profile = SimpleNamespace(supported_modes=(), position_mode=None)
        axes = [SimpleNamespace(number=n + 2, scaling=each, profile=profile, table=TABLE) for n, each in enumerate(SCALINGS)]
        self.exchange = CyclicExchange(None, axes, None, PERIOD_S, loop="drive", with_notch_state=True)
        self.exchange.expect(
            {0x181 + n: (FEEDBACK, n) for n in range(COUNT)} | {0x281 + n: (FILTER_STATE, n) for n in range(COUNT)}
        )
        self.exchange.exchange = self.bring
        self.frames = []
        supervisor = SimpleNamespace(
            cycle=lambda exchange: exchange.exchange(), fault=lambda: None, network=SimpleNamespace(bus_errors=Counter())
        )
        times = PERIOD_S * np.arange(rows)
        motion = Motion((2, 3, 4), times, np.zeros((rows, COUNT)), starts_at_home=True, torque_offset_nm=torque_offset_nm)
        self.run = Run(motion, axes, self.exchange, QUICK, supervisor, [0.0] * COUNT, adder=adder, bank=bank)

    def bring(self):
        refused = CORE.call.begin_cycle(self.run.data, self.exchange.stretch)
        if refused:
            return refused
        CORE.call.await_answers(self.exchange.data)
        for frame in self.frames:
            assert self.exchange.take(frame)
        CORE.call.count_answers(self.exchange.data)
        self.exchange.stretch.done = 1
        return None

    def answer(self, row, word, counts, per_mille, notch_hz=0.0):
        data = word.to_bytes(2, "little") + counts.to_bytes(4, "little", signed=True)
        state = np.float32(notch_hz).tobytes()
        self.frames += [
            Frame(0x181 + row, data + per_mille.to_bytes(2, "little", signed=True)),
            Frame(0x281 + row, b"\1" + state),
        ]

    def set_points(self):
        return [slot.target for slot in self.exchange.slots], [slot.torque_offset for slot in self.exchange.slots]

    def send(self, references, row=None):
        """The set-points of a cycle; answers that stop the run are of no interest."""
        try:
            self.run.follow([references], row)
        except RunStopError as stop:
            if "torque offset" in stop.reason:
                raise specification.RefusedError from None


def halves(scale):
    """Angles at which counts are a half, or nearly so, and the largest there are."""
    near = st.integers(-50, 50).map(lambda n: (n + 0.5) / scale)
    ends = st.sampled_from([-(2.0**31), -(2.0**31) - 0.5, -(2.0**31) - 0.51, 2.0**31 - 1.0, 2.0**31 - 0.5, 2.0**31 - 0.51])
    return st.one_of(near, near.map(lambda x: math.nextafter(x, math.inf)), ends.map(lambda n: n / scale))


ANGLES = st.one_of(
    halves(131072 / math.tau),
    halves(-4096 / math.tau),
    st.floats(-100.0, 100.0),
    st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 1e300]),
)
MOST_NM = TABLE.limits.torque_nm
TORQUES = st.one_of(st.just(0.0), st.floats(-8.0, 8.0), st.sampled_from([MOST_NM, -MOST_NM, math.nan]))
ROWS = st.lists(st.tuples(*[ANGLES] * COUNT, *[TORQUES] * COUNT), min_size=1, max_size=6)


def outcome(function):
    try:
        return function()
    except (OutOfRangeError, specification.RefusedError) as error:
        return type(error), str(error)


@pytest.mark.ci
@given(ROWS)
def test_set_points_are_rounded_and_refused_as_the_scaling_does(rows):
    torques = np.array([row[COUNT:] for row in rows])
    rig, before = Rig(rows=len(rows), torque_offset_nm=torques), [0] * COUNT
    for number, row in enumerate(rows):

        def sent(row=row, number=number):
            rig.send(list(row[:COUNT]), number)
            return rig.set_points()

        limits = [MOST_NM] * COUNT
        wanted = outcome(lambda row=row: specification.targets(SCALINGS, row[:COUNT], row[COUNT:], limits, before))  # noqa: B023
        assert outcome(sent) == wanted
        before = rig.set_points()[1]


@given(st.lists(st.tuples(*[st.floats(-3.0 * STEP_RAD, 3.0 * STEP_RAD)] * COUNT, *[st.floats(-1.0, 1.0)] * COUNT), max_size=8))
def test_set_points_with_additions_stay_within_the_speed(rows):
    adder = Adder()
    rig, sent, before = Rig(adder=adder), None, [0] * COUNT
    for number, row in enumerate(rows):
        references = [0.01 * number * n for n in range(COUNT)]
        adder.next = row[:COUNT], np.array(row[COUNT:])
        wanted = [a + b for a, b in zip(references, row[:COUNT], strict=True)]
        sent = wanted if sent is None else specification.within_speed(wanted, sent, [STEP_RAD] * COUNT)
        rig.send(references)
        found = specification.targets(SCALINGS, sent, row[COUNT:], [MOST_NM] * COUNT, before)
        assert rig.set_points() == found
        before = found[1]


COUNTS = st.one_of(st.integers(-300, 300), st.sampled_from([-(2**31), 2**31 - 1, 22 * 4096, -22 * 4096 - 1]))
ANSWERS = st.one_of(
    st.none(), st.tuples(st.sampled_from([0x0637] * 9 + [0x0618]), COUNTS, st.integers(-900, 900), st.floats(0, 60))
)


@pytest.mark.ci
@pytest.mark.parametrize("loop", ["drive", "host"])
@given(st.lists(st.tuples(*[ANSWERS] * COUNT, st.floats(-3.0, 3.0), st.sampled_from([False] * 6 + [True])), max_size=30))
def test_a_cycle_checks_and_records_as_its_specification(loop, cycles):
    bank, other = (ServoBank(CONFIGS, PERIOD_S) if loop == "host" else None for _ in range(2))
    rig = Rig(bank=bank)
    guards, trusted = [Guard(TABLE, MISSING_LIMIT, PERIOD_S) for _ in SCALINGS], [0] * COUNT
    axes = [SimpleNamespace(status_word=0, position_counts=0, torque_per_mille=0, notch_hz=0.0, missing=0) for _ in SCALINGS]
    for number, (*answers, reference, is_dropped) in enumerate(cycles):
        references = [reference * (n + 1) for n in range(COUNT)]
        rig.frames.clear()
        for row, (axis, answer) in enumerate(zip(axes, answers, strict=True)):
            axis.missing += 1
            if answer is not None:
                axis.status_word, axis.position_counts, axis.torque_per_mille, notch_hz = answer
                axis.notch_hz, axis.missing = float(np.float32(notch_hz)), 0
                rig.answer(row, *answer)
        rig.exchange.was_dropped = is_dropped
        if not is_dropped:
            specification.discard_wild(axes, guards, SCALINGS, trusted)
        shown = [SimpleNamespace(**vars(axis)) for axis in axes]
        if other is not None:
            positions = [each.position_rad(axis.position_counts) for each, axis in zip(SCALINGS, axes, strict=True)]
            torques = other.step(references, positions)
            targets = [each.torque_per_mille(torque) for each, torque in zip(SCALINGS, torques, strict=True)]
            for axis, notch_hz in zip(shown, other.notch_hz, strict=True):
                axis.notch_hz = notch_hz
        missing = 2 * sum(answer is None for answer in answers)
        wanted = [number * PERIOD_S, *specification.row(shown, SCALINGS, references, (0.0, 0.0, 0.0), missing)]
        if is_dropped:
            found = 0, None
            for guard in guards:
                guard.skip()
        else:
            found = specification.check(axes, guards, SCALINGS, references)
        try:
            rig.run.follow([references], number)
            stopped = None
        except RunStopError as stop:
            stopped = stop.reason
        assert rig.run.table.values[number].tolist() == wanted
        assert rig.run.table.rows == number + 1
        assert [slot.position_counts for slot in rig.exchange.slots] == [axis.position_counts for axis in axes]
        assert rig.run.discarded == sum(guard.discarded for guard in guards)
        if other is not None:
            assert rig.set_points()[0] == targets
        assert (stopped is None) == (found[1] is None)
        if found[1] is not None:
            assert f"axis {found[1] + 2} " in str(stopped)
            break


def test_an_adder_is_told_what_was_measured_last():
    adder = Adder()
    rig = Rig(adder=adder)
    for row in range(COUNT):
        rig.answer(row, 0x0637, 10 * row, row)
    rig.run.follow([[0.0] * COUNT])
    rig.run.follow([[0.0] * COUNT])
    references, positions, torques = adder.told[-1]
    assert references == [0.0] * COUNT
    assert positions == [each.position_rad(10 * row) for row, each in enumerate(SCALINGS)]
    assert torques == [each.torque_nm(row) for row, each in enumerate(SCALINGS)]


def test_set_points_of_other_than_all_axes_are_refused():
    rig = Rig()
    for references in ([0.0] * (COUNT - 1), [0.0] * (COUNT + 1)):
        with pytest.raises(ValueError, match="3"):
            rig.run.follow([references])


@pytest.mark.parametrize("row", [-1, 64])
def test_a_row_that_the_motion_has_not_is_refused(row):
    with pytest.raises(IndexError, match=f"rows {row} to {row} of a motion of 64 rows"):
        Rig().run.follow([[0.0] * COUNT], row)
