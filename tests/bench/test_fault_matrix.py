"""Faults × phases of a line motion, in virtual time: what the drives and the master do, and how soon. T is the SYNC period.

Two faults of the list are not here. Two nodes with one id: nothing finds them at bring-up yet. Disk full and killed in an upload:
tests/drive_profiles (test_upload_faults, test_snapshot).
"""

import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from drive_profiles.standard.cia402 import State
from hil.can.frame import Frame
from hil.errors import HilError
from hil.experiments.motions import constant_acceleration
from hil.experiments.plan import Experiment, entries
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.faults import BusFaults
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.bench.conftest import with_bus, with_motion
from tests.bench.fault_rig import (
    MASTER,
    NODES,
    PHASES,
    RATE,
    T_S,
    Outcome,
    Rig,
    bench,
    check_the_end,
    cycle_of,
    fastest_rps,
    fresh_rows,
    on_the_wire,
    undisturbed,
)

HEARTBEAT_S = 0.3
"""A drive stops by itself when the master's heartbeat has been missing so long."""
RAMP_S = 12.0 / 50.0
"""The longest quick stop: from the highest speed at the bench's deceleration."""


@dataclass(frozen=True)
class Case:
    """A fault and the reaction to it.

    Attributes:
        name: Its number in the list, and what it is.
        faults: Of the wire, from a cycle on; None: an ideal bus.
        act: Called at every SYNC.
        within: In how many T the master commands the stop; None: the run goes on to its end.
        words: What the reason says.
        check: What else holds.
        loose: Phases in which the reaction may also be none, the fault then having met nothing that counts.
        skips: Cycles in a row for which a drive has no new set-point. The next one is then further away, and where that is
            further than 6080h allows, the drive refuses it with a fault of its own, and everything stops.
        lasts: Cycles of the fault, where that may happen in any of them.
    """

    name: str
    faults: Callable[[int, str | None], BusFaults] | None = None
    act: Callable[[Rig, int], None] = lambda rig, number: None
    within: int | None = None
    words: str = ""
    check: Callable[[Rig, Outcome, str], None] = lambda rig, outcome, phase: None
    loose: tuple[str, ...] = ()
    skips: int = 0
    lasts: int = 1

    @property
    def bitrate(self) -> int | None:
        """Bit times where the fault is one of the wire."""
        return None if self.faults is None else RATE


def once(what: Callable[[Rig], object]) -> Callable[[Rig, int], None]:
    """Do it in the cycle of the fault."""
    return lambda rig, number: what(rig) and None if number == rig.at else None


def wire(cycles: int | None, *faults: dict[str, object]) -> Callable[[int, str | None], BusFaults]:
    """Faults of the wire that last so many cycles."""
    return lambda at, family: on_the_wire(at, cycles, *faults, family=family)


# -- what holds beside the stop --------------------------------------------------------------------------------------------


def _torque_steps(outcome: Outcome) -> np.ndarray:
    return np.max(np.abs(np.diff(np.array(outcome.tape.torque_nm), axis=0)), axis=0)


def no_wild_torque(rig: Rig, outcome: Outcome, phase: str) -> None:
    """No axis' torque steps further in a cycle than half of what it may give."""
    limits = [rig.bench.axis[node].limits.torque_nm for node in NODES]
    assert np.all(_torque_steps(outcome) <= 0.5 * np.array(limits))


def counted(number: int) -> Callable[[Rig, Outcome, str], None]:
    """So many cycles lack an answer, where the fault falls into the motion; and afterwards all that is recorded is fresh."""

    def check(rig: Rig, outcome: Outcome, phase: str) -> None:
        assert outcome.result is not None
        if phase in ("acceleration", "constant", "deceleration"):
            assert outcome.result.missed_cycles == number
        rows, good = fresh_rows(outcome, rig.at + 8)
        assert good == rows, "older data stay in the place of newer ones"
        no_wild_torque(rig, outcome, phase)

    return check


def forgotten(rig: Rig, outcome: Outcome, phase: str) -> None:
    """The position that cannot be was forgotten, and is in no row."""
    assert outcome.result is not None
    if phase in ("acceleration", "constant", "deceleration"):
        assert outcome.result.discarded == 1
    assert np.max(np.abs(np.diff(outcome.result.recording.axis(2, "position_rad")))) < 1.0
    no_wild_torque(rig, outcome, phase)


def drives_stop_by_themselves(rig: Rig, outcome: Outcome, phase: str) -> None:
    """All drives that were in operation leave it within the heartbeat's time, counted from its last one."""
    rig.pass_time(1.0)
    for node in NODES:
        left = outcome.left_operation_at_ns(node)
        if left is not None:
            assert 1e-9 * (left - outcome.tape.now_ns[rig.at]) <= HEARTBEAT_S + 2 * T_S


def recording_is_invalid(rig: Rig, outcome: Outcome, phase: str) -> None:
    """No metric of a motion without its sensor; the axes have not noticed."""
    assert outcome.result is not None
    if phase in ("settle", "acceleration", "constant"):
        entry = entries(rig.bench, Experiment("line-motion", None, "none"), outcome.result, "")[0]
        assert "accelerometer was missing" in (entry.invalid or "")
        assert entry.within_spec is None
    same = undisturbed(RATE).result
    assert same is not None
    for node in NODES:
        column = f"axis{node}_position_rad"
        np.testing.assert_array_equal(outcome.result.recording.columns[column], same.recording.columns[column])


def same_as_undisturbed(rig: Rig, outcome: Outcome, phase: str) -> None:
    """Bit for bit."""
    same = undisturbed(None).result
    assert outcome.result is not None
    assert same is not None
    for name, column in outcome.result.recording.columns.items():
        np.testing.assert_array_equal(column, same.recording.columns[name])


# -- how it is done --------------------------------------------------------------------------------------------------------


def freeze(rig: Rig) -> None:
    """The master sleeps for a second, and the world does not."""
    rig.pass_time(1.0)
    assert all(rig.world.drives[node].state is not State.OPERATION_ENABLED for node in NODES)


def power_cycle(rig: Rig) -> None:
    """The supply of the drive of axis 2 goes and comes; its boot-up message is heard."""
    rig.channel.hand_over(*rig.world.power_cycle(2))


def inject(can_id: int, data: str) -> Callable[[Rig, int], None]:
    """A stranger's frame, once."""
    return once(lambda rig: rig.channel.inject(Frame(can_id, bytes.fromhex(data))))


def fault_of_a_drive(rig: Rig) -> None:
    """Over-temperature, say."""
    rig.world.drives[3]._fault("motor speed", 0x8400)


def lose_the_bus(rig: Rig) -> None:
    """The interface is gone."""
    rig.channel.lost = True


def babble(rig: Rig) -> None:
    """The accelerometer's controller sends a frame of the highest priority but one, without end."""
    rig.disturb("babble", 16, Frame(0x001, bytes(8)))


def bus_off(rig: Rig, number: int) -> None:
    """The master's controller is bus-off, and comes back after half a second."""
    if number == rig.at:
        rig.disturb("bus_off", MASTER)
    elif number == rig.at + 250:
        rig.disturb("restart", MASTER)


def bus_comes_back(rig: Rig, outcome: Outcome, phase: str) -> None:
    """The drives have stopped by themselves, and nothing is sent into the bus that is there again."""
    drives_stop_by_themselves(rig, outcome, phase)
    assert any("the bus" in words for words in outcome.session.not_restored)
    rig.channel.lost = False


def not_confirmed(rig: Rig, outcome: Outcome, phase: str) -> None:
    """The result does not call disabled what has not been heard."""
    assert outcome.stopped is not None
    assert not outcome.stopped.all_disabled
    drives_stop_by_themselves(rig, outcome, phase)


def deaf_axis_is_named(rig: Rig, outcome: Outcome, phase: str) -> None:
    """The drive hears no set-point any more: at the latest when it is to be disabled, the run says so."""
    assert outcome.stopped is not None
    assert phase == "enable" or not outcome.stopped.all_disabled
    assert rig.world.drives[2].state is not State.OPERATION_ENABLED, "SDO and NMT have done it"
    assert abs(outcome.tape.torque_nm[-1][0]) < rig.bench.axis[2].limits.torque_nm


def others_have_stopped(rig: Rig, outcome: Outcome, phase: str) -> None:
    """And all say so, or SDO does."""
    assert all(rig.world.drives[node].state is not State.OPERATION_ENABLED for node in NODES)


LOST_RPDO, LOST_TPDO = {"kind": "drop", "can_id": 0x202, "port": MASTER}, {"kind": "drop", "can_id": 0x182, "port": 2}
SYNC_LOST = {"kind": "drop", "can_id": 0x080, "port": MASTER}
WILD = {"kind": "corrupt", "crc": False, "bits": (46,)}
"""Bit 30 of the position behind a word of 16 bits: 8192 revolutions."""

CASES = [
    Case("01 one RPDO lost", wire(1, LOST_RPDO), check=counted(0), skips=1),
    Case("02 RPDOs of one axis lost", wire(None, LOST_RPDO), within=2300, words="confirmed|not all drives|behind|8400h|8612h",
         check=deaf_axis_is_named),
    Case("03 one TPDO lost", wire(1, LOST_TPDO), check=counted(1)),
    Case("04 TPDOs of one axis lost", wire(None, LOST_TPDO), within=3, words="axis 2 (has not answered|does not answer)",
         check=others_have_stopped),
    Case("05 SYNC lost once", wire(1, SYNC_LOST), check=counted(1), skips=1),
    Case("05 SYNC lost for good", wire(None, SYNC_LOST), within=3, words="answer", check=others_have_stopped),
    Case("06 answers twice", wire(2, {"kind": "duplicate", "can_id": 0x180, "mask": 0x780}), check=counted(0)),
    Case("06 set-points twice", wire(3, {"kind": "duplicate", "can_id": 0x200, "mask": 0x780, "port": MASTER}), check=counted(0)),
    Case("06 sensor's frame twice", wire(1, {"kind": "duplicate", "can_id": 0x190}), check=counted(0)),
    Case("06 answer late by more than T", wire(1, {**LOST_TPDO, "kind": "delay", "delay_ns": 2_200_000}), check=counted(1)),
    Case("06 all answers late by more than T", wire(1, {"kind": "delay", "can_id": 0x180, "mask": 0x780, "delay_ns": 2_200_000}),
         check=counted(1)),
    Case("06 answer late by more than half of T", wire(1, {**LOST_TPDO, "kind": "delay", "delay_ns": 1_050_000}),
         check=counted(0)),
    Case("06 set-point late by more than T", wire(1, {**LOST_RPDO, "kind": "delay", "delay_ns": 2_200_000}),
         check=counted(0), skips=1),
    Case("06 set-points out of order", wire(3, {"kind": "reorder", "can_id": 0x200, "mask": 0x780, "port": MASTER,
                                                "delay_ns": 300_000}),
         check=counted(0), skips=1, lasts=3),
    Case("07 answer corrupted", wire(1, {**WILD, "can_id": 0x182, "port": 2}), check=forgotten),
    Case("07 two answers corrupted", wire(2, {**WILD, "can_id": 0x182, "port": 2}), within=4, words="axis 2 turns at",
         loose=("enable",), check=no_wild_torque),
    Case("07 set-point corrupted", wire(1, {**WILD, "can_id": 0x202, "port": MASTER}), within=3, words="node 2 reports",
         loose=("enable",), check=no_wild_torque),
    Case("08 RPDO too short", None, inject(0x202, "0F00"), within=1, words="8210h"),
    Case("08 RPDO too long", None, inject(0x202, "0F000000000000 00"), within=1, words="82[12]0h", loose=PHASES),
    Case("08 TPDO too short", None, inject(0x182, "3716"), check=same_as_undisturbed),
    Case("09 master frozen for 1 s", None, once(freeze), within=1, words="8130h|left operation|heartbeat|reports"),
    Case("10 drive loses its supply", None, once(power_cycle), within=1, words="node 2 has been reset"),
    Case("10 drive reset by NMT", None, inject(0x000, "8202"), within=1, words="node 2 has been reset"),
    Case("11 pre-operational by a stranger", None, inject(0x000, "8002"), within=3, words="axis 2|node 2"),
    Case("11 stopped by a stranger", None, inject(0x000, "0202"), within=3, words="axis 2|node 2"),
    Case("11 all stopped by a stranger", None, inject(0x000, "0200"), within=3, words="axis|node"),
    Case("12 emergency", None, inject(0x083, "1042020000000000"), within=1, words="node 3 reports emergency 4210h"),
    Case("12 drive fault", None, once(fault_of_a_drive), within=2, words="node 3 reports emergency 8400h"),
    Case("13 babbling idiot", wire(None), once(babble), within=4, words="answer", check=not_confirmed),
    Case("14 bus lost", None, once(lose_the_bus), words="pulled", within=0, check=bus_comes_back),
    Case("14 master bus-off for half a second", wire(None), bus_off, within=4, words="answer",
         check=drives_stop_by_themselves),
    Case("16 accelerometer silent", wire(None, {"kind": "drop", "can_id": 0x190}), check=recording_is_invalid),
]  # fmt: skip

FIRST = {case.name[:2]: case.name for case in reversed(CASES)}
CI = {
    case.name: (PHASES[(index + 2) % 6], *([PHASES[(index + 5) % 6]] if case.name in FIRST.values() else []))
    for index, case in enumerate(CASES)
}
"""For CI, two phases for each fault and one for its variants; the others in the slow run."""


def cells() -> Iterator[object]:
    """Every fault in every phase; each fault in one of them every day."""
    for case in CASES:
        for phase in PHASES:
            everyday = case.name in FIRST.values() and phase == CI[case.name][0]
            marks = () if everyday else (pytest.mark.ci,) if phase in CI[case.name] else (pytest.mark.slow,)
            yield pytest.param(case, phase, marks=marks, id=f"{case.name}-{phase}")


@pytest.mark.parametrize(("case", "phase"), list(cells()))
def test_a_fault_is_answered_in_time_and_leaves_no_torque(case: Case, phase: str) -> None:
    at = cycle_of(phase, case.bitrate)
    rig = Rig(bitrate=case.bitrate, faults=case.faults(at, None) if case.faults else None, at=at, act=case.act)
    outcome = rig.run()
    assert outcome.error is None
    if case.skips and outcome.stopped is not None:
        # the step of the set-point is (1 + skips) T of travel; a tick of 250 µs may be missing where SYNC shakes
        assert (1 + case.skips) * fastest_rps(at, RATE) > 0.85 * rig.bench.axis[2].limits.speed_rps
        assert "8612h" in outcome.stopped.reason
        assert outcome.stop_word_at is not None
        assert outcome.stop_word_at - at <= case.skips + case.lasts + 1
        others_have_stopped(rig, outcome, phase)
        check_the_end(rig, outcome)
        return
    if case.within is None or (outcome.stopped is None and phase in case.loose):
        assert outcome.stopped is None, outcome.stopped
    else:
        assert outcome.stopped is not None
        assert re.search(case.words, outcome.stopped.reason), outcome.stopped.reason
        if case.within:  # 0: there is no bus to command a stop on
            assert outcome.stop_word_at is not None
            assert outcome.stop_word_at - at <= case.within, outcome.stopped.reason
    case.check(rig, outcome, phase)
    check_the_end(rig, outcome)


# -- faults without a phase ------------------------------------------------------------------------------------------------


def test_a_saturated_accelerometer_does_not_move_the_axes() -> None:
    whole = load_robot("reference")
    sensor = whole.accelerometer.model_copy(update={"range_m_s2": 0.02})
    rig = Rig(robot=whole.model_copy(update={"accelerometer": sensor}))
    outcome = rig.run()
    same = undisturbed(None).result
    assert outcome.stopped is None
    assert outcome.result is not None
    assert same is not None
    assert np.max(np.abs(outcome.result.recording.columns["tip_z_m_s2"])) <= 0.021
    for node in NODES:
        column = f"axis{node}_position_rad"
        np.testing.assert_array_equal(outcome.result.recording.columns[column], same.recording.columns[column])
    check_the_end(rig, outcome)


def test_a_noisy_speed_switches_the_notch_at_most_twice_a_crossing() -> None:
    """17: the encoder ten times as coarse, so the speed that the notch follows is ten times as noisy."""
    whole = load_robot("reference")
    axes = {n: a.model_copy(update={"encoder_counts_per_rev": a.encoder_counts_per_rev // 10}) for n, a in whole.axis.items()}
    # up through 4 rps, where the notch begins, as slowly as it goes, and down again
    motion = with_motion(with_bus(bench(), answer_timeout_s=0.02), acceleration_rps_s=4.0, end_rps=5.0, tail_s=0.1)
    found = []
    for robot in (whole, whole.model_copy(update={"axis": axes})):
        with Session(motion, InProcessChannel(World(robot)), BusLog(None)) as session:
            session.bring_up()
            result = session.run(constant_acceleration(motion, 2, T_S), "notch", "drive")
        assert result.stopped is None
        active = result.recording.axis(2, "notch_hz") > 0.0
        step = float(np.abs(np.diff(result.recording.axis(2, "torque_nm"))).max())
        found.append((int(np.sum(np.diff(active.astype(int)) != 0)), step))
    (_, quiet_step), (switches, noisy_step) = found
    assert 2 <= switches <= 4
    assert noisy_step <= 3.0 * quiet_step + 0.02 * motion.axis[2].limits.torque_nm


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_the_wall_clock_changes_nothing(step_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """18."""
    real = time.time

    def act(rig: Rig, number: int) -> None:
        if number == rig.at:
            monkeypatch.setattr(time, "time", lambda: real() + step_s)

    rig = Rig(at=cycle_of("constant", None), act=act)
    outcome = rig.run()
    assert outcome.stopped is None
    same_as_undisturbed(rig, outcome, "constant")
    check_the_end(rig, outcome)


class Stalled:
    """A monotonic clock that stands still from a time on."""

    def __init__(self) -> None:
        self.stands = False
        self._at = 0.0

    def now(self) -> float:
        self._at = self._at if self.stands else time.monotonic()
        return self._at

    def sleep_until(self, instant_s: float) -> None:
        raise AssertionError("nobody sleeps in lock-step")


def test_a_monotonic_clock_that_stalls_in_the_motion_changes_nothing() -> None:
    """18: in lock-step; what a late master does on the wall clock is tested in tests/hil/master/test_lateness.py."""
    clock = Stalled()

    def act(rig: Rig, number: int) -> None:
        clock.stands = rig.at <= number < rig.at + 100

    rig = Rig(at=cycle_of("constant", None), act=act, clock=clock)
    outcome = rig.run()
    assert outcome.stopped is None
    same_as_undisturbed(rig, outcome, "constant")
    check_the_end(rig, outcome)


ANSWERS = {
    "silence": None,
    "abort": bytes.fromhex("8000000000000008"),
    "garbage": bytes.fromhex("E5A5F00D00FF1122"),
    "too short": b"\x43",
    "of another object": bytes.fromhex("4364600078563412"),
}


@pytest.mark.parametrize("after", [0, 40, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 20, 80))])
@pytest.mark.parametrize("answer", ANSWERS)
def test_an_sdo_server_that_fails_in_bring_up_is_a_clear_error_and_nothing_is_enabled(answer: str, after: int) -> None:
    """19: from the n-th answer of node 3 on."""
    rig, seen = Rig(), [0]

    def passes(frame: Frame) -> bool:
        if frame.can_id != 0x583:
            return True
        seen[0] += 1
        if seen[0] <= after:
            return True
        data = ANSWERS[answer]
        if data is not None:
            rig.channel.hand_over(Frame(0x583, data))
        return False

    rig.channel.passes = passes
    outcome = rig.run()
    assert isinstance(outcome.error, HilError)
    assert "node 3" in str(outcome.error)
    assert not any(State.OPERATION_ENABLED in states for states in rig.tape.states)
    assert math.isclose(float(np.abs(np.array(rig.tape.torque_nm)).max()), 0.0, abs_tol=0.0)
    rig.channel.passes = lambda frame: True
    check_the_end(rig, outcome)
