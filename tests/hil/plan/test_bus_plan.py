"""The plan of a bus against figures reckoned by hand, what the master really sends, and what must hold for every plan.

By hand: a classic frame of n bytes with an 11-bit identifier has 47 + 8 n bits with its intermission, and at worst
⌊(34 + 8 n − 1)/4⌋ stuff bits more, 55 + 10 n for whole bytes (R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller
Area Network (CAN) schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35 (2007)). So
0, 2, 4, 6 and 8 bytes are 47, 63, 79, 95 and 111 bits without stuff bits and 55, 75, 95, 115 and 135 at worst.
"""

import math
import random

import can
import can.util
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import FunctionCode
from hil.bench.bench import load_bench
from hil.can.bits import frame_bits
from hil.can.frame import Frame
from hil.errors import NotPossibleError
from hil.experiments.motions import constant_acceleration
from hil.master.session import Session
from hil.plan import advice as bus_advice
from hil.plan.bus_plan import Background, Cycle, CyclicFrame
from hil.plan.check import check, is_ideal, plan_cycle, stability
from hil.plan.response_time import Message, response_ns
from hil.plan.wire import FD_LENGTHS, WireTiming, fd_worst_bits
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.oracles.can_fd import counted_fd

MEGABIT = WireTiming(1_000_000)
BENCH = load_bench("reference")
NODES = (1, 2, 3, 4, 5, 6)


def with_bus(**changes):
    return BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update=changes)})


def cycle_of(axes, command, feedback, period_s=1e-3, heartbeat_s=0.1, sensor=0):
    """SYNC, and for each axis an RPDO and a TPDO of so many bytes."""

    def bytes_(count):
        return tuple(("B", 0, 255) for _ in range(count))

    commands = [CyclicFrame(f"c{n}", "command", 0x200 + n, bytes_(command), n) for n in range(1, axes + 1)]
    answers = [CyclicFrame(f"f{n}", "feedback", 0x180 + n, bytes_(feedback), n) for n in range(1, axes + 1)]
    if sensor:
        answers.append(CyclicFrame("acceleration", "acceleration", 0x190, bytes_(sensor)))
    frames = (*commands, CyclicFrame("SYNC", "sync", 0x80), *answers)
    return Cycle(frames, period_s, Background((*range(1, axes + 1), 127), heartbeat_s))


# -- figures by hand -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "period_s", "worst", "load", "frames_per_s"),
    [(3, 2e-3, 865, 0.43, 3500), (6, 4e-3, 1675, 0.42, 3250), (6, 2e-3, 1675, 0.84, 6500), (1, 250e-6, 325, 1.30, 12000)],
)
def test_the_table_of_loads_to_hold(axes, period_s, worst, load, frames_per_s):
    """8 bytes each way: 55 + 2 · 135 · axes bits, so 865 for three; at 1 Mbit/s a bit is 1 µs."""
    cycle = cycle_of(axes, 8, 8, period_s)
    assert cycle.worst_bits == worst
    assert cycle.load(MEGABIT) == pytest.approx(load, abs=0.005)
    assert len(cycle.frames) / period_s == pytest.approx(frames_per_s)


@pytest.mark.parametrize(("axes", "nominal", "worst"), [(1, 221, 265), (3, 569, 685), (6, 1091, 1315)])
def test_host_closed_cycles_of_six_and_four_bytes(axes, nominal, worst):
    """SYNC, TPDO of 6 bytes, RPDO of 4: 47 + (95 + 79) · axes bits, at worst 55 + (115 + 95) · axes."""
    cycle = cycle_of(axes, 4, 6)
    assert (cycle.nominal_bits, cycle.worst_bits) == (nominal, worst)


def torque_cycle(axes, period_s=1e-3):
    """Control word and torque out, status word and position in: 4 bytes and 6."""
    commands = [CyclicFrame(f"c{n}", "command", 0x200 + n, (("H", 0, 31), ("h", -9, 9)), n) for n in NODES[:axes]]
    answers = [CyclicFrame(f"f{n}", "feedback", 0x180 + n, (("H", 0, 31), ("i", -9, 9)), n) for n in NODES[:axes]]
    frames = (*commands, CyclicFrame("SYNC", "sync", 0x80), *answers)
    return Cycle(frames, period_s, Background((*NODES[:axes], 127)))


@pytest.mark.parametrize(("axes", "before", "nominal", "worst"), [(1, 221, 189, 225), (3, 569, 379, 455), (6, 1091, 711, 855)])
def test_packed_frames(axes, before, nominal, worst):
    """Position alone (4 bytes), torques of up to four axes in one RPDO: for three axes 47 + 3 · 79 + 95 bits."""
    cycle = torque_cycle(axes)
    packed = bus_advice.packed(cycle)
    assert cycle.nominal_bits == before
    assert (packed.nominal_bits, packed.worst_bits) == (nominal, worst)
    assert len(packed.of("command")) == math.ceil(axes / 4)


def test_the_bench_mapping_of_one_axis_has_the_torque_in_its_answer_as_well():
    """4 bytes out and 8 in: 47 + 79 + 111 bits, at worst 55 + 95 + 135; the accelerometer's 6 bytes beside them."""
    cycle = plan_cycle(BENCH, (2,), "host", 250e-6, notch_state=False)
    without = [frame for frame in cycle.frames if frame.kind != "acceleration"]
    assert sum(frame.nominal_bits for frame in without) == 237
    assert sum(frame.worst_bits for frame in without) == 285
    sensor = cycle.of("acceleration")[0]
    assert (sensor.nominal_bits, sensor.worst_bits) == (95, 115)


def test_three_host_closed_axes_fit_at_one_kilohertz_and_not_much_faster():
    """docs/bus.md: 925 µs for three axes, 465 µs for one and the accelerometer."""
    assert check(BENCH, (2, 3, 5), "host", 1e-3, bitrate=1_000_000).fits
    assert not check(BENCH, (2, 3, 5), "host", 900e-6, bitrate=1_000_000).fits
    assert not check(BENCH, (2,), "host", 250e-6, bitrate=1_000_000).fits


# -- response times --------------------------------------------------------------------------------------------------------


def davis_burns(name, priority, period_ms, deadline_ms):
    return Message(name, priority, 1_000_000, int(period_ms * 1e6), int(deadline_ms * 1e6))


def test_the_example_that_refuted_the_analysis_of_1994():
    """Davis, Burns, Bril, Lukkien 2007, section 3.2: 125 bits at 125 kbit/s; the second instance of C is the late one."""
    a, b, c = davis_burns("A", 1, 2.5, 2.5), davis_burns("B", 2, 3.5, 3.25), davis_burns("C", 3, 3.5, 3.25)
    bit_ns = 8_000
    assert response_ns(a, (b, c), bit_ns) == 2_000_000
    assert response_ns(b, (a, c), bit_ns) == 3_000_000
    assert response_ns(c, (a, b), bit_ns) == 3_500_000 > c.deadline_ns


def test_a_full_bus_has_no_bound():
    hog, other = Message("hog", 1, 500, 1000, 1000), Message("other", 2, 500, 1000, 1000)
    assert response_ns(other, (hog,), 1) is None
    assert response_ns(hog, (other,), 1) == 1000


def simulated_worst(messages, rounds, draw):
    """The bus in ns steps of whole frames: random phases, the lowest identifier first, never interrupted."""
    worst = dict.fromkeys((message.name for message in messages), 0)
    for _ in range(rounds):
        due = {message: draw.randrange(message.period_ns) for message in messages}
        now = 0
        while now < 20 * max(message.period_ns for message in messages):
            ready = [message for message in messages if due[message] <= now]
            if not ready:
                now = min(due.values())
                continue
            first = min(ready, key=lambda message: message.priority)
            now += first.length_ns
            worst[first.name] = max(worst[first.name], now - due[first])
            due[first] += first.period_ns
    return worst


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(10, 90)), min_size=2, max_size=5), st.integers(0, 999))
@settings(max_examples=40)
def test_no_simulated_bus_is_later_than_the_bound(drawn, seed):
    messages = [Message(f"m{i}", i, length, period, period) for i, (length, period) in enumerate(drawn)]
    bounds = {m.name: response_ns(m, [other for other in messages if other is not m], 1) for m in messages}
    for name, seen in simulated_worst(messages, 5, random.Random(seed)).items():
        bound = bounds[name]
        assert bound is None or seen <= bound


# -- what holds for every plan ---------------------------------------------------------------------------------------------

sizes = st.integers(0, 8)
cycles = st.builds(cycle_of, st.integers(1, 6), sizes, sizes, sensor=st.sampled_from((0, 6)))


@pytest.mark.ci
@given(cycles)
@settings(max_examples=50)
def test_bits_are_nominal_typical_worst_in_that_order(cycle):
    assert cycle.nominal_bits <= cycle.typical_bits <= cycle.worst_bits
    zeros = sum(frame_bits(Frame(frame.can_id, bytes(frame.length))) for frame in cycle.frames)
    assert cycle.nominal_bits <= zeros <= cycle.worst_bits


@given(cycles, st.sampled_from((125_000, 250_000, 500_000)))
@settings(max_examples=50)
def test_load_scales_with_bit_rate_and_period(cycle, bitrate):
    assert cycle.load(WireTiming(2 * bitrate)) == pytest.approx(cycle.load(WireTiming(bitrate)) / 2, rel=1e-4)
    assert cycle.at(2 * cycle.period_s).load(MEGABIT) == pytest.approx(cycle.load(MEGABIT) / 2)


@given(sizes, sizes, st.integers(1, 5))
@settings(max_examples=50)
def test_another_axis_never_shortens_the_period(command, feedback, axes):
    fewer, more = (cycle_of(count, command, feedback).shortest_period_s(MEGABIT) for count in (axes, axes + 1))
    assert fewer < more


@given(cycles)
@settings(max_examples=50)
def test_the_shortest_period_is_one_and_a_nanosecond_less_is_none(cycle):
    shortest = cycle.shortest_period_s(MEGABIT)
    assert cycle.at(shortest).delay_periods(MEGABIT) == 1
    assert cycle.at(shortest - 2e-9).delay_periods(MEGABIT) != 1
    assert shortest * 1e9 >= cycle.worst_ns(MEGABIT)
    assert cycle.shortest_period_s(MEGABIT, margin=0.1) == pytest.approx(shortest / 0.9)


@given(cycles, st.sampled_from((500_000, 1_000_000)))
@settings(max_examples=50)
def test_nothing_arrives_sooner_than_it_lasts_and_company_makes_nothing_faster(cycle, bitrate):
    wire = WireTiming(bitrate)
    lengths = {frame.name: wire.worst_ns(frame.length) for frame in cycle.frames}
    responses = cycle.at(5e-3).responses(wire)
    assert {response.name for response in responses} >= set(lengths)
    for response in responses:
        assert response.quiet_ns is not None
        assert response.busy_ns is not None
        assert lengths.get(response.name, 0) <= response.quiet_ns <= response.busy_ns
    sync = next(response for response in responses if response.name == "SYNC")
    answers = {frame.name for frame in cycle.frames if frame.is_answer}
    assert all(r.quiet_ns > sync.quiet_ns for r in responses if r.name in answers)


@given(st.sampled_from(FD_LENGTHS), st.integers(0, 0x7FF), st.data())
def test_no_fd_frame_is_longer_than_the_worst(length, can_id, data):
    slow, fast = counted_fd(can_id, data.draw(st.binary(min_size=length, max_size=length)))
    worst_slow, worst_fast = fd_worst_bits(length)
    assert slow <= worst_slow
    assert fast <= worst_fast


def test_the_lengths_of_can_fd_are_those_of_python_can():
    assert list(FD_LENGTHS) == can.util.CAN_FD_DLC


def test_worst_contents_of_an_fd_frame_come_close():
    found, (slow, fast) = counted_fd(0, bytes(8)), fd_worst_bits(8)
    assert slow + fast - sum(found) <= 20
    with pytest.raises(ValueError, match="65"):
        fd_worst_bits(65)


# -- the bench -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("loop", "compensation"), [("drive", "none"), ("drive", "notch"), ("host", "none")])
def test_the_plan_is_what_the_master_sends(loop, compensation):
    """Every cyclic frame of a run, by identifier and length."""
    motion = BENCH.constant_acceleration.model_copy(update={"acceleration_rps_s": 8.0, "end_rps": 1.0, "tail_s": 0.05})
    bench = with_bus(answer_timeout_s=0.05).model_copy(update={"constant_acceleration": motion})
    channel = InProcessChannel(World(load_robot("reference")))
    seen = []

    def keep(frame):
        if 0x180 <= frame.can_id < 0x580:
            seen[-1].add((frame.can_id, len(frame.data)))
        return True

    channel.on_sync = lambda number: seen.append({(f.can_id, len(f.data)) for f in [*channel.sent][-2:-1] if f.can_id < 0x580})
    channel.passes = lambda frame: not seen or keep(frame)
    period = 250e-6 if loop == "host" else 1e-3
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        session.run(constant_acceleration(bench, 2, period), compensation, loop)
    plan = plan_cycle(bench, (2,), loop, period, notch_state=loop == "drive" and compensation == "notch")
    expected = {(frame.can_id, frame.length) for frame in plan.frames if frame.can_id != FunctionCode.SYNC}
    middle = seen[len(seen) // 2]
    assert middle == expected
    assert [frame.kind for frame in plan.frames[:2]] == ["command", "sync"]


def test_a_bus_without_bit_times_carries_everything():
    verdict = check(BENCH, (2, 3), "host", 250e-6)
    assert is_ideal(BENCH)
    assert verdict.fits
    assert verdict.is_stable
    assert verdict.is_good
    assert verdict.delay_periods == 1


def test_a_bus_that_does_not_say_its_bit_rate_is_not_judged_unless_none_would_do():
    bench = with_bus(address="socketcan:can0")
    assert check(bench, (2, 3, 5), "drive", 2e-3).fits is None
    assert "from 800 kbit/s on" in check(bench, (2, 3, 5), "drive", 2e-3, True).sentence
    impossible = check(bench, (2, 3, 5), "host", 250e-6)
    assert impossible.fits is False
    assert "even at 1 Mbit/s" in impossible.sentence


def test_the_bit_rate_of_the_address_counts_and_the_option_goes_before_it():
    bench = with_bus(address="socketcan:can0@500k")
    assert check(bench, (2, 3, 5), "drive", 2e-3, True).fits is False
    assert check(bench, (2, 3, 5), "drive", 2e-3, True, bitrate=1_000_000).fits


def test_the_reference_gains_are_at_the_edge_at_one_millisecond():
    """docs/bus.md: with one period of delay the loops stand 604 µs (axis 2) or 572 µs (all three)."""
    without = stability(BENCH, (2, 3), "host", 1e-3, 1, with_notch=False)
    assert all(axis.level != "stable" for axis in without)
    assert all(0.99 < axis.pole_radius < 1.01 for axis in without)
    assert {axis.level for axis in stability(BENCH, (2, 3), "host", 1e-3, 1)} == {"unstable"}
    assert {axis.level for axis in stability(BENCH, (2, 3), "host", 250e-6, 1)} == {"stable"}


def test_a_late_answer_costs_a_second_period():
    cycle = plan_cycle(BENCH, (2,), "host", 440e-6, notch_state=False)
    assert cycle.worst_ns(MEGABIT) < cycle.period_ns < cycle.last_answer_ns(MEGABIT)
    assert cycle.delay_periods(MEGABIT) == 2
    found = check(BENCH, (2,), "host", 440e-6, bitrate=1_000_000)
    assert found.stability[0].delay_samples == 2
    assert not found.is_good
    assert cycle.at(300e-6).delay_periods(MEGABIT) is None


def test_the_accelerometer_behind_the_drives_answers_is_late_at_worst_and_does_not_make_a_plan_fail():
    found = check(BENCH, (2, 3, 5), "drive", 1e-3, bitrate=1_000_000)
    late = {one.name for one in found.cycle.responses(MEGABIT) if not one.is_met}
    assert late == {"acceleration"}
    assert found.fits


def test_drive_closed_is_judged_at_the_drive_s_own_period_whatever_the_bus():
    slow, fast = (stability(BENCH, (2,), "drive", period, 0)[0] for period in (20e-3, 1e-3))
    assert slow == fast
    assert slow.period_s == 250e-6
    assert slow.delay_samples == 0


def test_a_drive_that_does_not_follow_so_short_a_period_is_no_fit():
    """The emulated drive takes SYNC from 250 us to 20 ms."""
    for period in (125e-6, 40e-3):
        verdict = check(BENCH, (2,), "drive", period)
        assert verdict.fits is False
        assert "axis 2 accepts SYNC periods from 0.25 to 20 ms" in verdict.sentence


def test_an_axis_without_model_or_bench_is_said_to_be_so():
    assert stability(BENCH, (5,), "host", 1e-3, 1)[0].level == "not known"
    assert check(BENCH, (5,), "host", 1e-3, bitrate=1_000_000).is_stable is None
    with pytest.raises(NotPossibleError, match="no axis 4"):
        check(BENCH, (4,), "drive", 2e-3)
    with pytest.raises(NotPossibleError):
        check(BENCH, (), "drive", 2e-3)


# -- advice ----------------------------------------------------------------------------------------------------------------


def adviser(axes, loop, period_s, bitrate=1_000_000, **options):
    verdict = check(BENCH, axes, loop, period_s, loop == "drive", bitrate=bitrate, **options)
    return bus_advice.Adviser(BENCH, axes, loop, verdict)


def titles(found):
    return {one.title for one in found}


def test_advice_is_given_only_where_it_helps():
    one, several = adviser((2,), "drive", 2e-3), adviser((2, 3, 5), "drive", 2e-3)
    assert not any("one bus per axis" in title or "set-points" in title for title in titles(one.advice))
    assert {"one bus per axis", "2 set-points in one RPDO", "no notch state TPDO"} <= titles(several.advice)
    assert not any("--loop drive" in title for title in titles(several.advice))
    now = several.verdict.cycle.worst_ns(MEGABIT) / 1000
    assert all(advice.worst_us < now for advice in several.advice)


def test_a_host_closed_plan_that_fails_is_told_what_would_do():
    found = adviser((2, 3, 5), "host", 1e-3)
    assert found.longest_stable_period_s == 500e-6
    assert "close the loop in the drive (--loop drive)" in titles(found.good)
    assert "CAN FD, data at 5 Mbit/s" in titles(found.good)
    assert "one bus per axis" in titles(found.good)
    assert all(one.fits and one.level == "stable" for one in found.good)


def test_a_slow_bus_is_told_to_be_faster_or_to_ask_less_often():
    found = adviser((2, 3, 5), "drive", 2e-3, bitrate=500_000)
    assert {"1 Mbit/s", "SYNC every 4 ms", "no notch state TPDO"} <= titles(found.advice)
    assert {"1 Mbit/s", "SYNC every 4 ms"} <= titles(found.good)


@given(st.integers(1, 6))
@settings(max_examples=6)
def test_no_change_of_frames_loses_an_axis(axes):
    cycle = torque_cycle(axes)
    for change in (bus_advice.position_only, bus_advice.without_control_word, bus_advice.shared_commands, bus_advice.packed):
        changed = change(cycle)
        assert len(changed.of("feedback")) == axes
        assert sum(len(frame.contents) for frame in changed.of("command")) in {axes, 2 * axes}
        assert changed.worst_bits < cycle.worst_bits
        assert all(frame.length <= 8 for frame in changed.frames)
    buses = bus_advice.per_axis(cycle)
    assert sum(len(bus.of("command")) for bus in buses) == axes
