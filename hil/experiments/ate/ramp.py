"""Plan of a ramp within limits, with what binds it.

A ramp accelerates from rest, and brakes. It takes the revolutions v²/2 (1/a + 1/d) of the motor.

What is wanted is an acceleration and an end speed. Where travel is short, the acceleration is raised for a least end speed, up to
that with which the ramp brakes; then the end speed is lowered. On an arm the travel is `identification_travel_deg` of the joint
to either side, since further on it rings at other frequencies.
"""

import math
from dataclasses import dataclass
from typing import Literal

from hil.bench.bench import Bench
from hil.control.cancellation_table import LIMIT_USED
from hil.control.trajectory import reach_rps
from hil.design.estimation import ROUNDING
from hil.design.ringing import BEYOND_RESONANCE, LEAST_END_RPS, RINGING
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.motions import MARGIN_REV

Binding = Literal["", "speed", "acceleration", "joint travel", "position limits"]
"""Limit that binds a ramp: without it alone, it would end faster or accelerate more slowly; empty if none does."""

ADVISED_RPS_S = 50.0
"""Bound: accelerations from here on are not advised in messages: order 2 meets an arm of 12 Hz after 1.4 of its periods."""
FIRST_ORDER_END = 1.2
"""Measured: end speed of a ramp over f_a where order 1 is to pass the resonance as well: 1.15 and 1.35 change no number of passes
of four drawn robots, errors by 26 %, and 5 of 160 drawn robots have no room for 1.35."""
ACCELERATION_RPS_S, ACCELERATION_AT_HZ = 4.0, 12.0
"""Measured: acceleration of a first pass, which goes with f_a², and the f_a for which it is meant: A_2 scatters by 0.5 %, A_4 by
0.7 % (docs/theory-transmission-error.md)."""
ARM_HURRY = 2.0
"""Acceleration over that of a first pass up to which a ramp on an arm goes on to a lower order: others show less on it."""
DEFAULT_END_RPS, DEFAULT_DECELERATION_RPS_S = 10.0, 20.0
"""Bound: end speed where f_a is not known, at which order 2 has passed 17 Hz; deceleration where no bench file names one."""


@dataclass(frozen=True)
class RampLimits:
    """Limits of a ramp, at the motor.

    Attributes:
        acceleration_rps_s: Acceleration limit; infinite without one.
        deceleration_rps_s: Deceleration with which ramps end, within that limit.
        position_rev: Travel between the position limits, `MARGIN_REV` off either.
        joint_rev: Travel of an arm's joint; infinite without an arm.
        joint_deg: The same at the joint, to either side.
        blind_end_rps: End speed that is wanted where no f_a is known.
    """

    axis: int
    speed_rps: float
    acceleration_rps_s: float
    deceleration_rps_s: float
    position_rev: float
    joint_rev: float = math.inf
    joint_deg: float = math.inf
    blind_end_rps: float = DEFAULT_END_RPS

    @classmethod
    def of(cls, bench: Bench, axis: int) -> "RampLimits":
        """Limits of an axis of a bench file."""
        limits, motion = bench.axis[axis].limits, bench.constant_acceleration
        braking, blind = DEFAULT_DECELERATION_RPS_S, DEFAULT_END_RPS
        if motion is not None:  # the end speed of that other experiment is not a limit
            braking, blind = motion.deceleration_rps_s, max(motion.end_rps, blind)
        most = limits.acceleration_rps_s or math.inf
        room = limits.position_max_rev - limits.position_min_rev - 2.0 * MARGIN_REV
        return cls(axis, limits.speed_rps, most, braking, room, bench.travel_rev(axis), bench.travel_deg, blind)

    @property
    def top_rps(self) -> float:
        """Largest speed of a ramp."""
        return LIMIT_USED * self.speed_rps

    @property
    def braking_rps_s(self) -> float:
        """Deceleration of every ramp; no acceleration is raised beyond it."""
        return min(self.deceleration_rps_s, self.acceleration_rps_s)

    @property
    def room_rev(self) -> float:
        """Motor revolutions that a ramp may take."""
        return max(min(self.position_rev, self.joint_rev), 0.0)

    @property
    def is_arm(self) -> bool:
        """True on an arm, whose joint's travel is limited."""
        return math.isfinite(self.joint_deg)

    @property
    def travel_limit(self) -> Binding:
        """Limit that leaves the room."""
        return "joint travel" if self.joint_rev < self.position_rev else "position limits"

    def slowest(self, end_rps: float) -> float:
        """Least acceleration with room for a ramp; infinite without any."""
        left = 2.0 * self.room_rev / end_rps**2 - 1.0 / self.braking_rps_s if end_rps > 0.0 else math.inf
        return 1.0 / left if left > 0.0 else math.inf

    def suited(self, arm_hz: float | None) -> float:
        """Acceleration of a first pass in rev/s².

        It gives the same number of periods in the resonance at any f_a; without an f_a it is 4. It is no larger than the
        deceleration.
        """
        scale = 1.0 if arm_hz is None else (arm_hz / ACCELERATION_AT_HZ) ** 2
        return min(ACCELERATION_RPS_S * scale, self.braking_rps_s)

    def low_order_end(self, arm_hz: float, order: float, asked_rps_s: float) -> float:
        """End speed with which a low order passes the resonance, or 0."""
        end = min(FIRST_ORDER_END * arm_hz / order, self.top_rps)
        fastest = self.braking_rps_s
        if self.is_arm:
            fastest = min(ARM_HURRY * self.suited(arm_hz), max(asked_rps_s, fastest))
        return end if self.slowest(end) < fastest and end >= BEYOND_RESONANCE * arm_hz / order else 0.0


@dataclass(frozen=True)
class Ramp:
    """Ramp within its limits.

    Attributes:
        binds: Limit that binds it.
    """

    limits: RampLimits
    asked_rps_s: float
    acceleration_rps_s: float
    end_rps: float
    binds: Binding

    @property
    def travel_rev(self) -> float:
        """Motor revolutions that it takes."""
        return self._travel_rev(self.end_rps)

    def _travel_rev(self, end_rps: float) -> float:
        return 0.5 * end_rps**2 * (1.0 / self.acceleration_rps_s + 1.0 / self.limits.braking_rps_s)

    @property
    def bound(self) -> str:
        """End of a sentence on what binds it; may be empty."""
        limits = self.limits
        words = {
            "speed": f"its speed limit, {limits.speed_rps:g} rev/s",
            "acceleration": f"its acceleration limit, {limits.acceleration_rps_s:g} rev/s²",
            "joint travel": f"the travel of the arm's joint, ±{limits.joint_deg:g}° (identification_travel_deg)",
            "position limits": "its position limits",
        }
        return f"; the limit is {words[self.binds]}" if self.binds else ""

    def short_of(self, end_rps: float) -> str:
        """Say what keeps this acceleration from a speed; empty if nothing does."""
        limits = self.limits
        binds = plan_ramp(limits, self.acceleration_rps_s, end_rps).binds
        if not binds:
            return ""
        if binds == "speed":
            return f"its limit speed_rps is {limits.speed_rps:g}; at least {end_rps / LIMIT_USED:.2f} is needed"
        where, remedies = "between its position limits", ["widen them"]
        if limits.travel_limit == "joint travel":
            where, remedies = f"within ±{limits.joint_deg:g}° of the joint", ["raise identification_travel_deg"]
        least = limits.slowest(end_rps)
        if binds == "acceleration":
            remedies.insert(0, f"raise its limit acceleration_rps_s, {limits.acceleration_rps_s:g}")
        elif least < min(ADVISED_RPS_S, limits.acceleration_rps_s):
            remedies.insert(0, f"accelerate with {least:.2f} rev/s² or more")
        return (
            f"that takes {self._travel_rev(end_rps):.1f} rev at {self.acceleration_rps_s:.3g} rev/s²; {where} there are "
            f"{limits.room_rev:.1f} rev; {', or '.join(remedies)}"
        )

    def beyond(self, arm_hz: float | None) -> "Ramp":
        """Return the ramp if it passes f_m2.

        Without an f_a any ramp will do that moves at all.

        Raises:
            NotPossibleError: Limits keep it from that; with the number needed.
        """
        needed, why = LEAST_END_RPS, ""
        if arm_hz is not None:
            needed, why = BEYOND_RESONANCE * arm_hz / 2.0, f"to pass f_a/2 = {arm_hz / 2.0:.2f} rev/s, "
        if self.end_rps >= needed:
            return self
        head = f"axis {self.limits.axis} reaches {self.end_rps:.2f} rev/s; {why}{needed:.2f} rev/s are needed"
        raise NotPossibleError(f"{head}: {self.short_of(needed)}", ("limits",))


def plan_ramp(limits: RampLimits, asked_rps_s: float, end_rps: float, least_end_rps: float = 0.0) -> Ramp:
    """Fit a ramp into its limits.

    The acceleration is raised until there is room for `least_end_rps`; 0: it is not raised.

    Raises:
        NotPossibleError: The acceleration is not above 0, or not finite.
        UnsafeRequestError: The acceleration is beyond its limit.
    """
    most, braking, top = limits.acceleration_rps_s, limits.braking_rps_s, limits.top_rps
    if not math.isfinite(asked_rps_s) or asked_rps_s <= 0.0:
        raise NotPossibleError(f"an acceleration of {asked_rps_s:g} rev/s² makes no ramp; it must be above 0")
    if asked_rps_s > most:
        remedy = f"lower it, or raise axis.{limits.axis}.limits.acceleration_rps_s"
        raise UnsafeRequestError(f"the acceleration of axis {limits.axis}", asked_rps_s, most, "rev/s²", remedy)
    acceleration = max(asked_rps_s, min((1.0 + ROUNDING) * limits.slowest(min(least_end_rps, top)), braking))
    by_travel = reach_rps(limits.room_rev, acceleration, braking)
    end = min(end_rps, top, by_travel)
    binds: Binding = ""
    if end >= top:
        binds = "speed"
    elif end >= by_travel and acceleration >= most and most < limits.deceleration_rps_s:
        binds = "acceleration"
    elif end >= by_travel or acceleration > asked_rps_s:
        binds = limits.travel_limit
    return Ramp(limits, asked_rps_s, acceleration, end, binds)


def resonance_ramp(limits: RampLimits, arm_hz: float | None, asked_rps_s: float, *, is_raised: bool) -> Ramp:
    """Plan a ramp beyond f_m2 = f_a/2, or as near as possible.

    Without an f_a it aims at `blind_end_rps`, with room for f_m2 of an arm of `ACCELERATION_AT_HZ`. `is_raised`: where travel is
    short.
    """
    least = RINGING * (ACCELERATION_AT_HZ if arm_hz is None else arm_hz) / 2.0
    return plan_ramp(limits, asked_rps_s, limits.blind_end_rps if arm_hz is None else least, least if is_raised else 0.0)
