"""The master's checks of limits and of the drives' health.

Pure: values in, reasons to stop out. `guard.h` has the checks of an axis, this module their words.
"""

import math
from typing import Any

from drive_profiles.standard.cia402 import state_of
from hil.bench.bench import AxisTable
from hil.core.library import CORE

GUARD = CORE.dtype("guard")
LATE_SHARE = 0.1
"""Lateness of a SYNC, in periods, that shows as no impossible position.

A drive takes its position at SYNC, and turns at `speed_rps` at most. Between a SYNC that is on time and one that is late by
this share of a period T, it turns by at most speed_rps (T + 0.1 T). Real hosts stay well below (docs/realtime.md). One that is
later shows as a single impossible position, which is ignored: only WILD_LIMIT of them in a row stop the run.
"""
TORQUE_SHARE = 0.02
"""Share of the torque limit by which rounding may lift a torque that a drive keeps at its limit.

6072h and 6077h count in 1/1000 of the rated torque (CiA 402-2). Half a step of each is 1/1000 of the rated torque together:
at most 2 % of any limit from 5 % of the rated torque on.
"""


class AxisGuard:
    """Limits of one axis for the core's checks, and the words of what they find.

    Args:
        missing_limit: Missing answers in a row that stop a run.
        data: Its record, all zero; None: one of its own.
    """

    def __init__(self, number: int, table: AxisTable, missing_limit: int, period_s: float, data: Any = None) -> None:
        self.number, self.table = number, table
        self.data = guard = CORE.new("guard") if data is None else data
        turn, limits = 2.0 * math.pi, table.limits
        guard.missing_limit, guard.period_s = missing_limit, period_s
        guard.reach_rad = (1.0 + LATE_SHARE) * limits.speed_rps * turn * period_s
        guard.low_rad, guard.high_rad = limits.position_min_rev * turn, limits.position_max_rev * turn
        guard.torque_nm = (1.0 + TORQUE_SHARE) * limits.torque_nm
        guard.window_rad = limits.following_error_rev * turn
        # the drive watches the same window; the master is the second line and lets it speak first
        guard.window_s = limits.following_error_timeout_s + 2.0 * period_s

    @property
    def discarded(self) -> int:
        """Number of impossible positions so far."""
        return int(self.data.discarded)

    def words(
        self, found: int, status_word: int, position_rad: float, reference_rad: float, torque_nm: float, missing: int
    ) -> str:
        """Return what `guard_check` has found, in words.

        Args:
            found: Its result, which is not `IN_ORDER`; the other values are those that it was given.
        """
        name, limits, turn = f"axis {self.number}", self.table.limits, 2.0 * math.pi
        if found == CORE.call.SILENT:
            return f"{name} has not answered for {missing} cycles: check its supply, its cable and the bus load (hil plan)"
        if found == CORE.call.NOT_IN_OPERATION:
            state = state_of(status_word)
            shown = "an unknown state" if state is None else state.value
            return f"{name} left operation enabled: {shown} (status word {status_word:04X}h)"
        if found == CORE.call.TOO_FAST:
            return f"{name} turns at {self.data.wild_rps:.2f} rev/s; the limit is {limits.speed_rps:g} rev/s"
        if found == CORE.call.BEYOND_LIMITS:
            low, high = limits.position_min_rev, limits.position_max_rev
            return f"{name} is at {position_rad / turn:.3f} rev; the limits are {low:g} and {high:g} rev"
        if found == CORE.call.TOO_MUCH_TORQUE:
            return f"{name} gives {torque_nm:.3g} N·m; the limit is {limits.torque_nm:g} N·m"
        behind, limit = f"{abs(position_rad - reference_rad) / turn:.3f}", f"{limits.following_error_rev:g}"
        return f"{name} is {behind} rev behind its set-point; the limit is {limit} rev"


def heartbeat_fault(node: int, last_s: float | None, now_s: float, since_s: float, heartbeat_s: float) -> str | None:
    """Return the reason to stop if a node's heartbeat is late.

    It is late three periods after the last one, or after supervision began.

    Args:
        last_s: Time of its last heartbeat; None before the first.
        since_s: Time at which supervision began.
    """
    reference = since_s if last_s is None else max(last_s, since_s)
    silence = now_s - reference
    if silence > 3.0 * heartbeat_s + 1e-9:
        return f"node {node} has lost its heartbeat: nothing received for {silence:.3f} s"
    return None
