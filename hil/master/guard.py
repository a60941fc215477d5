"""The master's checks of limits and of the drives' health.

Pure: values in, reasons to stop out.
"""

import math
from dataclasses import dataclass, field

from drive_profiles.standard.cia402 import state_of
from hil.bench.bench import AxisTable

WILD_LIMIT = 2
"""Impossible positions in a row that stop a run; a single one may be a frame that was damaged unseen."""

_ENABLED_MASK, _ENABLED = 0x6F, 0x27


@dataclass
class AxisGuard:
    """Watches one axis, cycle by cycle: first `accepts`, then `check`.

    Attributes:
        number: Axis number.
        table: Table with the limits of the axis.
        missing_limit: Largest number of missing answers in a row.
        period_s: SYNC period.
        discarded: Number of impossible positions so far.
    """

    number: int
    table: AxisTable
    missing_limit: int
    period_s: float
    discarded: int = 0
    _last_rad: float | None = None
    _cycles: int = 0
    _may_be_late: int = 0
    _wild: int = 0
    _wild_rps: float = 0.0
    _beyond_s: float = 0.0
    _reach_rad: float = field(init=False)
    _low_rad: float = field(init=False)
    _high_rad: float = field(init=False)
    _torque_nm: float = field(init=False)
    _window_rad: float = field(init=False)

    def __post_init__(self) -> None:
        """Compute the limits once, in the units of the measurements."""
        turn, limits = 2.0 * math.pi, self.table.limits
        self._reach_rad = 1.1 * limits.speed_rps * turn * self.period_s
        self._low_rad, self._high_rad = limits.position_min_rev * turn, limits.position_max_rev * turn
        self._torque_nm = 1.02 * limits.torque_nm
        self._window_rad = limits.following_error_rev * turn

    def accepts(self, position_rad: float, missing: int) -> bool:
        """True if the axis can be at a position.

        By the motor's speed limit and the time since the last position. The caller ignores any other position, as if
        the answer were missing; two in a row make `check` stop the run. After a missing answer, the next one may be the
        late one, and then it is a period older than it seems.
        """
        self._cycles += 1
        if missing:
            self._may_be_late = 2
            return True
        last = self._last_rad
        if last is not None:
            slack = 1 if self._may_be_late > 0 else 0
            distance = abs(position_rad - last)
            if distance > self._reach_rad * (self._cycles + slack):
                self._wild += 1
                self._wild_rps = distance / (self._cycles * self.period_s * 2.0 * math.pi)
                self.discarded += 1
                return False
        self._last_rad, self._cycles, self._wild = position_rad, 0, 0
        if self._may_be_late:
            self._may_be_late -= 1
        return True

    def check(self, status_word: int, position_rad: float, reference_rad: float, torque_nm: float, missing: int) -> str | None:
        """The reason to stop, or None.

        Args:
            status_word: Status word received in this cycle.
            position_rad: Motor angle received in this cycle.
            reference_rad: Wanted motor angle.
            torque_nm: Motor torque received in this cycle.
            missing: Cycles in a row without an answer; above 0 the other values are not checked.
        """
        name, limits = f"axis {self.number}", self.table.limits
        if missing:
            return f"{name} has not answered for {missing} cycles" if missing >= self.missing_limit else None
        if status_word & _ENABLED_MASK != _ENABLED:
            state = state_of(status_word)
            shown = "an unknown state" if state is None else state.value
            return f"{name} left operation enabled: {shown} (status word {status_word:04X}h)"
        if self._wild >= WILD_LIMIT:
            return f"{name} turns at {self._wild_rps:.2f} rev/s, the limit is {limits.speed_rps:g} rev/s"
        if not self._low_rad <= position_rad <= self._high_rad:
            low, high = limits.position_min_rev, limits.position_max_rev
            return f"{name} is at {position_rad / (2.0 * math.pi):.3f} rev, the limits are {low:g} and {high:g} rev"
        if abs(torque_nm) > self._torque_nm:
            return f"{name} gives {torque_nm:.3g} N·m, the limit is {limits.torque_nm:g} N·m"
        if abs(position_rad - reference_rad) > self._window_rad:
            return self._following(abs(position_rad - reference_rad) / (2.0 * math.pi))
        self._beyond_s = 0.0
        return None

    def skip(self) -> None:
        """Note a cycle without a measurement.

        The next position is more than a period away from the last.
        """
        self._last_rad = None

    def _following(self, error_rev: float) -> str | None:
        limits = self.table.limits
        self._beyond_s += self.period_s
        # the drive watches the same window; the master is the second line and lets it speak first
        if self._beyond_s > limits.following_error_timeout_s + 2.0 * self.period_s:
            behind, limit = f"{error_rev:.3f}", f"{limits.following_error_rev:g}"
            return f"axis {self.number} is {behind} rev behind its set-point, the limit is {limit} rev"
        return None


def heartbeat_fault(node: int, last_s: float | None, now_s: float, since_s: float, heartbeat_s: float) -> str | None:
    """Return the reason to stop if a node's heartbeat is late.

    It is late three periods after the last one, or after supervision began.

    Args:
        node: Node-ID of the node.
        last_s: Time of its last heartbeat; None before the first.
        now_s: Present time.
        since_s: Time at which supervision began.
        heartbeat_s: Period of its heartbeat.
    """
    reference = since_s if last_s is None else max(last_s, since_s)
    silence = now_s - reference
    if silence > 3.0 * heartbeat_s + 1e-9:
        return f"node {node} has lost its heartbeat: nothing received for {silence:.3f} s"
    return None
