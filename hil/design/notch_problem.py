"""Axis for which a notch is to be designed."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.design.coupled.loops import ArmLoops
from hil.design.frequency import Loop
from hil.design.ramp import RampMotion, follow_alike
from hil.design.uncertainty import Member

Displacement = Callable[[RampMotion], Real]
"""Displacement of the tip in mm over the time of a motion, as the metric of measured runs has it."""

WORSE_FRACTION, WORSE_MM = 0.05, 0.002
"""Bound: rise of a tip peak that the requirements allow (docs/rehearsal-results.md), whichever is more; a ratio is reckoned from
the latter where the peak is smaller."""
RISE = 1.0 + WORSE_FRACTION
"""Largest ratio by which a filter may raise a tip peak in the speeds of any order, for any plant."""
RISE_BESIDE = 1.15
"""The same between the orders' speeds, where a filter switches, and where the tip moves less than at an order's."""
RAMP_REST_S = 0.1
"""Accuracy: rest before a ramp, s: a factor of 2 changes tip peaks by 0.25 %."""
SETTLE_PERIODS = 3.0
"""Accuracy: periods of f_al of a ramp's turn at the top, and below the lowest judged speed, where the metric settles: a factor of
2 changes ratios of tip peaks by 2 %."""


@dataclass(frozen=True)
class Requirements:
    """Requirements on every filter, at every speed, for every plant.

    Attributes:
        max_sensitivity: Largest allowed M_s.
        gain_margin_db: Least gain margin, up and down.
        tip_mm: Limit A_acc, of constraint (5) on the line and of the tip on the ramp.
    """

    max_sensitivity: float = 1.7
    phase_margin_deg: float = 35.0
    gain_margin_db: float = 6.0
    tip_mm: float = 0.05

    def __post_init__(self) -> None:
        """Refuse limits that no loop can keep.

        Raises:
            ValueError: A limit is outside its range.
        """
        if not self.max_sensitivity > 1.0:
            raise ValueError(f"max_sensitivity = {self.max_sensitivity} must be above 1")
        if not 0.0 <= self.phase_margin_deg < 90.0:
            raise ValueError(f"phase_margin_deg = {self.phase_margin_deg} is not within 0 … 90")
        if not 0.0 <= self.gain_margin_db < math.inf:
            raise ValueError(f"gain_margin_db = {self.gain_margin_db} must not be below 0")
        if not 0.0 < self.tip_mm < math.inf:
            raise ValueError(f"tip_mm = {self.tip_mm} must be above 0")


@dataclass(frozen=True)
class DesignRamp:
    """Ramp from rest, up and down at one rate.

    The turn at the top is smooth.

    Attributes:
        rate_rps_s: Rate up and down.
        weight: Weight of its peaks in what a search minimises; that of the user's own motion is 1.
        period_s: Sampling time of `reference_rad`.
        reference_rad: θ_ref; shape (samples,).
    """

    rate_rps_s: float
    top_rps: float
    weight: float
    period_s: float
    rise_end_s: float
    fall_begin_s: float
    reference_rad: Real

    @classmethod
    def of(
        cls, rate_rps_s: float, low_rps: float, limit_rps: float, top_rps: float, f_al_hz: float, period_s: float,
        weight: float,
    ) -> "DesignRamp":  # fmt: skip
        """Lay out a ramp.

        Args:
            low_rps: Lowest speed in which the tip is judged.
            limit_rps: Largest speed of the axis, which the turn does not exceed.
            top_rps: Speed to which the rise leads, where the limit allows it.
            f_al_hz: Peak of |G_al|.
            weight: Weight of its peaks in a search.
        """
        turn_s = SETTLE_PERIODS / f_al_hz
        top = min(top_rps, limit_rps - float(_gain(0.5)) * rate_rps_s * turn_s)
        rise_end = RAMP_REST_S + top / rate_rps_s
        fall_begin = rise_end + turn_s
        bottom = max(0.0, low_rps - rate_rps_s * SETTLE_PERIODS / f_al_hz)
        count = math.ceil((fall_begin + (top - bottom) / rate_rps_s) / period_s) + 1
        time = (np.arange(count - 1) + 0.5) * period_s
        part = np.clip((time - rise_end) / turn_s, 0.0, 1.0)
        rising = rate_rps_s * np.clip(time - RAMP_REST_S, 0.0, rise_end - RAMP_REST_S)
        speed = rising + rate_rps_s * (turn_s * _gain(part) - np.clip(time - fall_begin, 0.0, None))
        angle = 2.0 * math.pi * period_s * np.concatenate([np.zeros(1), np.cumsum(speed)])
        return cls(rate_rps_s, top, weight, period_s, rise_end, fall_begin, angle)

    def rows(self, motion: RampMotion) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Rows in which the speed rises and in which it falls; shapes (n,)."""
        time = motion.period_s * np.arange(motion.motor_speed_rps.shape[-1])
        return (time >= RAMP_REST_S) & (time < self.rise_end_s), time >= self.fall_begin_s


@dataclass(frozen=True)
class SpeedRange:
    """Range of motor speeds in which the tip is judged.

    Attributes:
        order: Order k that meets f_al in it; None between the orders' ranges, where a filter may switch.
    """

    order: float | None
    low_rps: float
    high_rps: float


def _gain(part: Real | float) -> Real:
    """Gain of speed over a part, 0 to 1, of a turn, over rate and duration of the turn."""
    return np.asarray(part - np.square(part) + (1.0 - np.cos(2.0 * math.pi * part)) / (2.0 * math.pi**2))


def speed_ranges(windows_rps: Mapping[float, tuple[float, float]], low_rps: float, top_rps: float) -> tuple[SpeedRange, ...]:
    """Windows of the orders, and the ranges below, between and above them.

    >>> [(each.order, each.low_rps, each.high_rps) for each in speed_ranges({2: (4.5, 7.5), 4: (2.2, 3.6)}, 1.5, 11.0)]
    [(2, 4.5, 7.5), (4, 2.2, 3.6), (None, 1.5, 2.2), (None, 3.6, 4.5), (None, 7.5, 11.0)]

    Args:
        windows_rps: Speeds in which each order is judged.
    """
    found = [SpeedRange(order, low, min(high, top_rps)) for order, (low, high) in sorted(windows_rps.items())]
    reached = low_rps
    for low, high in sorted(windows_rps.values()):
        if low > reached:
            found.append(SpeedRange(None, reached, low))
        reached = max(reached, high)
    if reached < top_rps:
        found.append(SpeedRange(None, reached, top_rps))
    return tuple(found)


def peaks_in(ramp: DesignRamp, motion: RampMotion, displacement_mm: Real, ranges: Sequence[SpeedRange]) -> Real:
    """Find the largest |displacement| in each range, rising and falling.

    It is 0 if the ramp does not reach the range.

    Args:
        displacement_mm: Displacement of the tip; shape (…, n), of the motion.

    Returns:
        Peaks in mm; shape (…, ranges, 2).
    """
    size, speed = np.abs(displacement_mm)[..., np.newaxis, :], np.abs(motion.motor_speed_rps)[..., np.newaxis, :]
    low, high = np.array([(each.low_rps, each.high_rps) for each in ranges]).T[:, :, np.newaxis]
    inside = (speed >= low) & (speed <= high)
    return np.stack([np.max(np.where(inside & rows, size, 0.0), axis=-1) for rows in ramp.rows(motion)], axis=-1)


@dataclass(frozen=True)
class NotchProblem:
    """An axis whose notch is wanted.

    Attributes:
        members: The plants; the nominal one first.
        delay_samples: Whole samples between measurement and torque.
        lever_m: L, from the arm's axis to the tip.
        speed_limit_rps: Highest motor speed at which margins are required.
        f_al_hz: Peak of |G_al| of the nominal plant without a filter.
        ramps: Ramps on which a filter is judged; the user's own motion first.
        ranges: Ranges of speeds in which the tip is looked at: one for each order that the error has and the axis reaches.
        displacement_mm: Metric of the tip's motion.
        fixed: Filters of other orders, which stay as they are.
        friction_nm: Friction against the turning motor.
        gravity_nm: Gravity at the motor, which acts against it or helps it.
        is_gravity_known: True if gravity was identified; then the gear's reaction under gravity is judged as well.
        arm: Its loop on the arm that it is part of, where margins are required as well; None for an axis by itself.
    """

    members: tuple[Member, ...]
    cascade: Cascade
    period_s: float
    delay_samples: int
    lever_m: float
    speed_limit_rps: float
    f_al_hz: float
    ramps: tuple[DesignRamp, ...]
    ranges: tuple[SpeedRange, ...]
    displacement_mm: Displacement
    requirements: Requirements = field(default_factory=Requirements)
    fixed: tuple[Notch, ...] = ()
    friction_nm: float = 0.0
    gravity_nm: float = 0.0
    is_gravity_known: bool = False
    arm: ArmLoops | None = None

    @property
    def orders(self) -> tuple[float, ...]:
        """Orders of the error that the axis reaches."""
        return tuple(each.order for each in self.ranges if each.order is not None)

    def window_rps(self, order: float) -> tuple[float, float]:
        """Speeds in which an order is judged."""
        found = self.ranges[self.row(order)]
        return found.low_rps, found.high_rps

    def row(self, order: float) -> int:
        """Row of an order among the ranges."""
        return next(row for row, each in enumerate(self.ranges) if each.order == order)

    def loop(self, member: Member, notches: Sequence[Notch] = ()) -> Loop:
        """Loop around one plant."""
        return Loop(member.plant, self.cascade, tuple(notches), self.period_s, self.delay_samples)

    @cached_property
    def bare_mm(self) -> tuple[Real, ...]:
        """Tip peaks of each plant without filters, see `peaks_mm`."""
        return tuple(self.peaks_mm(member, ()) for member in self.members)

    def peaks_mm(self, member: Member, notches: Sequence[Notch]) -> Real:
        """Tip peaks of a plant by case, range and direction, in mm; shape (cases, ranges, 2)."""
        return np.array([self.case_peaks_mm(member, [notches], case)[0] for case in range(len(self.cases(member)))])

    def cases(self, member: Member) -> list[tuple[DesignRamp, tuple[float, float]]]:
        """Ramp and load of every case of a plant, the load as `follow` has it.

        Cases of the nominal plant: every ramp under friction and gravity, the user's own first; that one with gravity's help;
        and where gravity is known, that one with the gear's reaction on the motor, gravity against it and with it. Other plants
        go along the user's ramp alone.
        """
        heavy, light = (self.friction_nm + self.gravity_nm, 0.0), (self.friction_nm - self.gravity_nm, 0.0)
        if member is not self.members[0]:
            return [(self.ramps[0], heavy)]
        found = [*((ramp, heavy) for ramp in self.ramps), (self.ramps[0], light)]
        if self.is_gravity_known:
            found += [(self.ramps[0], (self.friction_nm, sign * self.gravity_nm)) for sign in (1.0, -1.0)]
        return found

    def case_peaks_mm(self, member: Member, filters: Sequence[Sequence[Notch]], case: int) -> Real:
        """Simulate the tip peaks of a plant in one case, with some filters or with others.

        Peaks by choice of filters, range and direction, in mm; shape (filters, ranges, 2).
        """
        ramp, load = self.cases(member)[case]
        loops = [self.loop(member, notches) for notches in filters]
        motion = follow_alike(loops, [member.error] * len(loops), ramp.reference_rad, load_nm=load)
        return peaks_in(ramp, motion, self.displacement_mm(motion), self.ranges)

    def weighted_mm(self, peaks_mm: Real, order: float) -> float:
        """Largest weighted tip peak of an order, in mm.

        Each peak of `peaks_mm` is multiplied by the weight of its ramp. Cases with the gear's reaction do not count.
        """
        weights = np.array([*(ramp.weight for ramp in self.ramps), 1.0])[: len(peaks_mm)]
        return float(np.max(weights[:, np.newaxis] * peaks_mm[: len(weights), self.row(order)]))


@dataclass(frozen=True)
class Rise:
    """Ratio of a tip peak to that without a filter.

    Attributes:
        order: Order k in whose speeds the tip is looked at; None between them.
    """

    order: float | None
    ratio: float
    limit: float

    @property
    def excess(self) -> float:
        """Fraction by which the ratio exceeds its limit, else 0."""
        return max(0.0, self.ratio / self.limit - 1.0)


def rises(problem: NotchProblem, before_mm: Real, after_mm: Real) -> list[Rise]:
    """Compare the tip peaks of each range with and without filters.

    Peaks on the user's own motion are compared case by case. For an order, the largest peak on any ramp is compared as well.

    Args:
        before_mm: Peaks of a plant without filters, from `NotchProblem.peaks_mm`.
        after_mm: Peaks of the same plant with them; while cases but the first still hold 0, no ratio is above the final one.
    """
    own, is_order = [0, *range(len(problem.ramps), len(after_mm))], np.array([each.order is not None for each in problem.ranges])
    least = np.where(is_order, WORSE_MM, np.maximum(WORSE_MM, np.max(after_mm[0, is_order])))
    ratios = np.max(after_mm[own] / np.maximum(before_mm[own], least[:, np.newaxis]), axis=(0, 2))
    whole = np.max(after_mm, axis=(0, 2)) / np.maximum(np.max(before_mm, axis=(0, 2)), least)
    ratios = np.where(is_order, np.maximum(ratios, whole), ratios)
    limits = np.where(is_order, RISE, RISE_BESIDE)
    return [Rise(each.order, *pair) for each, *pair in zip(problem.ranges, ratios.tolist(), limits.tolist(), strict=True)]
