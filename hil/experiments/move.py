"""Slow move of one axis to a position.

It starts from wherever a stop, a fault or a lost master has left the arm.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from drive_profiles.address import parse_address
from hil.bench.bench import AxisTable, Bench, Limits
from hil.can.channel import Channel
from hil.can.opening import open_channel
from hil.control.trajectory import Smooth, sample_times
from hil.control.treatments import LoopName
from hil.errors import NodeError, NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.experiments.bus_demand import BusDemand
from hil.experiments.measurement import check_demands, log_label
from hil.experiments.position_before import PositionBefore
from hil.master.motion import Motion
from hil.master.run import APPROACH_RAMP_S
from hil.master.session import Session
from hil.master.whereabouts import AWAY_REV, name_range, rev_text
from hil.recording import BusLog
from hil.reporter import SILENT, Reporter
from hil.robot_tables import Control

SLOW_FRACTION: Final = 0.25
"""Bound: fraction of an axis' speed limit at which it is moved, where `approach_rps` is not slower: the tip of the reference
robot goes at 0.11 m/s, below the 0.25 m/s of ISO 10218-1 for manual operation, and a quick stop takes a sixteenth of its way."""


def way_of(number: int, way_rad: float, speed_rps: float, period_s: float, most_rps_s: float | None = None) -> Motion:
    """Plan a smooth move of one motor from its present position.

    The motor stays at the end of it.

    Args:
        speed_rps: Largest speed of the motor.
        most_rps_s: Largest acceleration of the motor; None without a limit.
    """
    smooth = Smooth.way(way_rad / math.tau, speed_rps, APPROACH_RAMP_S, most_rps_s)
    times = sample_times(smooth.duration_s, period_s)
    angles = np.asarray(smooth.position(times))[:, np.newaxis] * way_rad
    return Motion((number,), times, angles, starts_at_home=False, returns=False)


@dataclass(frozen=True)
class MoveRequest:
    """Request of a move; a position, a way or the position before a motion is given.

    Attributes:
        to_rev: Motor position as the drive counts, rev; or None.
        by_rev: Way of the motor from its present position, rev; or None.
        before: Position before the last motion; or None.
    """

    axis: int
    to_rev: float | None = None
    by_rev: float | None = None
    loop: LoopName = "drive"
    before: PositionBefore | None = None

    def check(self, bench: Bench) -> None:
        """Refuse a request that is wrong whatever the robot's state.

        Raises:
            NotPossibleError: The bench has no such axis, or a number is none.
            UnsafeRequestError: The position is beyond the limits of the axis.
        """
        bench.check_axis(self.axis)
        for value in (self.to_rev, self.by_rev):
            if value is not None and not math.isfinite(value):
                raise NotPossibleError(f"{value} is not a motor position; expected a number in rev")
        if self.to_rev is not None:
            check_position(self.axis, self.to_rev, bench.axis[self.axis].limits)


def check_position(axis: int, to_rev: float, limits: Limits, remedy: str = "") -> None:
    """Refuse a position beyond the limits of an axis.

    Raises:
        UnsafeRequestError: It is beyond them.
    """
    if not limits.position_min_rev <= to_rev <= limits.position_max_rev:
        limit = limits.position_max_rev if to_rev > limits.position_max_rev else limits.position_min_rev
        remedy = remedy or f"choose one within {name_range(limits)}"
        raise UnsafeRequestError(f"the position of axis {axis}", to_rev, limit, "rev", remedy)


@dataclass(frozen=True)
class Move:
    """Move that is planned from the axis' present position.

    Attributes:
        fault: Fault that the drive is in, in words; None if it is in none.
        bench: The bench file; the limits of an axis at or beyond them leave room to turn back.
    """

    request: MoveRequest
    from_rev: float
    to_rev: float
    speed_rps: float
    fault: str | None
    bench: Bench

    @property
    def is_there(self) -> bool:
        """True if the axis is at its target already."""
        return abs(self.to_rev - self.from_rev) <= AWAY_REV

    def motion(self) -> Motion:
        """Motion of the axis."""
        bus = self.bench.bus
        period_s = bus.host_sync_period_s if self.request.loop == "host" else bus.sync_period_s
        most_rps_s = self.bench.axis[self.request.axis].limits.acceleration_rps_s
        return way_of(self.request.axis, math.tau * (self.to_rev - self.from_rev), self.speed_rps, period_s, most_rps_s)

    @property
    def sentences(self) -> list[str]:
        """Describe the move for the question to the user."""
        number, limits = self.request.axis, self.bench.axis[self.request.axis].limits
        said = [f"axis {number} is {self.fault}: the fault is reset first"] if self.fault else []
        before = self.request.before
        back = "" if before is None else f", its position before the motion in {before.log},"
        return [
            *said,
            f"This moves axis {number} on {self.bench.bus.address}:",
            f"  from {rev_text(self.from_rev)} to {rev_text(self.to_rev)} rev{back} at up to {self.speed_rps:.3g} rev/s and "
            f"{limits.torque_nm:g} N·m, in {self.motion().time_s[-1]:.1f} s; positions {name_range(limits)}",
        ]


@dataclass(frozen=True)
class MoveOutcome:
    """End of a move.

    Attributes:
        stands_rev: Position of the motor after the move; None after a stop.
        not_restored: Objects that could not be restored in the nodes.
    """

    stands_rev: float | None
    stopped: SafetyStopError | None
    not_restored: tuple[str, ...] = ()


def plan_move(bench: Bench, request: MoveRequest, *, channel: Channel | None = None) -> Move:
    """Read the robot's state and plan a move.

    Nothing is written or enabled.

    Args:
        channel: The bus; opened from the bench file's address, and closed, unless it is given.

    Raises:
        HilError: Robot, bench file or limits do not allow it.
        ChannelError: The bus cannot be opened, or is lost.
    """
    request.check(bench)
    with _session(bench, request, None, channel, SILENT) as session:
        return _planned(session, request)


def make_move(move: Move, log: Path | None = None, *, channel: Channel | None = None, reporter: Reporter = SILENT) -> MoveOutcome:
    """Move the axis as planned, after a reset of its fault.

    The fault is reset only if the drive has one.

    Args:
        log: File for every frame; None for none.

    Raises:
        NodeError: The axis has moved since the move was planned, or its fault stays.
        SafetyStopError: The move was stopped before the axis moved.
        HilError: Robot or limits do not allow it.
        ChannelError: The bus cannot be opened, or is lost.
        OSError: There is no directory for the log; nothing has been sent.
    """
    request = move.request
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)  # before anything moves
    with _session(move.bench, request, log, channel, reporter) as session:
        axis = session.axes[request.axis]
        here = axis.position_rad() / math.tau
        if abs(here - move.from_rev) > AWAY_REV:
            what = f"axis {request.axis} has turned from {rev_text(move.from_rev)} to {rev_text(here)} rev in the meantime"
            raise NodeError(axis.node, what, "give the command again")
        session.check_interrupt()
        session.reset_fault(axis)
        result = session.run(move.motion(), "none", request.loop, shows_filter=False)
        stands_rev = None if result.stopped is not None else axis.position_rad() / math.tau
        return MoveOutcome(stands_rev, result.stopped, tuple(session.not_restored))


@contextmanager
def _session(
    bench: Bench, request: MoveRequest, log: Path | None, given: Channel | None, reporter: Reporter
) -> Iterator[Session]:
    """Open a session whose nodes have been found."""
    channel = open_channel(parse_address(bench.bus.address)) if given is None else given
    try:
        period_s = bench.bus.host_sync_period_s if request.loop == "host" else bench.bus.sync_period_s
        check_demands(bench, channel, [BusDemand(f"a move of axis {request.axis}", (request.axis,), period_s, request.loop)])
        with Session(bench, channel, BusLog(log, log_label(channel.address)), reporter.progress) as session:
            session.bring_up(in_fault=request.axis, moving=None if bench.arm is not None else {request.axis})
            yield session
    finally:
        if given is None:
            channel.close()


def _planned(session: Session, request: MoveRequest) -> Move:
    """Plan the move from the axis' present position."""
    bench, axis = session.bench, session.axes[request.axis]
    limits = axis.table.limits
    here = axis.position_rad() / math.tau
    if request.before is not None:
        to_rev = axis.scaling.position_rad(request.before.counts) / math.tau
    elif request.by_rev is not None:
        to_rev = here + request.by_rev
    else:
        to_rev = float(request.to_rev or 0.0)
    check_position(request.axis, to_rev, limits, f"its position is {rev_text(here)} rev; choose one within {name_range(limits)}")
    speed_rps = min(bench.approach_rps, SLOW_FRACTION * limits.speed_rps)
    return Move(request, here, to_rev, speed_rps, axis.fault(), with_room(bench, request.axis, here))


def sag_rev(table: AxisTable) -> float:
    """Largest turn of a motor under load until its loop holds.

    A load that the torque limit can hold pushes with τ_max at most. The loop pushes back with K_pp K_vp per radian, and
    with more over time. The following error limit bounds the turn, also if the gains are not known.
    """
    if isinstance(table.control, Control):
        stiffness_nm_rad = table.control.position_gain_per_s * table.control.velocity_gain_nm_s_rad
        if stiffness_nm_rad > 0.0:
            return min(table.limits.torque_nm / stiffness_nm_rad / math.tau, table.limits.following_error_rev)
    return table.limits.following_error_rev


def with_room(bench: Bench, number: int, stands_rev: float) -> Bench:
    """Widen the limits of an axis that is at one of them, or outside.

    A load may turn it further when its brake opens, and it may then turn back. Elsewhere, the bench stays the same.
    """
    table = bench.axis[number]
    limits = table.limits
    low_rev, high_rev = stands_rev - sag_rev(table), stands_rev + sag_rev(table)
    update = {}
    if low_rev < limits.position_min_rev:
        update["position_min_rev"] = low_rev
    if high_rev > limits.position_max_rev:
        update["position_max_rev"] = high_rev
    if not update:
        return bench
    wider = table.model_copy(update={"limits": limits.model_copy(update=update)})
    return bench.model_copy(update={"axis": {**bench.axis, number: wider}})
