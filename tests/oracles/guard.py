"""The master's checks of an axis in plain Python: the specification of `hil/master/guard.c`."""

import math
from dataclasses import dataclass, field

from hil.bench.bench import AxisTable

WILD_LIMIT = 2
IN_ORDER, SILENT, NOT_IN_OPERATION, TOO_FAST, BEYOND_LIMITS, TOO_MUCH_TORQUE, TOO_FAR_BEHIND = range(7)
_STATE_BITS, _OPERATION_ENABLED = 0x6F, 0x27


@dataclass
class Guard:
    """Watches one axis, cycle by cycle: first `accepts`, then `check`.

    Attributes:
        table: Table with the limits of the axis.
        missing_limit: Largest number of missing answers in a row.
        period_s: SYNC period.
        discarded: Number of impossible positions so far.
    """

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

    def check(self, status_word: int, position_rad: float, reference_rad: float, torque_nm: float, missing: int) -> int:
        """What is wrong with the axis; while an answer is missing, the other values are not checked."""
        if missing:
            return SILENT if missing >= self.missing_limit else IN_ORDER
        if status_word & _STATE_BITS != _OPERATION_ENABLED:
            return NOT_IN_OPERATION
        if self._wild >= WILD_LIMIT:
            return TOO_FAST
        if not self._low_rad <= position_rad <= self._high_rad:
            return BEYOND_LIMITS
        if abs(torque_nm) > self._torque_nm:
            return TOO_MUCH_TORQUE
        if abs(position_rad - reference_rad) > self._window_rad:
            self._beyond_s += self.period_s
            is_too_long = self._beyond_s > self.table.limits.following_error_timeout_s + 2.0 * self.period_s
            return TOO_FAR_BEHIND if is_too_long else IN_ORDER
        self._beyond_s = 0.0
        return IN_ORDER

    def skip(self) -> None:
        """Note a cycle without a measurement: the next position is more than a period away from the last."""
        self._last_rad = None

    def state(self) -> dict[str, float]:
        """What it knows from the cycles before, by the names of the record."""
        return {
            "discarded": self.discarded,
            "has_last": self._last_rad is not None,
            "cycles": self._cycles,
            "may_be_late": self._may_be_late,
            "wild": self._wild,
            "wild_rps": self._wild_rps,
            "beyond_s": self._beyond_s,
        } | ({} if self._last_rad is None else {"last_rad": self._last_rad})
