"""Verdict on a bench's bus plan and its loops' stability."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drive_profiles.address import BIT_RATES, LOCAL, parse_address
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, FunctionCode
from drive_profiles.standard.cia402 import Object
from hil.bench.bench import AS_FOUND, AxisTable, Bench
from hil.bench.load_encoder import watched_axes
from hil.control.treatments import LoopName
from hil.design.frequency import Loop, margins
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.master.drive import mapping
from hil.master.drive.needs import run_gaps, run_remarks
from hil.master.drive.pdo import MappedObject
from hil.master.request import MAX_SENSITIVITY, check_acceleration
from hil.plan.bus_plan import Background, Cycle, CyclicFrame, FrameKind, Range
from hil.plan.wire import CLASSIC_MAX_BITRATE, WireTiming, rate_text

Level = Literal["stable", "at the edge", "unstable", "not known"]

MARGIN_POINTS = 1500
RATES = BIT_RATES[4:]
COUNTS_PER_REV = 1 << 17
"""Resolution of the encoder in the sample of contents; only the typical number of stuff bits depends on it."""


@dataclass(frozen=True)
class AxisStability:
    """Stability of one axis' loop at the worst notch speed.

    At the period and the delay of a plan.

    Attributes:
        period_s: Sampling time of the loop; None: that of the drive, which is not known.
        delay_samples: Whole periods from sampling to torque.
        speed_rps: Motor speed at which it is worst; 0 is without notch.
        sensitivity_peak: M_s at that speed.
    """

    axis: int
    period_s: float | None
    delay_samples: int
    speed_rps: float = 0.0
    sensitivity_peak: float = float("nan")
    gain_margin_db: float = float("nan")
    phase_margin_deg: float = float("nan")
    pole_radius: float = float("nan")
    level: Level = "not known"
    reason: str = ""


@dataclass(frozen=True)
class PlanVerdict:
    """Verdict on a plan.

    Attributes:
        fits: True if every answer comes before the next SYNC, whatever the contents; None without a bit rate.
        is_stable: True if no loop is unstable or at the edge; None if no loop is known.
        wire: Bit rates of the bus; None: without bit times, or not known.
        delay_periods: Delay of a host-closed loop; 0 for a drive-closed one; None if the bus cannot carry it at all.
        gaps: Sentences on entries that profiles or bench file lack, and on ramps beyond limits.
        remarks: Sentences on limits that a drive does not hold, and on modes with a loss.
    """

    fits: bool | None
    is_stable: bool | None
    sentence: str
    cycle: Cycle
    wire: WireTiming | None
    delay_periods: int | None
    stability: tuple[AxisStability, ...]
    gaps: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def is_carried(self) -> bool:
        """True if the plan fits and no loop is unstable.

        Nor at the edge; what is not known counts as good.
        """
        return self.fits is not False and self.is_stable is not False

    @property
    def is_good(self) -> bool:
        """True if the plan is carried and nothing is lacking."""
        return self.is_carried and not self.gaps


# -- the bus ---------------------------------------------------------------------------------------------------------------


def plan_cycle(
    bench: Bench,
    axes: tuple[int, ...],
    loop: LoopName,
    period_s: float,
    *,
    notch_state: bool,
    torque_offset: bool = False,
) -> Cycle:
    """The frames of a cycle, as `hil.master.cyclic` maps them.

    The loop decides between positions and torques. `notch_state`: the drives send the state of their first filter in a second
    TPDO; `torque_offset`: a torque offset (60B2h) goes beside each position.

    Raises:
        NotPossibleError: The bench has no such axis.
    """
    missing = [number for number in axes if number not in bench.axis]
    if missing or not axes:
        have = ", ".join(map(str, bench.axis))
        raise NotPossibleError(f"bench {bench.name!r} has no axis {', '.join(map(str, missing)) or 'to plan'}; it has {have}")
    commands, answers = [], []
    for number in axes:
        table = bench.axis[number]
        node, profile = table.node_id, Profile.load(table.profile)
        mode = mapping.mode_of(loop, profile) or (mapping.CST if loop == "host" else mapping.CSP)
        objects = mapping.command(mode, with_torque_offset=torque_offset)
        commands.append(_frame("command", FunctionCode.RPDO1 + node, objects, number, table))
        answers.append(_frame("feedback", FunctionCode.TPDO1 + node, mapping.feedback(profile), number, table))
        state = mapping.notch_state(profile) if notch_state else ()
        if state:
            answers.append(_frame("notch state", FunctionCode.TPDO2 + node, state, number, table))
    watched = watched_axes(bench, axes)
    for number in (*axes, *watched):
        table = bench.axis[number]
        load = mapping.load_position(table, Profile.load(table.profile))
        if load:
            is_third = mapping.load_tpdo(Profile.load(table.profile), with_notch_state=notch_state) > 2
            code = FunctionCode.TPDO3 if is_third else FunctionCode.TPDO2
            answers.append(_frame("load position", code + table.node_id, load, number, table))
    nodes = [bench.axis[number].node_id for number in (*axes, *watched)]
    sensor: int | None = bench.accelerometer.node_id  # None: a sensor that is not on this bus
    if sensor is not None:
        answers.append(_frame("acceleration", FunctionCode.TPDO1 + sensor, mapping.ACCELERATION, None, None))
        nodes.append(sensor)
    sync = CyclicFrame("SYNC", "sync", int(FunctionCode.SYNC))
    nodes.append(bench.bus.master_node_id)
    return Cycle((*commands, sync, *answers), period_s, Background(tuple(nodes), bench.bus.heartbeat_s))


def _frame(
    kind: FrameKind, can_id: int, objects: tuple[MappedObject, ...], axis: int | None, table: AxisTable | None
) -> CyclicFrame:
    name = kind if axis is None else f"axis {axis} {kind}"
    return CyclicFrame(name, kind, int(can_id), tuple(_contents(entry, table) for entry in objects), axis)


def _contents(entry: MappedObject, table: AxisTable | None) -> Range:
    """Format and range of an object's values in a motion."""
    form = entry.kind.struct_format or "B"
    if entry.kind is DataType.REAL32:
        return form, 0.0, 20.0
    if entry.index in {Object.POSITION_ACTUAL, Object.TARGET_POSITION} and table is not None:
        limits = table.limits
        return form, limits.position_min_rev * COUNTS_PER_REV, limits.position_max_rev * COUNTS_PER_REV
    fixed = {Object.CONTROL_WORD: (0x000F, 0x001F), Object.STATUS_WORD: (0x1637, 0x1637)}
    if entry.index in fixed:
        return (form, *fixed[Object(entry.index)])
    return (form, 0, 1) if entry.kind is DataType.UNSIGNED8 else (form, -1000, 1000)


def wire_of(bench: Bench, bitrate: int | None = None) -> WireTiming | None:
    """Return the bit rates of the bench's bus, or None."""
    rate = bitrate or parse_address(bench.bus.address).bitrate
    return None if rate is None else WireTiming(rate)


def sync_refusals(bench: Bench, axes: tuple[int, ...], period_s: float) -> list[str]:
    """Refusals of a SYNC period by the drives' profiles, in words."""
    refused = []
    for number in axes:
        sync = Profile.load(bench.axis[number].profile).sync
        low, high = sync.min_period_s or 0.0, sync.max_period_s or math.inf
        if not low <= period_s <= high:
            limits = f"from {1e3 * low:g} to {1e3 * high:g} ms" if high < math.inf else f"from {1e3 * low:g} ms on"
            refused.append(f"axis {number} accepts SYNC periods {limits}")
    return refused


def is_ideal(bench: Bench, bitrate: int | None = None) -> bool:
    """True if the bus has no bit times.

    It is the emulator's, and no bit rate is given.
    """
    address = parse_address(bench.bus.address)
    return address.interface == LOCAL and address.bitrate is None and bitrate is None


# -- the loop --------------------------------------------------------------------------------------------------------------


def stability(
    bench: Bench, axes: tuple[int, ...], loop: LoopName, period_s: float, delay: int | None, *, with_notch: bool = True
) -> tuple[AxisStability, ...]:
    """Stability of each axis' loop.

    A host-closed loop runs at the SYNC period, with `delay` whole periods from sampling to torque, None if the bus does not
    carry it; a drive-closed one runs at the period of the drive.
    """
    return tuple(_axis_stability(number, bench.axis[number], loop, period_s, delay, with_notch) for number in axes)


def _axis_stability(
    number: int, table: AxisTable, loop: LoopName, period_s: float, delay: int | None, with_notch: bool
) -> AxisStability:
    period: float | None = period_s
    if loop == "drive":
        facts = Profile.load(table.profile).loop
        period, delay = (None if facts is None else facts.period_s), 0
    if delay is None:
        return AxisStability(number, period, 0, reason="the frames do not fit on the bus, so the delay has no bound")
    if period is None:
        return AxisStability(number, period, delay, reason=f"profile {table.profile} lacks the drive's control period")
    model = table.loop(period, delay, with_notch=with_notch)
    if table.control == AS_FOUND:
        return AxisStability(number, period, delay, reason="its gains are as found in the drive")
    if model is None:
        return AxisStability(number, period, delay, reason="no model")
    return worst_margins(number, model)


def worst_margins(number: int, model: Loop) -> AxisStability:
    """Return a loop's stability at the worst of its speeds."""
    speeds = [0.0, *(speed for n in model.notches for speed in np.linspace(n.start_rps, n.end_rps, 5).tolist())]
    margins_by_speed = [(margins(model, speed, MARGIN_POINTS), speed) for speed in speeds]
    least, speed = max(margins_by_speed, key=lambda pair: (max(pair[0].pole_radius, 1.0), pair[0].sensitivity_peak))
    level: Level = "stable" if least.sensitivity_peak <= MAX_SENSITIVITY else "at the edge"
    if not least.stable:
        level = "unstable"
    return AxisStability(
        number, model.period_s, model.delay_samples, speed, least.sensitivity_peak, least.gain_margin_db,
        least.phase_margin_deg, least.pole_radius, level,
    )  # fmt: skip


# -- the verdict -----------------------------------------------------------------------------------------------------------


def check(
    bench: Bench,
    axes: tuple[int, ...],
    loop: LoopName,
    period_s: float,
    notch_state: bool = False,
    *,
    with_notch: bool = True,
    torque_offset: bool = False,
    bitrate: int | None = None,
) -> PlanVerdict:
    """Judge a run's bus load, and the stability of its loops.

    The loops have the delay of the bus. `notch_state`: the run maps the notch state, as drive-closed runs with the notch do;
    `with_notch`: the filters act; `torque_offset`: a torque offset (60B2h) goes beside each position; `bitrate` replaces that
    in the bus address.

    Raises:
        NotPossibleError: The bench has no such axis.
    """
    cycle = plan_cycle(bench, axes, loop, period_s, notch_state=notch_state, torque_offset=torque_offset)
    wire = wire_of(bench, bitrate)
    fits: bool | None
    if wire is not None:
        fits = cycle.delay_periods(wire) == 1
    elif is_ideal(bench, bitrate):
        fits = True
    else:  # the rate is not known: what the fastest does not carry, none does
        fits = None if cycle.delay_periods(WireTiming(CLASSIC_MAX_BITRATE)) == 1 else False
    refused = sync_refusals(bench, axes, period_s)
    bus = _bus_words(cycle, wire, fits)
    if refused:
        fits, bus = False, f"does not fit: {', '.join(refused)}, not {1e3 * period_s:g} ms; the bus itself {bus}"
    delay = cycle.delay_periods(wire) if loop == "host" else 0
    loops = stability(bench, axes, loop, period_s, delay, with_notch=with_notch)
    levels = {axis.level for axis in loops}
    is_stable = False if levels & {"unstable", "at the edge"} else (None if levels == {"not known"} else True)
    lacking = (*run_gaps(bench, axes, loop, with_notch=with_notch), *_motion_gaps(bench, axes))
    head = "" if fits is False or is_stable is not False else "not stable; the bus "
    if lacking:
        head = f"not possible: {len(lacking)} {'need is' if len(lacking) == 1 else 'needs are'} not met; the bus "
    sentence = f"{head}{bus}; {_loop_words(loops, loop)}."
    sentence = f"{sentence[0].upper()}{sentence[1:]}"
    remarks = tuple(run_remarks(bench, axes, loop))
    return PlanVerdict(fits, is_stable, sentence, cycle, wire, delay, loops, lacking, remarks)


def _motion_gaps(bench: Bench, axes: tuple[int, ...]) -> list[str]:
    """Return sentences on ramps that an axis may not make."""
    found = []
    for number in axes:
        for table in (bench.constant_acceleration, bench.point_to_point):
            if table is not None:
                try:
                    check_acceleration(bench.axis[number], number, table.trajectory())
                except UnsafeRequestError as error:
                    found.append(str(error))
    return found


def _bus_words(cycle: Cycle, wire: WireTiming | None, fits: bool | None) -> str:
    period = f"{1e3 * cycle.period_s:g} ms"
    if wire is None and fits:
        return f"fits: {period}, as any period does on a bus without bit times"
    if wire is None:
        at = WireTiming(CLASSIC_MAX_BITRATE)
        rates = [rate for rate in RATES if cycle.delay_periods(WireTiming(rate)) == 1]
        if rates:
            return f"{period} fits from {rate_text(rates[0])} on, but the bus address has no bit rate"
        return f"does not fit: {period} is too short even at {rate_text(at.bitrate)} ({_numbers(cycle, at)})"
    if fits:
        return f"fits: {period} at {wire.name} ({_numbers(cycle, wire)})"
    return f"does not fit: {period} at {wire.name} ({_numbers(cycle, wire)})"


def _numbers(cycle: Cycle, wire: WireTiming) -> str:
    worst, shortest = 1e-3 * cycle.worst_ns(wire), 1e6 * cycle.shortest_period_s(wire)
    return f"worst-case load {100.0 * cycle.load(wire):.0f} %, {worst:.0f} µs per cycle, shortest period {shortest:.0f} µs"


def _loop_words(loops: tuple[AxisStability, ...], loop: LoopName) -> str:
    known = [axis for axis in loops if axis.level != "not known"]
    if not known:
        return f"the stability of the {loop}-closed loops is not known: {loops[0].reason}"
    order = ("stable", "at the edge", "unstable")
    worst = max(known, key=lambda axis: (order.index(axis.level), axis.sensitivity_peak))
    number = f"pole radius {worst.pole_radius:.4f}" if worst.level == "unstable" else f"M_s {worst.sensitivity_peak:.2f}"
    unknown = ", ".join(str(axis.axis) for axis in loops if axis.level == "not known")
    tail = f", axis {unknown} not known" if unknown else ""
    delay = {0: "", 1: " and 1 period of delay"}.get(worst.delay_samples, f" and {worst.delay_samples} periods of delay")
    where = f" with the notch at {worst.speed_rps:g} rev/s" if worst.speed_rps else ""
    period = 1e3 * (worst.period_s or 0.0)
    return f"{loop}-closed {worst.level}: axis {worst.axis} has {number} at {period:g} ms{delay}{where}{tail}"
