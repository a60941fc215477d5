"""What stops a run: the limits of the bench file and the health of drives, seen from the master. Pure: values in, reasons out."""

import math
from dataclasses import dataclass

from drive_profiles.cia402 import State, state_of
from hil.master.bench import Axis as AxisTable
from hil.master.bench import Bus


@dataclass
class AxisGuard:
    """Watches one axis, cycle by cycle.

    Attributes:
        number: Axis number.
        table: Its limits.
        bus: How many answers may be missing.
        period_s: SYNC period.
    """

    number: int
    table: AxisTable
    bus: Bus
    period_s: float
    _last_rad: float | None = None
    _beyond_s: float = 0.0

    def check(self, status_word: int, position_rad: float, reference_rad: float, torque_nm: float, missing: int) -> str | None:
        """The reason to stop, or None.

        The speed is the difference of two positions, so an encoder value that jumps further than the motor can turn stops the
        run as well.
        """
        name, limits = f"axis {self.number}", self.table.limits
        if missing:
            self._last_rad = None
            return f"{name} has not answered for {missing} cycles" if missing >= self.bus.missing_limit else None
        state = state_of(status_word)
        if state is not State.OPERATION_ENABLED:
            shown = "an unknown state" if state is None else state.value
            return f"{name} left operation enabled: {shown} (status word {status_word:04X}h)"
        turn = 2.0 * math.pi
        speed = 0.0 if self._last_rad is None else abs(position_rad - self._last_rad) / self.period_s / turn
        self._last_rad = position_rad
        if speed > 1.1 * limits.speed_rps:
            return f"{name} turns at {speed:.2f} rps, the limit is {limits.speed_rps:g} rps"
        revolutions = position_rad / turn
        if not limits.position_min_rev <= revolutions <= limits.position_max_rev:
            low, high = limits.position_min_rev, limits.position_max_rev
            return f"{name} is at {revolutions:.3f} rev, the limits are {low:g} and {high:g} rev"
        if abs(torque_nm) > 1.02 * limits.torque_nm:
            return f"{name} gives {torque_nm:.3g} N·m, the limit is {limits.torque_nm:g} N·m"
        return self._following(position_rad, reference_rad)

    def skip(self) -> None:
        """Nothing was measured in this cycle: the next position is not a period away from the last."""
        self._last_rad = None

    def _following(self, position_rad: float, reference_rad: float) -> str | None:
        error = abs(position_rad - reference_rad) / (2.0 * math.pi)
        limits = self.table.limits
        self._beyond_s = self._beyond_s + self.period_s if error > limits.following_error_rev else 0.0
        # the drive watches the same window; the master is the second line and lets it speak first
        if self._beyond_s > limits.following_error_timeout_s + 2.0 * self.period_s:
            return f"axis {self.number} is {error:.3f} rev behind its set-point, the limit is {limits.following_error_rev:g} rev"
        return None


def heartbeat_fault(node: int, last_s: float | None, now_s: float, since_s: float, heartbeat_s: float) -> str | None:
    """The reason to stop when a node's heartbeat is late: three periods after the last, or after supervision began."""
    reference = since_s if last_s is None else max(last_s, since_s)
    silence = now_s - reference
    if silence > 3.0 * heartbeat_s + 1e-9:
        return f"node {node} has lost its heartbeat: silent for {silence:.3f} s"
    return None
