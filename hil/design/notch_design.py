"""Requirements on a variable notch, and the verdict on one: margins at every speed, constraint (5), the tip on a ramp."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, Notch
from hil.design.frequency import Loop, Margins, acceleration_bound
from hil.design.ramp import RampMotion, follow
from hil.design.speed_margins import LoopFamily, widened
from hil.design.uncertainty import Member

Real = NDArray[np.float64]

TipPeak = Callable[[RampMotion, float, float], tuple[float, float]]
"""Largest tip displacement in mm while a motion's speed rises from the one to the other speed in rev/s, and while it falls."""

SHAPES = {"switched": NOTCH_SWITCHED, "trapezoid": NOTCH_TRAPEZOID}

BEYOND_RPS = 0.6
"""Speed range beyond f_e in which the tip is watched too, since the end of a filter can shake the arm."""

SEARCH_SPEEDS = 24
"""Speeds at which the search looks at a filter; the verdict looks every 0.1 rev/s."""

VERDICT_STEP_RPS = 0.1

BARE_STEP_RPS = 0.05


@dataclass(frozen=True)
class Requirements:
    """Requirements on every filter, at every speed, for every plant.

    Attributes:
        max_sensitivity: Largest allowed M_s.
        phase_margin_deg: Least phase margin.
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
            raise ValueError(f"max_sensitivity = {self.max_sensitivity} must be above 1, which only an open loop has")
        if not 0.0 <= self.phase_margin_deg < 90.0:
            raise ValueError(f"phase_margin_deg = {self.phase_margin_deg} is not within 0 … 90")
        for name in ("gain_margin_db", "tip_mm"):
            if not (getattr(self, name) >= 0.0 and math.isfinite(getattr(self, name))):
                raise ValueError(f"{name} = {getattr(self, name)} must not be below 0")


@dataclass(frozen=True)
class RequirementCheck:
    """One requirement with the worst value that was seen.

    Attributes:
        name: The requirement.
        value: Worst value of all plants and speeds.
        limit: The value that is required.
        unit: Unit of value and limit.
        is_ceiling: True where the value must be at most the limit; else at least.
        speed_rps: Speed at which it is worst; None where it belongs to no speed.
        member: The plant that gives it.
    """

    name: str
    value: float
    limit: float
    unit: str
    is_ceiling: bool
    speed_rps: float | None
    member: str

    @property
    def violation(self) -> float:
        """Fraction of the limit by which the requirement is missed; 0 where it holds."""
        excess = self.value - self.limit if self.is_ceiling else self.limit - self.value
        return max(0.0, excess / max(abs(self.limit), 1e-9)) if not math.isnan(excess) else math.inf

    @property
    def holds(self) -> bool:
        """True where the requirement is met."""
        return self.violation == 0.0

    def __str__(self) -> str:
        """Say it as a sentence without its verb."""
        where = "" if self.speed_rps is None else f" at {self.speed_rps:.2f} rev/s"
        bound = "at most" if self.is_ceiling else "at least"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} {self.value:.4g}{unit}{where} ({self.member}), {bound} {self.limit:.4g}{unit} asked"


@dataclass(frozen=True)
class NotchProblem:
    """An axis whose notch is wanted.

    Attributes:
        members: The plants; the believed one first.
        cascade: The gains.
        period_s: Sampling time of the loop.
        delay_samples: Whole samples between measurement and torque.
        lever_m: L, from the arm's axis to the tip.
        speed_limit_rps: Highest motor speed at which margins are required.
        reference_rad: θ_ref of the ramp on which the filter is judged, up and down, at the loop's period; shape (samples,).
        windows_rps: Speeds in which the tip is judged, by order.
        tip_peak: Metric of the tip's motion.
        requirements: Requirements that a filter must meet.
        fixed: Filters of other orders, which stay as they are.
    """

    members: tuple[Member, ...]
    cascade: Cascade
    period_s: float
    delay_samples: int
    lever_m: float
    speed_limit_rps: float
    reference_rad: Real
    windows_rps: Mapping[int, tuple[float, float]]
    tip_peak: TipPeak
    requirements: Requirements = field(default_factory=Requirements)
    fixed: tuple[Notch, ...] = ()

    def loop(self, member: Member, notches: Sequence[Notch] = ()) -> Loop:
        """The loop around one plant."""
        return Loop(member.plant, self.cascade, tuple(notches), self.period_s, self.delay_samples)

    def peaks(self, member: Member, notches: Sequence[Notch], order: int) -> tuple[float, float]:
        """Tip peak in mm on the ramp, rising and falling, in the window of an order and beyond the end of its filter."""
        low, high = self.windows_rps[order]
        high = max([high, *(notch.end_rps + BEYOND_RPS for notch in notches if notch.order == order)])
        return self.tip_peak(follow(self.loop(member, notches), member.error, self.reference_rad), low, high)


class Judge:
    """Weighs filters of one order quickly: the parts that they share are computed once.

    Attributes:
        problem: The axis.
        order: Order k of the filters.
        allowed_mm: Tip peaks of the fixed filters' orders, which a new filter must not raise by more than 2 %.
    """

    def __init__(self, problem: NotchProblem, order: int, *, reserve: float = 0.01) -> None:
        """Compute the loops without the new filter.

        Args:
            problem: The axis.
            order: Order k of the filters.
            reserve: Fraction by which the limits are tighter than required, since the verdict looks at more speeds and
                frequencies.
        """
        self.problem, self.order = problem, order
        self._family = LoopFamily([problem.loop(member) for member in problem.members])
        self._bare_rps = np.arange(BARE_STEP_RPS, problem.speed_limit_rps + 1e-9, BARE_STEP_RPS)
        amplitude = np.array([member.error.amplitude_arcsec[order] for member in problem.members]) * ARCSEC
        # in terms of |X|, constraint (5) is the same at every frequency
        one_hz = np.array([1.0])
        limit = 1e-3 * problem.requirements.tip_mm
        self._bound = (
            np.array([acceleration_bound(one_hz, a, problem.lever_m, limit)[0] for a in amplitude]) / (2.0 * math.pi) ** 2
        )
        self._bare_gain = self._family.gain_on_the_line(problem.fixed, order, self._bare_rps)
        self._reserve = reserve
        self._others = sorted({notch.order for notch in problem.fixed} & set(problem.windows_rps))
        nominal = problem.members[0]
        self.allowed_mm = {k: 1.02 * max(problem.peaks(nominal, problem.fixed, k)) for k in self._others}

    def checks(self, notch: Notch) -> list[RequirementCheck]:
        """Requirements at constant speeds, each at its worst; stability as turns of the Nyquist curve, which must be 0."""
        limits, names = self.problem.requirements, [member.label for member in self.problem.members]
        notches, wide = (notch, *self.problem.fixed), widened(notch)
        top = min(wide.end_rps, self.problem.speed_limit_rps)
        edges = [edge for other in self.problem.fixed for edge in (other.start_rps, other.end_rps)]
        inside = [edge for edge in edges if wide.start_rps < edge < top]
        speeds = np.unique(np.concatenate([np.linspace(wide.start_rps, max(top, wide.start_rps), SEARCH_SPEEDS), inside]))
        margins = self._family.margins(notches, speeds)

        def worst(name: str, values: Real, limit: float, unit: str, *, is_ceiling: bool, at: Real = speeds) -> RequirementCheck:
            at_worst = np.unravel_index(int(np.argmax(values) if is_ceiling else np.argmin(values)), values.shape)
            return RequirementCheck(
                name, float(values[at_worst]), limit, unit, is_ceiling, float(at[at_worst[1]]), names[int(at_worst[0])]
            )

        filtered = self._family.gain_on_the_line(notches, self.order, speeds)
        outside = (self._bare_rps < notch.start_rps) | (self._bare_rps > notch.end_rps)
        at = np.concatenate([speeds, self._bare_rps[outside]])
        ratio = np.concatenate([filtered, self._bare_gain[:, outside]], axis=1) / self._bound[:, np.newaxis]
        tighter = 1.0 - self._reserve
        return [
            worst("turns of the Nyquist curve", np.abs(margins.turns), 0.0, "", is_ceiling=True),
            worst("M_s", margins.sensitivity_peak, 1.0 + tighter * (limits.max_sensitivity - 1.0), "", is_ceiling=True),
            worst("phase margin", margins.phase_margin_deg, limits.phase_margin_deg / tighter, "°", is_ceiling=False),
            worst("gain margin", margins.gain_margin_db, limits.gain_margin_db / tighter, "dB", is_ceiling=False),
            worst("|G_al| on the line over constraint (5)", ratio, tighter, "", is_ceiling=True, at=at),
        ]

    def score(self, notch: Notch, members: int | None = None) -> float:
        """Tip peak in mm with a filter, for the worst of the first `members` plants; above 10 where the filter breaks a limit.

        Filters that break a limit are ranked by their violation, without a simulation, and behind all that keep the limits.
        """
        missed = sum(check.violation for check in self.checks(notch))
        if missed > 0.0:
            return 10.0 + missed
        notches = (notch, *self.problem.fixed)
        peak = 0.0
        for member in self.problem.members[:members]:
            rising, falling = self.problem.peaks(member, notches, self.order)
            peak = max(peak, rising, falling)
        nominal = self.problem.members[0]
        for order, allowed in self.allowed_mm.items():
            spoilt = max(self.problem.peaks(nominal, notches, order)) / allowed - 1.0
            peak *= 1.0 + 20.0 * max(0.0, spoilt)
        return min(peak, 9.0) if math.isfinite(peak) else 9.0


@dataclass(frozen=True)
class PeakRow:
    """Predicted peaks of the tip on the ramp.

    Attributes:
        order: Order k of the error.
        rising_mm: Tip peak of the believed plant while the speed rises, as in a constant-acceleration run.
        falling_mm: Tip peak of the believed plant while the speed falls.
        worst_mm: The larger of both for the worst of all plants.
        worst_member: Label of that plant.
    """

    order: int
    rising_mm: float
    falling_mm: float
    worst_mm: float
    worst_member: str


@dataclass(frozen=True)
class NotchVerdict:
    """Close check of filters: every 0.1 rev/s from rest to the speed limit, closed-loop poles included.

    Attributes:
        notches: The filters.
        checks: Every requirement at its worst.
        margins: Margins of the believed plant, by speed.
        peaks: Tip peaks, by order.
    """

    notches: tuple[Notch, ...]
    checks: tuple[RequirementCheck, ...]
    margins: Mapping[float, Margins]
    peaks: tuple[PeakRow, ...]

    @property
    def holds(self) -> bool:
        """True where all requirements are met."""
        return all(check.holds for check in self.checks)

    @property
    def missed(self) -> tuple[RequirementCheck, ...]:
        """Checks that are not met, the worst first."""
        return tuple(sorted((check for check in self.checks if not check.holds), key=lambda check: -check.violation))

    def peak(self, order: int) -> PeakRow:
        """Tip peaks of one order."""
        return next(row for row in self.peaks if row.order == order)


def verdict(problem: NotchProblem, notches: Sequence[Notch], orders: Sequence[int]) -> NotchVerdict:
    """Judge filters by all requirements, for every plant, at every speed.

    Args:
        problem: The axis; its `fixed` filters count only where they are among `notches`.
        notches: All filters that act.
        orders: Orders for which constraint (5) and the tip peak are checked.
    """
    wide = [widened(notch) for notch in notches]
    edges = [edge for notch in wide for edge in (notch.start_rps, notch.end_rps) if edge <= problem.speed_limit_rps]
    grid = np.arange(0.0, problem.speed_limit_rps + 1e-9, VERDICT_STEP_RPS)
    speeds = np.unique(np.round(np.concatenate([grid, edges]), 9))
    margins_by_plant = _margins(problem, wide, speeds)
    rows = tuple(_peak_row(problem, notches, order) for order in orders)
    checks = [
        *_margin_checks(problem.requirements, margins_by_plant),
        *(_line_check(problem, notches, order) for order in orders),
    ]
    for row in rows:
        name = f"tip peak on the ramp, k = {row.order},"
        checks.append(RequirementCheck(name, row.worst_mm, problem.requirements.tip_mm, "mm", True, None, row.worst_member))
    return NotchVerdict(tuple(notches), tuple(checks), margins_by_plant[problem.members[0].label], rows)


def _margins(problem: NotchProblem, wide: Sequence[Notch], speeds: Real) -> dict[str, dict[float, Margins]]:
    """Margins by plant and speed; poles are computed anew only where a filter changes them."""
    loops = [problem.loop(member, wide) for member in problem.members]
    scanned = LoopFamily(loops, step_hz=0.01).margins(wide, speeds)
    by_plant: dict[str, dict[float, Margins]] = {}
    for row, (member, loop) in enumerate(zip(problem.members, loops, strict=True)):
        bare = float(np.abs(replace(loop, notches=()).closed_loop_poles()).max())
        by_plant[member.label] = {}
        for column, speed in enumerate(float(each) for each in speeds):
            acts = any(notch.start_rps <= speed <= notch.end_rps for notch in wide)
            radius = float(np.abs(loop.closed_loop_poles(speed)).max()) if acts else bare
            by_plant[member.label][speed] = Margins(
                sensitivity_peak=float(scanned.sensitivity_peak[row, column]),
                gain_margin_db=float(scanned.gain_margin_db[row, column]),
                phase_margin_deg=float(scanned.phase_margin_deg[row, column]),
                stable=radius < 1.0,
                pole_radius=radius,
            )
    return by_plant


def _margin_checks(requirements: Requirements, margins_by_plant: Mapping[str, Mapping[float, Margins]]) -> list[RequirementCheck]:
    flat = [(label, speed, one) for label, speeds in margins_by_plant.items() for speed, one in speeds.items()]
    checks = []
    for name, attribute, limit, unit, is_ceiling in (
        ("pole radius", "pole_radius", 1.0, "", True),
        ("M_s", "sensitivity_peak", requirements.max_sensitivity, "", True),
        ("phase margin", "phase_margin_deg", requirements.phase_margin_deg, "°", False),
        ("gain margin", "gain_margin_db", requirements.gain_margin_db, "dB", False),
    ):
        label, speed, one = (max if is_ceiling else min)(flat, key=lambda item: float(getattr(item[2], attribute)))
        checks.append(RequirementCheck(name, float(getattr(one, attribute)), limit, unit, is_ceiling, speed, label))
    return checks


def _line_check(problem: NotchProblem, notches: Sequence[Notch], order: int) -> RequirementCheck:
    """Constraint (5) on the line; where a switched filter may be in or out, both count."""
    family = LoopFamily([problem.loop(member) for member in problem.members])
    speeds = np.arange(BARE_STEP_RPS, problem.speed_limit_rps + 1e-9, BARE_STEP_RPS)
    own = [notch for notch in notches if notch.order == order]
    others = [notch for notch in notches if notch.order != order]
    gains = family.gain_on_the_line(notches, order, speeds)
    inside = np.zeros(len(speeds), dtype=np.bool_)
    for notch in own:
        inside |= (speeds >= notch.start_rps) & (speeds <= notch.end_rps)
    gains = np.where(inside, gains, np.maximum(gains, family.gain_on_the_line(others, order, speeds)))
    amplitudes = np.array([member.error.amplitude_arcsec[order] for member in problem.members]) * ARCSEC
    ratio = gains * problem.lever_m * amplitudes[:, np.newaxis] / (1e-3 * problem.requirements.tip_mm)
    p, s = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    name = f"|G_al| on the line over constraint (5), k = {order},"
    return RequirementCheck(name, float(ratio[p, s]), 1.0, "", True, float(speeds[s]), problem.members[int(p)].label)


def _peak_row(problem: NotchProblem, notches: Sequence[Notch], order: int) -> PeakRow:
    pairs = {member.label: problem.peaks(member, notches, order) for member in problem.members}
    rising, falling = pairs[problem.members[0].label]
    worst = max(pairs, key=lambda label: max(pairs[label]))
    return PeakRow(order, rising, falling, max(pairs[worst]), worst)
