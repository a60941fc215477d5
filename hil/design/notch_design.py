"""Verdict on a variable notch, and the score of a search."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.notch import NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID, Notch
from hil.design.coupled.loops import ArmFamily
from hil.design.frequency import Margins
from hil.design.notch_problem import RISE_BESIDE, NotchProblem, Requirements, Rise, rises
from hil.design.speed_margins import LoopFamily, SpeedMargins, widened

SHAPES = {"switched": NOTCH_SWITCHED, "trapezoid": NOTCH_TRAPEZOID}

SEARCH_SPEEDS = 24
"""Accuracy: speeds at which the search looks at a filter; the verdict looks more closely."""

VERDICT_STEPS = 120
"""Accuracy: speeds of a verdict per f_al, in rev/s: M_s of Table 3 to 0.02 %, the phase margin to 0.1 %."""
BARE_STEPS = 240
"""Accuracy: the same for constraint (5), to 1 %."""

VERDICT_FREQUENCY_STEP = 1.0 / 1280.0
"""Accuracy: step of a verdict's frequencies in units of f_a: M_s of Table 3 to 0.005 %."""

SEARCH_STEP, ARM_STEP = 1.0 / 320.0, 1.0 / 640.0
"""Accuracy: the same of a search and a verdict on an arm, in units of its lowest mode: M_s to 0.1 % and 0.003 %."""
ON_THE_ARM = " on the arm"
"""What the margins of the arm's postures are called beyond those of the axis by itself."""

WORST_RATIO = 2.0
"""Accuracy: score above which a filter raises a peak, or breaks a margin: any that no worthwhile filter has."""


@dataclass(frozen=True)
class RequirementCheck:
    """One requirement with the worst value that was seen.

    Attributes:
        value: Worst value of all plants and speeds.
        is_ceiling: True if the value must be at most the limit; else at least.
        speed_rps: Speed at which it is worst; None if it belongs to no speed.
        member: The plant that gives it.
        is_tip_limit: True if it limits the tip in mm: a filter that misses it may still be the best there is.
        is_rise: True if it compares a peak with that without a filter.
    """

    name: str
    value: float
    limit: float
    unit: str
    is_ceiling: bool
    speed_rps: float | None
    member: str
    is_tip_limit: bool = False
    is_rise: bool = False

    @property
    def violation(self) -> float:
        """Fraction of the limit by which the requirement is missed, else 0."""
        excess = self.value - self.limit if self.is_ceiling else self.limit - self.value
        return max(0.0, excess / max(abs(self.limit), 1e-9)) if not math.isnan(excess) else math.inf

    @property
    def holds(self) -> bool:
        """True if the requirement is met."""
        return self.violation == 0.0

    def __str__(self) -> str:
        """Requirement, value and limit in words, without a verb."""
        where = "" if self.speed_rps is None else f" at {self.speed_rps:.2f} rev/s"
        bound = "at most" if self.is_ceiling else "at least"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} {self.value:.4g}{unit}{where} ({self.member}), {bound} {self.limit:.4g}{unit} required"


class Judge:
    """Judge of filters of one order, for a search."""

    def __init__(self, problem: NotchProblem, order: int, *, reserve: float = 0.01) -> None:
        """Compute the loops without the new filter.

        Args:
            reserve: Fraction by which the limits are tighter than required, since the verdict looks at more speeds and
                frequencies.
        """
        self.problem, self.order = problem, order
        self._family = LoopFamily([problem.loop(member) for member in problem.members])
        self._arm = None if problem.arm is None else problem.arm.family(SEARCH_STEP, with_filtered=False)
        self._reserve = reserve
        self._bare_rps = np.arange(0.5, 1.5, 1.0 / 60.0) * problem.f_al_hz / order
        self._bare_gain = self._family.gain_on_the_line(problem.fixed, order, self._bare_rps)
        amplitude = np.array([member.error.amplitude_arcsec[order] for member in problem.members]) * ARCSEC
        self._bound = 1e-3 * problem.requirements.tip_mm / (problem.lever_m * amplitude * (1.0 - reserve))
        self._before_mm = []
        others = [problem.row(notch.order) for notch in problem.fixed if notch.order in problem.orders]
        for member, known in zip(problem.members, problem.bare_mm, strict=True):
            bare = known.copy()
            if others:
                bare[:, others] = np.minimum(bare[:, others], problem.peaks_mm(member, problem.fixed)[:, others])
            self._before_mm.append(bare)
        self._cases = [(row, case) for row, bare in enumerate(self._before_mm) for case in range(len(bare))]
        self._simulated: dict[tuple[int, int, Notch], Real] = {}

    def checks(self, notch: Notch) -> list[RequirementCheck]:
        """Check the margins at constant speeds, each at its worst.

        Stability is a number of turns of the Nyquist curve, which must be 0.
        """
        wide = widened(notch)
        top = min(wide.end_rps, self.problem.speed_limit_rps)
        edges = [edge for other in self.problem.fixed for edge in (other.start_rps, other.end_rps)]
        inside = [edge for edge in edges if wide.start_rps < edge < top]
        speeds = np.unique(np.concatenate([np.linspace(wide.start_rps, max(top, wide.start_rps), SEARCH_SPEEDS), inside]))
        notches = (notch, *self.problem.fixed)
        found = self._worst(self._family.margins(notches, speeds), [member.label for member in self.problem.members], "")
        if self._arm is not None and all(check.holds for check in found):
            found += self._worst(self._arm.margins(notches, speeds), [case.label for case in self._arm.cases], ON_THE_ARM)
        return found

    def _worst(self, margins: SpeedMargins, names: Sequence[str], where: str) -> list[RequirementCheck]:
        """Check the margins of some plants, each at its worst.

        The limits are tighter than required by the reserve.
        """
        limits, tighter = self.problem.requirements, 1.0 - self._reserve

        def worst(name: str, values: Real, limit: float, unit: str, *, is_ceiling: bool) -> RequirementCheck:
            at = np.unravel_index(int(np.argmax(values) if is_ceiling else np.argmin(values)), values.shape)
            speed, label = float(margins.speeds_rps[at[1]]), names[int(at[0])]
            return RequirementCheck(f"{name}{where}", float(values[at]), limit, unit, is_ceiling, speed, label)

        return [
            worst("turns of the Nyquist curve", np.abs(margins.turns), 0.0, "", is_ceiling=True),
            worst("M_s", margins.sensitivity_peak, 1.0 + tighter * (limits.max_sensitivity - 1.0), "", is_ceiling=True),
            worst("phase margin", margins.phase_margin_deg, limits.phase_margin_deg / tighter, "°", is_ceiling=False),
            worst("gain margin", margins.gain_margin_db, limits.gain_margin_db / tighter, "dB", is_ceiling=False),
        ]

    def _line_ratio(self, notch: Notch) -> float:
        """Ratio of |G_al| on the line to constraint (5), worst plant."""
        speeds = np.linspace(notch.start_rps, notch.end_rps, SEARCH_SPEEDS)
        inside = self._family.gain_on_the_line((notch, *self.problem.fixed), self.order, speeds)
        outside = self._bare_gain[:, (self._bare_rps < notch.start_rps) | (self._bare_rps > notch.end_rps)]
        return float(np.max(np.concatenate([inside, outside], axis=1) / self._bound[:, np.newaxis]))

    def score(self, notch: Notch, members: int | None = None, at_most: float = math.inf) -> float:
        """Score a filter; see `scores`."""
        return self.scores([(notch, at_most)], members)[0]

    def scores(self, notches: Sequence[tuple[Notch, float]], members: int | None = None) -> list[float]:
        """Score filters by their worst tip peak; smaller is better.

        Each has a score above which it is not wanted. What is returned then may be a lower bound: the simulations end as soon as
        the peaks so far give more than that.

        The score is the tip peak with the filter over that without, for the worst of the first `members` plants.

        Above 2 where a filter raises a peak of another order or beside it, and above 10 where it breaks a margin: those are
        ranked by how far they go, the last without a simulation. The limit of the tip in mm has no part in it, constraint (5) a
        small one where it is nearly kept: where none keeps them, the filter that comes closest is wanted all the same.
        """
        bare_mm = self._before_mm[:members]
        before = max(1e-9, *(self.problem.weighted_mm(bare, self.order) for bare in bare_mm))
        tried = [
            _Tried(notch, at_most, [np.zeros_like(bare) for bare in bare_mm], [0.0] * len(bare_mm)) for notch, at_most in notches
        ]
        for each in tried:
            missed = sum(check.violation for check in self.checks(each.notch))
            if missed > 0.0:
                each.score, each.is_done = 10.0 + missed, True
            else:
                each.line = min(max(self._line_ratio(each.notch), 1.0), RISE_BESIDE)
        failed = self._cases[0]
        for row, case in self._cases:
            going = [each for each in tried if not each.is_done]
            if row >= len(bare_mm) or not going:
                continue
            for each, peaks in zip(going, self._peaks_mm(row, case, [each.notch for each in going]), strict=True):
                each.peaks_mm[row][case] = peaks
                if not np.all(np.isfinite(peaks)):
                    each.score, each.is_done = 9.0, True
                    continue
                each.peak_mm = max(each.peak_mm, self.problem.weighted_mm(each.peaks_mm[row], self.order))
                each.excess[row] = sum(rise.excess for rise in rises(self.problem, bare_mm[row], each.peaks_mm[row]))
                each.score = _ranked(each.peak_mm / before * each.line, sum(each.excess))
                if each.score > each.at_most:
                    each.is_done, failed = True, (row, case)
        place = self._cases.index(failed)
        self._cases.insert(min(place, 1), self._cases.pop(place))  # the next filters are likely to fail there as well
        return [each.score for each in tried]

    def _peaks_mm(self, row: int, case: int, notches: Sequence[Notch]) -> list[Real]:
        """Simulate the tip peaks of a plant with some filters in one case."""
        new = [notch for notch in dict.fromkeys(notches) if (row, case, notch) not in self._simulated]
        if new:
            filters = [(notch, *self.problem.fixed) for notch in new]
            for notch, peaks in zip(new, self.problem.case_peaks_mm(self.problem.members[row], filters, case), strict=True):
                self._simulated[row, case, notch] = peaks
        return [self._simulated[row, case, notch] for notch in notches]


@dataclass
class _Tried:
    """A filter, and what the simulations have shown of it so far.

    Attributes:
        peaks_mm: Tip peaks of each plant.
        excess: How far the filter raises others, by plant.
        line: Factor of the score by constraint (5).
    """

    notch: Notch
    at_most: float
    peaks_mm: list[Real]
    excess: list[float]
    line: float = 1.0
    peak_mm: float = 0.0
    score: float = 0.0
    is_done: bool = False


def _ranked(ratio: float, excess: float) -> float:
    """Score of a ratio of tip peaks, and of what is raised elsewhere; it grows with both."""
    return min(ratio, WORST_RATIO) if excess == 0.0 else WORST_RATIO + min(0.2 * ratio + excess, 6.9)


@dataclass(frozen=True)
class PeakRow:
    """Predicted peaks of the tip on the ramp.

    Attributes:
        rising_mm: Tip peak of the nominal plant while the speed rises, as in a constant-acceleration run.
        falling_mm: Tip peak of the nominal plant while the speed falls.
        worst_mm: The larger of both for the worst of all plants.
        other_mm: Largest peak of the nominal plant, up or down, on each of the slower and faster ramps, by their rate in rev/s².
    """

    order: float
    rising_mm: float
    falling_mm: float
    worst_mm: float
    worst_member: str
    other_mm: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class PostureRow:
    """Worst margins on the arm in one posture, over all motor speeds.

    Attributes:
        label: The posture, and what the other axes do.
        speed_rps: Motor speed at which it is.
        gain_margin_db: Least gain margin; inf where the phase never crosses −180°.
    """

    label: str
    sensitivity_peak: float
    speed_rps: float
    phase_margin_deg: float
    gain_margin_db: float


@dataclass(frozen=True)
class NotchVerdict:
    """Close check of filters, closed-loop poles included.

    It covers every f_al/120, in rev/s, from rest to the speed limit.

    Attributes:
        checks: Every requirement at its worst.
        margins: Margins of the nominal plant, by speed.
        postures: Margins on the arm, by posture; empty for an axis by itself.
    """

    notches: tuple[Notch, ...]
    checks: tuple[RequirementCheck, ...]
    margins: Mapping[float, Margins]
    peaks: tuple[PeakRow, ...]
    postures: tuple[PostureRow, ...] = ()

    @property
    def holds(self) -> bool:
        """True if all requirements are met."""
        return all(check.holds for check in self.checks)

    @property
    def is_harmless(self) -> bool:
        """True if the filters keep all margins and raise no peak."""
        return all(check.holds or check.is_tip_limit for check in self.checks)

    def worst(self, name: str) -> float:
        """Worst M_s, phase margin or gain margin, by its name."""
        found = [check for check in self.checks if check.name in (name, f"{name}{ON_THE_ARM}")]
        return (max if found[0].is_ceiling else min)(check.value for check in found)

    @property
    def missed(self) -> tuple[RequirementCheck, ...]:
        """Checks that are not met, the worst first."""
        return tuple(sorted((check for check in self.checks if not check.holds), key=lambda check: -check.violation))

    def peak(self, order: float) -> PeakRow:
        """Tip peaks of one order."""
        return next(row for row in self.peaks if row.order == order)


def verdict(problem: NotchProblem, notches: Sequence[Notch], orders: Sequence[float]) -> NotchVerdict:
    """Judge filters by all requirements, for every plant, at every speed.

    Args:
        problem: The axis; its `fixed` filters count only where they are among `notches`.
        notches: All filters that act.
        orders: Orders for which constraint (5) and the tip peak are checked.
    """
    wide = [widened(notch) for notch in notches]
    limit = problem.speed_limit_rps
    edges = [edge for notch in wide for edge in (notch.start_rps, notch.end_rps) if edge <= limit]
    grid = np.arange(0.0, limit, problem.f_al_hz / VERDICT_STEPS)
    speeds = np.unique(np.round(np.concatenate([grid, edges, [limit]]), 9))
    margins_by_plant = _margins(problem, wide, speeds)
    by_member = problem.bare_mm if not notches else [problem.peaks_mm(member, notches) for member in problem.members]
    peaks = {member.label: mm for member, mm in zip(problem.members, by_member, strict=True)}
    rows = tuple(_peak_row(problem, peaks, order) for order in orders)
    arm_checks, postures = _on_the_arm(problem, notches, speeds)
    checks = [
        *_margin_checks(problem.requirements, margins_by_plant),
        *arm_checks,
        *(_rise_checks(problem, peaks) if notches else ()),
        *(_line_check(problem, notches, order) for order in orders),
    ]
    for row in rows:
        name = f"tip peak on the ramp, k = {row.order:g},"
        tip_mm = problem.requirements.tip_mm
        checks.append(RequirementCheck(name, row.worst_mm, tip_mm, "mm", True, None, row.worst_member, is_tip_limit=True))
    return NotchVerdict(tuple(notches), tuple(checks), margins_by_plant[problem.members[0].label], rows, postures)


def _margins(problem: NotchProblem, wide: Sequence[Notch], speeds: Real) -> dict[str, dict[float, Margins]]:
    """Compute margins by plant and speed."""
    loops = [problem.loop(member, wide) for member in problem.members]
    scanned = LoopFamily(loops, step=VERDICT_FREQUENCY_STEP).margins(wide, speeds)
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


def _on_the_arm(
    problem: NotchProblem, notches: Sequence[Notch], speeds: Real
) -> tuple[list[RequirementCheck], tuple[PostureRow, ...]]:
    """Check margins and closed-loop poles on the arm, in every posture.

    The poles are those of all axes together. An axis by itself has no such checks.
    """
    if problem.arm is None:
        return [], ()
    notches = [notch for notch in notches if notch.mode != NOTCH_OFF]
    family = problem.arm.family(ARM_STEP, with_filtered=True)
    found, limits = family.margins(notches, speeds), problem.requirements
    radius, speed, label = family.worst_pole(notches, problem.speed_limit_rps)
    turns, m_s = np.abs(found.turns), found.sensitivity_peak
    frozen = zip(family.cases, m_s, found.phase_margin_deg, found.gain_margin_db, strict=True)
    return [
        RequirementCheck(f"pole radius{ON_THE_ARM}", radius, 1.0, "", True, speed, label),
        _arm_check(family, speeds, "turns of the Nyquist curve", turns, 0.0, "", is_ceiling=True),
        _arm_check(family, speeds, "M_s", m_s, limits.max_sensitivity, "", is_ceiling=True),
        _arm_check(family, speeds, "phase margin", found.phase_margin_deg, limits.phase_margin_deg, "°", is_ceiling=False),
        _arm_check(family, speeds, "gain margin", found.gain_margin_db, limits.gain_margin_db, "dB", is_ceiling=False),
    ], tuple(
        PostureRow(case.label, float(np.max(peak)), float(speeds[np.argmax(peak)]), float(np.min(phase)), float(np.min(gain)))
        for case, peak, phase, gain in frozen
    )


def _arm_check(
    family: ArmFamily, speeds: Real, name: str, values: Real, limit: float, unit: str, *, is_ceiling: bool
) -> RequirementCheck:
    """Check one margin on the arm at its worst.

    The posture takes the place of the plant; `values` have the shape (cases, speeds).
    """
    at = np.unravel_index(int(np.argmax(values) if is_ceiling else np.argmin(values)), values.shape)
    label = family.cases[int(at[0])].label
    return RequirementCheck(f"{name}{ON_THE_ARM}", float(values[at]), limit, unit, is_ceiling, float(speeds[at[1]]), label)


def _rise_checks(problem: NotchProblem, peaks_mm: Mapping[str, Real]) -> list[RequirementCheck]:
    """Check how far filters raise the tip peaks."""
    worst: dict[float | None, tuple[Rise, str]] = {}
    for member, bare in zip(problem.members, problem.bare_mm, strict=True):
        for rise in rises(problem, bare, peaks_mm[member.label]):
            if rise.order not in worst or rise.ratio > worst[rise.order][0].ratio:
                worst[rise.order] = rise, member.label
    found = []
    for order, (rise, label) in worst.items():
        where = "between the orders' speeds" if order is None else f"of k = {order:g}"
        name = f"tip peak {where} relative to that without a filter"
        found.append(RequirementCheck(name, rise.ratio, rise.limit, "", True, None, label, is_rise=True))
    return found


def _line_check(problem: NotchProblem, notches: Sequence[Notch], order: float) -> RequirementCheck:
    """Check constraint (5) on the line.

    If a switched filter may be in or out, both states count.
    """
    family = LoopFamily([problem.loop(member) for member in problem.members])
    step = problem.f_al_hz / BARE_STEPS
    speeds = np.arange(step, problem.speed_limit_rps + 1e-9, step)
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
    name = f"|G_al| on the line over constraint (5), k = {order:g},"
    label = problem.members[int(p)].label
    return RequirementCheck(name, float(ratio[p, s]), 1.0, "", True, float(speeds[s]), label, is_tip_limit=True)


def _peak_row(problem: NotchProblem, peaks_mm: Mapping[str, Real], order: float) -> PeakRow:
    row = problem.row(order)
    own = {label: float(np.max(peaks[0, row])) for label, peaks in peaks_mm.items()}
    nominal = peaks_mm[problem.members[0].label][:, row]
    worst = max(own, key=lambda label: own[label])
    others = zip(problem.ramps[1:], nominal[1 : len(problem.ramps)], strict=True)
    return PeakRow(
        order, float(nominal[0, 0]), float(nominal[0, 1]), own[worst], worst,
        tuple((ramp.rate_rps_s, float(np.max(peaks))) for ramp, peaks in others),
    )  # fmt: skip
