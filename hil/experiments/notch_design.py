"""Design of notch filters for `hil design notch`."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet
from drive_profiles.realisation import NotchTarget, realise
from hil.bench.bench import AxisTable, Bench
from hil.bench.design import DesignedAxis, notch_table
from hil.bench.model import Identified, IdentifiedAxis, with_identified
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from hil.design.frequency import Loop
from hil.design.notch_design import WORST_RATIO, NotchVerdict, RequirementCheck
from hil.design.notch_problem import WORSE_FRACTION, NotchProblem
from hil.design.notch_search import SearchResult, pooled_verdict, search, workers
from hil.errors import HilError, NotPossibleError
from hil.experiments.arm_loops import arm_loops
from hil.experiments.notch_problem import NotchDesignRequest, problem_of, unreached_words
from hil.reporter import SILENT, Reporter
from hil.results.notch_design import (
    ArmMargins,
    DesignCheck,
    DesignPlant,
    DesignVerdict,
    NotchDesignResult,
    SpeedMarginsEntry,
    TipPeak,
)


class InfeasibleError(HilError):
    """No filter meets all requirements."""

    exit_code: ClassVar[int] = 9

    def __init__(self, axis: int, what: str, missed: Sequence[RequirementCheck]) -> None:
        self.axis, self.what, self.missed = axis, what, tuple(missed)
        super().__init__(f"axis {axis}: {what}{': ' if self.missed else ''}{'; '.join(map(str, self.missed))}")


@dataclass(frozen=True)
class NotchDesignOutcome:
    """End of a notch design.

    Attributes:
        none: Verdict without filters.
        given: Verdict on the bench file's filters; None without them.
        designed: Verdict on the best filters, or those that miss least; None if only the given ones were judged.
        failure: Error if no filter meets the requirements, else None.
        seconds: Duration of the design.
        emulated: Parts of the model file that were identified on an emulated robot, of `plant` and `ate`.
        notes: Orders that were asked for and got no filter, with the reason; for which postures of an arm the margins hold.
    """

    bench: Bench
    source: str
    request: NotchDesignRequest
    problem: NotchProblem
    f_al_hz: float
    none: NotchVerdict
    given: NotchVerdict | None
    designed: NotchVerdict | None
    failure: InfeasibleError | None
    seconds: float
    emulated: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def is_usable(self) -> bool:
        """True if the best filters keep all margins and raise no peak.

        They may miss a limit of the tip in mm.
        """
        return bool(self.best.notches) and self.best.is_harmless

    @property
    def orders(self) -> tuple[int, ...]:
        """Orders of the request that the axis reaches."""
        return tuple(order for order in self.request.orders if order in self.problem.orders)

    @property
    def table(self) -> AxisTable:
        """Table of the axis in the bench file."""
        return self.bench.axis[self.request.axis]

    @property
    def best(self) -> NotchVerdict:
        """Verdict of the report."""
        verdict = self.designed or self.given
        assert verdict is not None  # noqa: S101 - one of them was requested
        return verdict

    def loop(self, notches: Sequence[Notch] = ()) -> Loop:
        """Loop around the nominal plant."""
        return self.problem.loop(self.problem.members[0], notches)


def design(
    bench: Bench,
    request: NotchDesignRequest,
    identified: Identified | None = None,
    reporter: Reporter = SILENT,
) -> NotchDesignOutcome:
    """Design the filters of one axis.

    Args:
        request: Axis, orders, shapes and requirements.
        identified: A model file, which takes precedence over the bench file's model.

    Raises:
        NotPossibleError: The bench lacks something that a design needs.
        ValueError: A value of the request is outside its range.
    """
    began = time.monotonic()
    source = "bench file"
    axis_model, emulated = IdentifiedAxis(), tuple[str, ...]()
    if identified is not None:
        axis_model = identified.axis.get(request.axis, axis_model)
        parts = [name for name in ("plant", "ate") if getattr(axis_model, name) is not None]
        source = (
            f"model file ({', '.join(parts)}), the rest: bench file" if parts else "bench file; the model file lacks the axis"
        )
        emulated = tuple(name for name in parts if getattr(axis_model, name).emulated)
        if emulated:
            source += f"; {' and '.join(emulated)} identified on an emulated robot"
        bench = with_identified(bench, identified)
    problem, f_al = problem_of(bench, request, axis_model)
    orders = tuple(order for order in request.orders if order in problem.orders)
    beyond = [order for order in request.orders if order not in orders]
    notes = [unreached_words(request.axis, beyond, f_al, problem.speed_limit_rps)] if beyond else []
    on_arm = arm_loops(bench, request.axis, problem.loop(problem.members[0]), problem.members, identified)
    problem, notes = replace(problem, arm=on_arm.loops), [*notes, *on_arm.notes]
    given = tuple(one.notch() for one in bench.axis[request.axis].notch)
    designed: NotchVerdict | None = None
    failure: InfeasibleError | None = None
    with workers(request.jobs) as pool:
        none = pooled_verdict(problem, (), orders, pool)
        given_verdict = pooled_verdict(problem, given, orders, pool) if given else None
        if request.is_given:
            if given_verdict is None:
                raise NotPossibleError(f"axis {request.axis}: the bench file has no notch for it")
            if not given_verdict.holds:
                failure = InfeasibleError(request.axis, "the given filters do not meet every requirement", given_verdict.missed)
        elif bare := _bare_failure(request.axis, none):
            failure, designed = bare, none
        else:
            made = _Series(problem, request, orders, none, pool, reporter).run(given)
            designed, failure = made.best, made.failure
            notes += made.notes
    seconds = time.monotonic() - began
    return NotchDesignOutcome(
        bench, source, request, problem, f_al, none, given_verdict, designed, failure, seconds, emulated, tuple(notes)
    )


def _bare_failure(axis: int, none: NotchVerdict) -> InfeasibleError | None:
    """Error if margins are missed without any filter, else None.

    No filter can mend margins at speeds at which it does not act.
    """
    missed = [check for check in none.missed if not check.is_tip_limit]
    if not missed:
        return None
    return InfeasibleError(axis, "the gains violate the requirements even without a filter", missed)


@dataclass
class _Series:
    """Search of filters for several orders, one after the other."""

    problem: NotchProblem
    request: NotchDesignRequest
    orders: tuple[int, ...]
    none: NotchVerdict
    pool: Any
    reporter: Reporter
    best: NotchVerdict | None = None
    failure: InfeasibleError | None = None
    notes: list[str] = field(default_factory=list)

    def run(self, given: Sequence[Notch]) -> "_Series":
        """Search the filters of all orders."""
        axis = self.request.axis
        fixed = tuple(notch for notch in given if notch.order not in self.orders and notch.mode != NOTCH_OFF)
        if (count := len(fixed) + len(self.orders)) > NOTCHES:
            raise NotPossibleError(f"axis {axis}: {count} filters, with those of other orders; an axis holds at most {NOTCHES}")
        found: NotchVerdict | None = None
        for number, order in enumerate(self.orders):
            result = self._search(number, order, fixed, [notch for notch in given if notch.order == order])
            reason = self._reason_against(order, result)
            if reason is None:
                fixed, found = result.best.notches, result.best
            else:
                self.failure = self.failure or reason
                self.notes.append(str(reason))
        if found is None:
            return self
        self.failure = None
        is_judged = len(self.orders) == len(fixed) == 1  # by the search, for the same order
        self.best = found if is_judged else pooled_verdict(self.problem, fixed, self.orders, self.pool)
        if not self.best.holds:
            what = "the filters together do not meet every requirement"
            if self.best.is_harmless:
                what = "the best filters within all margins do not meet the limits of the tip"
            self.failure = InfeasibleError(axis, what, self.best.missed)
        return self

    def _search(self, number: int, order: int, fixed: Sequence[Notch], own: Sequence[Notch]) -> SearchResult:
        def progress(fraction: float) -> None:
            self.reporter.progress((number + fraction) / len(self.orders))

        acting = [notch for notch in own if notch.mode != NOTCH_OFF]
        problem = replace(self.problem, fixed=tuple(fixed)) if fixed else self.problem
        return search(
            problem, order, self.request.shapes, problem.f_al_hz, effort=self.request.effort, pool=self.pool, given=acting,
            template=acting[0] if acting else None, progress=progress,
        )  # fmt: skip

    def _reason_against(self, order: int, result: SearchResult) -> InfeasibleError | None:
        """Reason why an order gets no filter, or None."""
        shapes = " or ".join(self.request.shapes)
        margins = [check for check in result.best.missed if not check.is_tip_limit and not check.is_rise]
        if margins:
            self.best = result.best
            what = f"no {shapes} filter of order {order} meets every requirement; the best one violates"
            return InfeasibleError(self.request.axis, what, result.best.missed)
        if result.best.is_harmless and result.ratio < 1.0 - WORSE_FRACTION:
            return None
        self.best = self.best or self.none
        what = f"no filter of order {order} is an improvement"
        if result.ratio < WORST_RATIO:
            what += f": the closest leaves {100.0 * result.ratio:.0f} % of its tip peak"
        raised = [check for check in result.best.missed if check.is_rise]
        if raised:
            what = f"no filter of order {order} is an improvement: the closest raises a peak"
        return InfeasibleError(self.request.axis, what, raised)


# -- files ----------------------------------------------------------------------------------------------------------


def parameter_set(bench: Bench, axis: int, verdict: NotchVerdict, f_al_hz: float) -> ParameterSet:
    """Convert filters to a parameter set for `drive-profiles upload`.

    Raises:
        NotPossibleError: The drive family has no variable notch.
        DriveProfileError: Its notch does not hold these values.
    """
    table = bench.axis[axis]
    profile = Profile.load(table.profile)
    check_drive(bench, axis)
    items: dict[str, Item] = {}
    for column in range(NOTCHES):
        name = f"notch_{column + 1}"
        if column >= len(verdict.notches):
            items[f"{name}.mode"] = Item(value=NOTCH_OFF)
            continue
        notch = verdict.notches[column]
        target = NotchTarget.at_speed(notch.order, f_al_hz / notch.order, notch.offset_hz, notch.zeta_rn, notch.zeta_rdth)
        realise(profile, target, section=column)
        values = {**vars(notch)}
        mode = values.pop("mode")  # last: until then the filter is the one before, or off
        for key, value in {**values, "mode": mode}.items():
            items[f"{name}.{key}"] = Item(value=value, unit=profile.parameter(f"{name}.{key}").unit)
    header = Header(
        profile=profile.label,
        node_id=table.node_id,
        vendor_id=profile.identity.vendor_id,
        serial_number=table.serial_number,
        title=f"axis {axis} of {bench.name}: {summary(verdict)}",
    )
    made = ParameterSet(header=header, tuning=items)
    made.writes(Catalogue(profile))
    return made


def check_drive(bench: Bench, axis: int) -> None:
    """Refuse a drive family whose notch does not follow the speed.

    Raises:
        NotPossibleError: The family has no such notch; the message names its filter.
    """
    profile = Profile.load(bench.axis[axis].profile)
    names = [f"notch_{column + 1}.{name}" for column in range(NOTCHES) for name in vars(Notch())]
    missing = [name for name in names if name not in profile.parameters]
    if profile.notch is None or profile.notch.form != "variable" or missing:
        has = "no filter" if profile.notch is None else f"a filter of the form {profile.notch.form!r}"
        raise NotPossibleError(
            f"axis {axis}: drive family {profile.label} has {has}, but no notch that follows the speed, so there is no "
            f"parameter set; drive-profiles realise shows the result at one speed"
        )


def summary(verdict: NotchVerdict) -> str:
    """Margins and predicted peaks of the filters in one line."""
    peaks = ", ".join(f"k = {row.order:g}: {row.rising_mm:.4f} mm, worst plant {row.worst_mm:.4f} mm" for row in verdict.peaks)
    return (
        f"M_s {verdict.worst('M_s'):.2f}, phase margin {verdict.worst('phase margin'):.1f}°, gain margin "
        f"{verdict.worst('gain margin'):.1f} dB at every speed and plant; predicted tip peak {peaks}"
    )


def designed_axis(outcome: NotchDesignOutcome) -> DesignedAxis:
    """Filters as an entry of the design file."""
    best = outcome.best
    return DesignedAxis(
        notch=tuple(notch_table(notch) for notch in best.notches),
        tip_peak_mm={f"{row.order:g}": row.rising_mm for row in best.peaks},
        worst_tip_peak_mm={f"{row.order:g}": row.worst_mm for row in best.peaks},
        sensitivity_peak=best.worst("M_s"),
        phase_margin_deg=best.worst("phase margin"),
        gain_margin_db=min(best.worst("gain margin"), 200.0),
        period_s=outcome.problem.period_s,
        delay_samples=outcome.problem.delay_samples,
        note=outcome.source,
    )


def result_of(outcome: NotchDesignOutcome) -> NotchDesignResult:
    """Result of a design for `design.json`; None for what has no bound."""
    problem = outcome.problem
    return NotchDesignResult(
        bench=outcome.bench.name,
        axis=outcome.request.axis,
        orders=outcome.request.orders,
        plant_from=outcome.source,
        period_s=problem.period_s,
        delay_samples=problem.delay_samples,
        speed_limit_rps=problem.speed_limit_rps,
        f_al_hz=outcome.f_al_hz,
        requirements=problem.requirements,
        plants=tuple(DesignPlant(label=member.label, **asdict(member.plant)) for member in problem.members),
        feasible=outcome.failure is None,
        reason=None if outcome.failure is None else str(outcome.failure),
        usable=outcome.is_usable,
        none=_verdict(outcome.none),
        given=None if outcome.given is None else _verdict(outcome.given),
        designed=None if outcome.designed is None else _verdict(outcome.designed),
        effort=outcome.request.effort,
        seconds=round(outcome.seconds, 2),
        emulated=True if outcome.emulated else None,
        notes=outcome.notes,
    )


def _verdict(verdict: NotchVerdict) -> DesignVerdict:
    return DesignVerdict(
        notch=tuple(notch_table(notch) for notch in verdict.notches),
        holds=verdict.holds,
        checks=tuple(DesignCheck(**asdict(check), holds=check.holds) for check in verdict.checks),
        tip_peaks=tuple(TipPeak(**asdict(row)) for row in verdict.peaks),
        margins=tuple(SpeedMarginsEntry(speed_rps=speed, **asdict(one)) for speed, one in verdict.margins.items()),
        postures=tuple(ArmMargins(**asdict(row)) for row in verdict.postures),
    )
