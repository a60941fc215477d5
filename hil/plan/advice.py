"""Changes that would make a plan fit, with their numbers."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from drive_profiles.standard.cia301 import FunctionCode
from hil.bench.bench import Bench
from hil.control.treatments import LoopName
from hil.plan.bus_plan import MARGIN, Cycle, CyclicFrame
from hil.plan.check import Level, PlanVerdict, plan_cycle, stability
from hil.plan.wire import CLASSIC_MAX_BITRATE, WireTiming, rate_text

SYNC_PERIODS_S = (250e-6, 500e-6, 1e-3, 2e-3, 4e-3, 5e-3, 8e-3, 10e-3, 20e-3)
"""SYNC periods that drives commonly take."""
FD_DATA_BITRATE = 5_000_000
PDO_BYTES, CONTROL_WORD_BYTES = 8, 2
_ORDER: tuple[Level, ...] = ("not known", "stable", "at the edge", "unstable")


@dataclass(frozen=True)
class Advice:
    """A change and its effect.

    Attributes:
        needs: Demands on the drives, on this bench or on the wiring.
        nominal_us: Duration of a cycle without stuff bits, on the busiest bus.
        worst_us: Duration of that cycle with as many stuff bits as possible.
        shortest_period_s: Shortest SYNC period in which every answer comes before the next SYNC.
        period_s: SYNC period at which the change is judged.
        fits: True if that period is long enough.
        level: Stability of the loops at that period.
    """

    title: str
    needs: str
    nominal_us: float
    worst_us: float
    shortest_period_s: float
    period_s: float
    fits: bool
    level: Level


# -- changes of a cycle ----------------------------------------------------------------------------------------------------


def position_only(cycle: Cycle) -> Cycle:
    """Return the cycle with only the position in TPDO1: 4 bytes."""
    return _each(cycle, "feedback", lambda frame: replace(frame, contents=tuple(c for c in frame.contents if c[0] == "i")))


def without_control_word(cycle: Cycle) -> Cycle:
    """Return the cycle with only the set-point in the RPDO.

    The control word has an RPDO of its own, sent on changes.
    """
    return _each(cycle, "command", lambda frame: replace(frame, contents=frame.contents[1:]))


def without_notch_state(cycle: Cycle) -> Cycle:
    """The cycle without the second TPDO of the drives."""
    return replace(cycle, frames=tuple(frame for frame in cycle.frames if frame.kind != "notch state"))


def shared_commands(cycle: Cycle) -> Cycle:
    """Return the cycle with several drives' set-points in one RPDO.

    As many as fit into 8 bytes: four torques, or two positions. Every drive receives the first one's identifier, and maps the
    set-points of the others to 0005h to 0007h, whose values are dropped (CiA 301, static data types as dummy entries of an RPDO).
    """
    bare = without_control_word(cycle)
    commands, rest = bare.of("command"), [frame for frame in bare.frames if frame.kind != "command"]
    if not commands:
        return bare
    count = PDO_BYTES // commands[0].length
    shared = []
    for start in range(0, len(commands), count):
        group = commands[start : start + count]
        axes = ", ".join(str(frame.axis) for frame in group)
        contents = tuple(part for frame in group for part in frame.contents)
        shared.append(CyclicFrame(f"axes {axes} command", "command", group[0].can_id, contents))
    return replace(bare, frames=(*shared, *rest))


def packed(cycle: Cycle) -> Cycle:
    """The cycle with position-only answers, no notch state, and shared commands."""
    return shared_commands(position_only(without_notch_state(cycle)))


def packed_alone(cycle: Cycle) -> Cycle:
    """Return the cycle of `packed` with a command for each axis."""
    return without_control_word(position_only(without_notch_state(cycle)))


def per_axis(cycle: Cycle) -> list[Cycle]:
    """Return the cycles with a bus for each axis."""
    buses = []
    for bus, command in enumerate(cycle.of("command")):
        frames = [frame for frame in cycle.frames if frame.axis == command.axis or frame.kind == "sync"]
        frames += cycle.of("acceleration") if bus == 0 else []
        talking = {frame.can_id - FunctionCode.TPDO1 for frame in frames if frame.kind in {"feedback", "acceleration"}}
        nodes = (*sorted(talking), cycle.background.nodes[-1])
        buses.append(replace(cycle, frames=tuple(frames), background=replace(cycle.background, nodes=nodes)))
    return buses


def _each(cycle: Cycle, kind: str, change: Callable[[CyclicFrame], CyclicFrame]) -> Cycle:
    return replace(cycle, frames=tuple(change(frame) if frame.kind == kind else frame for frame in cycle.frames))


# -- advice ----------------------------------------------------------------------------------------------------------------


class Adviser:
    """Judges changes of one plan.

    Attributes:
        wire: Bit rates of the bus; for a plan without bit times, classic CAN at its fastest.
    """

    def __init__(
        self, bench: Bench, axes: tuple[int, ...], loop: LoopName, verdict: PlanVerdict, *, with_notch: bool = True
    ) -> None:
        self.bench, self.axes, self.loop, self.verdict = bench, axes, loop, verdict
        self.wire = verdict.wire or WireTiming(CLASSIC_MAX_BITRATE)
        self.with_notch = with_notch
        self._levels: dict[tuple[LoopName, float], Level] = {}

    def level(self, loop: LoopName, period_s: float) -> Level:
        """Return the stability of the worst known loop.

        The host has one period of delay.
        """
        key = loop, period_s if loop == "host" else 0.0
        if key not in self._levels:
            loops = self.verdict.stability
            delay = 1 if loop == "host" else 0
            if loop != self.loop or delay != self.verdict.delay_periods or period_s != self.verdict.cycle.period_s:
                loops = stability(self.bench, self.axes, loop, period_s, delay, with_notch=self.with_notch)
            self._levels[key] = max((axis.level for axis in loops), key=_ORDER.index)
        return self._levels[key]

    @cached_property
    def longest_stable_period_s(self) -> float | None:
        """The longest usual period with stable host-closed loops, or None."""
        return next((period for period in reversed(SYNC_PERIODS_S) if self.level("host", period) == "stable"), None)

    @cached_property
    def advice(self) -> list[Advice]:
        """Every change that shortens the cycle, or improves a bad plan.

        For a bad host-closed plan, the longest period at which its loops would be stable is assumed.
        """
        cycle = self.verdict.cycle
        if self.loop == "host" and not self.verdict.is_carried:
            cycle = cycle.at(self.longest_stable_period_s or cycle.period_s)
        now = self._judge("", "", [cycle])
        changes = [change for change in self._changes(cycle) if change.worst_us < now.worst_us]
        return changes if self.verdict.is_carried else [*changes, *self._elsewhere()]

    @property
    def good(self) -> list[Advice]:
        """The changes with which the plan would fit and be stable."""
        return [one for one in self.advice if one.fits and one.level in {"stable", "not known"}]

    def _changes(self, cycle: Cycle) -> list[Advice]:
        """Changes of the bus: smaller and fewer frames, more wires, faster wires."""
        several = len(self.axes) > 1
        count = min(PDO_BYTES // (cycle.of("command")[0].length - CONTROL_WORD_BYTES), len(self.axes))
        apart, entries = (
            "control word, status word and torque apart",
            "; dummy entries 0005h-0007h in the drives" if several else "",
        )
        changes: list[tuple[bool, str, str, list[Cycle], WireTiming]] = [
            (True, "TPDO with the position alone (4 bytes)", "status word and torque apart, event-driven; at present the master "
             "checks both in every cycle", [position_only(cycle)], self.wire),
            (True, "control word out of the cyclic RPDO", "an RPDO of its own, sent when it changes",
             [without_control_word(cycle)], self.wire),
            (True, "no notch state TPDO", "a report without the state of the filter",
             [without_notch_state(cycle)], self.wire),
            (count > 1, f"{count} set-points in one RPDO", "control word apart" + entries, [shared_commands(cycle)], self.wire),
            (True, "all of these together", apart + entries, [packed(cycle)], self.wire),
            (several, "one bus per axis", f"{len(self.axes)} interfaces; this bench drives one", per_axis(cycle), self.wire),
            (several, "one bus per axis, all of these together", f"{len(self.axes)} interfaces; " + apart,
             per_axis(packed_alone(cycle)), self.wire),
            (self.wire.data_bitrate is None, f"CAN FD, data at {rate_text(FD_DATA_BITRATE)}", "drives, interface and wiring for "
             "CANopen FD", [cycle], WireTiming(self.wire.bitrate, FD_DATA_BITRATE)),
            (self.wire.bitrate < CLASSIC_MAX_BITRATE, rate_text(CLASSIC_MAX_BITRATE), "a bus of at most 25 m", [cycle],
             WireTiming(CLASSIC_MAX_BITRATE)),
        ]  # fmt: skip
        return [self._judge(title, needs, buses, wire) for applies, title, needs, buses, wire in changes if applies]

    def _elsewhere(self) -> list[Advice]:
        """Changes apart from the bus: another period, or a drive-closed loop."""
        changes = []
        cycle = self.verdict.cycle
        enough = cycle.shortest_period_s(self.wire, margin=MARGIN)
        longer = next((period for period in SYNC_PERIODS_S if period >= enough), None)
        if longer is not None and longer > cycle.period_s and self.level(self.loop, longer) in {"stable", "not known"}:
            changes.append(self._judge(f"SYNC every {1e3 * longer:g} ms", "nothing", [cycle.at(longer)]))
        if self.loop == "host":
            inside = plan_cycle(self.bench, self.axes, "drive", self.bench.bus.sync_period_s, notch_state=self.with_notch)
            title = "close the loop in the drive (--loop drive)"
            changes.append(self._judge(title, "gains and notch inside the drive", [inside], loop="drive"))
        return changes

    def _judge(
        self, title: str, needs: str, buses: list[Cycle], wire: WireTiming | None = None, loop: LoopName | None = None
    ) -> Advice:
        wire, period = wire or self.wire, buses[0].period_s
        shortest = max(bus.shortest_period_s(wire) for bus in buses)
        nominal = max(sum(wire.nominal_ns(frame.length) for frame in bus.frames) for bus in buses)
        worst = max(bus.worst_ns(wire) for bus in buses)
        fits = all(bus.delay_periods(wire) == 1 for bus in buses)
        level = self.level(loop or self.loop, period)
        return Advice(title, needs, 1e-3 * nominal, 1e-3 * worst, shortest, period, fits, level)
