"""`hil design notch`: filters from a bench file and an identified model, and the parameter set of a drive."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet
from drive_profiles.realisation import NotchTarget, realise
from hil.analysis import TipScale, tip_displacement_mm
from hil.bench.bench import AxisTable, Bench
from hil.bench.design import DesignedAxis, notch_table
from hil.bench.model import Identified, IdentifiedAxis, with_identified
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from hil.control.trajectory import ConstantAcceleration, sample_times
from hil.design.frequency import CONTROL_PERIOD_S, Loop
from hil.design.notch_design import NotchProblem, NotchVerdict, RequirementCheck, Requirements
from hil.design.notch_search import Effort, pooled_verdict, search, workers
from hil.design.ramp import RampMotion
from hil.design.transmission_error import TransmissionError
from hil.design.uncertainty import around
from hil.errors import HilError, NotPossibleError
from hil.experiments.judge import scale_at
from hil.reporter import SILENT, Reporter
from hil.results.notch_design import DesignCheck, DesignPlant, DesignVerdict, NotchDesignResult, SpeedMarginsEntry, TipPeak
from hil.robot_tables import amplitude_key

SETTLE_RPS = 1.0
"""Reach of the ramp down below the lowest judged speed, so that the band-pass can settle, rev/s."""


class InfeasibleError(HilError):
    """No filter meets all requirements."""

    exit_code: ClassVar[int] = 9

    def __init__(self, axis: int, what: str, missed: Sequence[RequirementCheck]) -> None:
        """Keep the axis, the sentence on the search, and the checks that the closest filter misses."""
        self.axis, self.what, self.missed = axis, what, tuple(missed)
        super().__init__(f"axis {axis}: {what}: {'; '.join(map(str, missed))}")


@dataclass(frozen=True)
class TipDisplacement:
    """Tip displacement of a simulated run, by the metric of measured ones (`hil.analysis`).

    Attributes:
        lever_m: Distance from the arm's axis to the tip.
        scale: Scale of the axis.
    """

    lever_m: float
    scale: TipScale

    def __call__(self, motion: RampMotion, low_rps: float, high_rps: float) -> tuple[float, float]:
        """Largest tip displacement in mm between two speeds, while the speed rises and while it falls."""
        displacement = np.abs(tip_displacement_mm(self.lever_m * motion.arm_acceleration_rad_s2, motion.period_s, self.scale))
        speed = np.abs(motion.motor_speed_rps)
        inside = (speed >= low_rps) & (speed <= high_rps)
        rising = np.arange(len(speed)) < int(np.argmax(speed))
        peaks = [float(np.max(displacement[inside & part], initial=0.0)) for part in (rising, ~rising)]
        return peaks[0], peaks[1]


@dataclass(frozen=True)
class NotchDesignRequest:
    """Request of a notch design.

    Attributes:
        axis: Axis number.
        orders: Orders k, in the order in which their filters are designed.
        shapes: Shapes that are tried.
        requirements: Margins and tip peak; None for the defaults with the bench file's specification.
        uncertainty_percent: Uncertainty of K_g and J_l; None for the model file's standard errors, or 5 %.
        period_s: Sampling time of the loop; None for the drive family's, or 250 µs.
        delay_samples: Whole samples between measurement and torque.
        effort: Evaluations and seed of the search.
        jobs: Number of processes; 0 for this one alone.
        is_given: True to judge the bench file's own filters only.
    """

    axis: int
    orders: tuple[int, ...] = (2,)
    shapes: tuple[str, ...] = ("switched", "trapezoid")
    requirements: Requirements | None = None
    uncertainty_percent: float | None = None
    period_s: float | None = None
    delay_samples: int = 0
    effort: Effort = field(default_factory=Effort)
    jobs: int = 0
    is_given: bool = False


@dataclass(frozen=True)
class NotchDesignOutcome:
    """End of a notch design.

    Attributes:
        bench: Bench file as it was used, with the identified model.
        source: Source of the plant, in words.
        request: Request of the design.
        problem: NotchProblem that was solved.
        f_al_hz: Peak of |G_al| of the believed plant without a filter.
        none: NotchVerdict without filters.
        given: NotchVerdict on the bench file's filters; None without them.
        designed: NotchVerdict on the best filters, or those that miss least; None where only the given ones were judged.
        failure: Error where no filter meets the requirements; None where one does.
        seconds: Duration of the design.
        emulated: Parts of the model file that were identified on an emulated robot, of `plant` and `ate`.
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

    @property
    def table(self) -> AxisTable:
        """Table of the axis in the bench file."""
        return self.bench.axis[self.request.axis]

    @property
    def best(self) -> NotchVerdict:
        """NotchVerdict of the report: on the designed filters, else on the given ones."""
        verdict = self.designed or self.given
        assert verdict is not None  # noqa: S101 - one of them was requested
        return verdict

    def loop(self, notches: Sequence[Notch] = ()) -> Loop:
        """Loop around the believed plant."""
        return self.problem.loop(self.problem.members[0], notches)


def design(
    bench: Bench,
    request: NotchDesignRequest,
    identified: Identified | None = None,
    reporter: Reporter = SILENT,
) -> NotchDesignOutcome:
    """Design the filters of one axis; where none meets all requirements, the outcome names those that the closest misses.

    Args:
        bench: The bench file.
        request: Axis, orders, shapes and requirements.
        identified: A model file, which takes precedence over the bench file's model.
        reporter: Listener of the progress.

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
    table = bench.axis[request.axis]
    given = tuple(one.notch() for one in table.notch)
    with workers(request.jobs) as pool:
        none = pooled_verdict(problem, (), request.orders, pool)
        given_verdict = pooled_verdict(problem, given, request.orders, pool) if given else None
        designed: NotchVerdict | None = None
        failure: InfeasibleError | None = None
        if request.is_given:
            if given_verdict is None:
                raise NotPossibleError(f"axis {request.axis}: the bench file gives it no notch")
            if not given_verdict.holds:
                failure = InfeasibleError(request.axis, "the given filters miss what is asked", given_verdict.missed)
        elif bare := _bare_failure(request.axis, none):
            failure, designed = bare, none
        else:
            designed, failure = _searched(problem, request, f_al, given, pool, reporter)
    seconds = time.monotonic() - began
    return NotchDesignOutcome(bench, source, request, problem, f_al, none, given_verdict, designed, failure, seconds, emulated)


def _bare_failure(axis: int, none: NotchVerdict) -> InfeasibleError | None:
    """Error where margins are missed without any filter: no filter can mend them at speeds where it does not act."""
    missed = [check for check in none.missed if check.name in {"pole radius", "M_s", "phase margin", "gain margin"}]
    if not missed:
        return None
    return InfeasibleError(axis, "these gains miss what is asked already without a filter", missed)


def _searched(
    problem: NotchProblem,
    request: NotchDesignRequest,
    f_al_hz: float,
    given: Sequence[Notch],
    pool: Any,
    reporter: Reporter,
) -> tuple[NotchVerdict, InfeasibleError | None]:
    """Search one filter after the other; filters of other orders stay as they are given."""
    fixed = tuple(notch for notch in given if notch.order not in request.orders)
    if len(fixed) + len(request.orders) > NOTCHES:
        raise NotPossibleError(f"axis {request.axis}: {len(fixed)} filters of other orders leave no room; an axis has {NOTCHES}")
    best: NotchVerdict | None = None
    for number, order in enumerate(request.orders):
        own = [notch for notch in given if notch.order == order and notch.mode != NOTCH_OFF]
        present = replace(problem, fixed=fixed)

        def progress(fraction: float, number: int = number) -> None:
            reporter.progress((number + fraction) / len(request.orders))

        result = search(
            present, order, request.shapes, f_al_hz, effort=request.effort, pool=pool, given=own,
            template=own[0] if own else None, progress=progress,
        )  # fmt: skip
        best = result.best
        if not best.holds:
            shapes = " or ".join(request.shapes)
            what = f"no {shapes} filter of order {order} keeps all that is asked; the closest misses"
            return best, InfeasibleError(request.axis, what, best.missed)
        fixed = best.notches
    assert best is not None  # noqa: S101 - there is at least one order
    whole = pooled_verdict(problem, best.notches, request.orders, pool)
    if whole.holds:
        return whole, None
    return whole, InfeasibleError(request.axis, "the filters together miss what is asked", whole.missed)


def problem_of(bench: Bench, request: NotchDesignRequest, axis_model: IdentifiedAxis | None = None) -> tuple[NotchProblem, float]:
    """NotchProblem of a request, and f_al in Hz.

    Raises:
        NotPossibleError: The bench lacks the axis, its model, its transmission error, or a ramp.
    """
    number = request.axis
    if number not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {number}; it has {', '.join(map(str, bench.axis))}")
    table = bench.axis[number]
    plant = table.plant()
    if plant is None or table.model is None:
        raise NotPossibleError(f"axis {number} has no model: give one in the bench file, or by hil identify and --model")
    if bench.constant_acceleration is None:
        raise NotPossibleError(f"bench {bench.name!r} has no constant_acceleration table: a filter is judged on its ramp")
    period = request.period_s or _period_s(table)
    cascade = table.gains(f"a filter of axis {number}").cascade()
    bare = Loop(plant, cascade, (), period, request.delay_samples)
    f_al = bare.peak_hz()
    scale = scale_at(bench, number, f_al)
    if unjudged := [order for order in request.orders if order not in scale.windows_rps]:
        own = " and ".join(map(str, sorted(scale.windows_rps)))
        raise NotPossibleError(f"filters of order {unjudged[0]} are not judged; of order {own} they are")
    for order in request.orders:
        if not table.model.ate.amplitudes_arcsec().get(order, 0.0) > 0.0:
            raise NotPossibleError(f"axis {number}: the transmission error of order {order} is not known: hil identify ate")
    ate, nothing = table.model.ate, dict[float, float]()
    nothing |= dict.fromkeys(scale.windows_rps, 0.0)  # an order may have a window, and no amplitude
    error = TransmissionError({**nothing, **ate.amplitudes_arcsec()}, {**nothing, **ate.phases_deg()})
    top_rps = min(bench.constant_acceleration.end_rps, table.limits.speed_rps)
    for order in request.orders:
        if top_rps < f_al / order:
            raise NotPossibleError(
                f"axis {number}: order {order} meets f_al = {f_al:.2f} Hz at {f_al / order:.2f} rev/s, beyond the ramp's end at "
                f"{top_rps:g} rev/s: raise end_rps of constant_acceleration, or the speed limit"
            )
    errors, amplitudes = _standard_errors(axis_model)
    members = around(plant, error, percent=request.uncertainty_percent, standard_error=errors, amplitude_error_arcsec=amplitudes)
    problem = NotchProblem(
        members=members,
        cascade=cascade,
        period_s=period,
        delay_samples=request.delay_samples,
        lever_m=table.tip_lever_m,
        speed_limit_rps=table.limits.speed_rps,
        reference_rad=_reference(bench, request, period, scale),
        windows_rps={
            order: scale.windows_rps[order]
            for order in sorted({*request.orders, *(n.order for n in table.notch)})
            if order in scale.windows_rps
        },
        tip_peak=TipDisplacement(table.tip_lever_m, scale),
        requirements=request.requirements or Requirements(tip_mm=bench.specification.tip_mm),
    )
    return problem, f_al


def _period_s(table: AxisTable) -> float:
    """Period of the loop inside the drive, from its drive profile."""
    loop = Profile.load(table.profile).loop
    return CONTROL_PERIOD_S if loop is None or loop.period_s is None else loop.period_s


def _standard_errors(axis_model: IdentifiedAxis | None) -> tuple[Mapping[str, float], Mapping[float, float]]:
    errors: dict[str, float] = {}
    amplitudes: dict[float, float] = {}
    if axis_model is not None and axis_model.plant is not None:
        errors = dict(axis_model.plant.standard_error)
    if axis_model is not None and axis_model.ate is not None:
        known = axis_model.ate.values.amplitudes_arcsec()
        amplitudes = {order: axis_model.ate.standard_error.get(amplitude_key(order), 0.0) for order in known}
    return errors, amplitudes


def _reference(bench: Bench, request: NotchDesignRequest, period_s: float, scale: TipScale) -> Any:
    """θ_ref of the bench file's ramp, up at its rate and down at the same, until the lowest judged speed is well behind."""
    table = bench.constant_acceleration
    assert table is not None  # noqa: S101 - the caller has looked
    rate, top = table.acceleration_rps_s, min(table.end_rps, bench.axis[request.axis].limits.speed_rps)
    ramp = ConstantAcceleration(rate, top, rate, dwell_s=0.1, tail_s=0.0)
    lowest = min(scale.windows_rps[order][0] for order in request.orders)
    down = (top - max(0.0, lowest - SETTLE_RPS)) / rate
    return ramp.motor_angle(sample_times(0.1 + top / rate + down, period_s))


# -- files ----------------------------------------------------------------------------------------------------------


def parameter_set(bench: Bench, axis: int, verdict: NotchVerdict, f_al_hz: float) -> ParameterSet:
    """Filters as a parameter set for `drive-profiles upload`; the drive's other filters are switched off.

    Args:
        bench: The bench file.
        axis: Axis number.
        verdict: NotchVerdict on the filters.
        f_al_hz: Peak of |G_al| without a filter.

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
            f"axis {axis}: drive family {profile.label} has {has}, no notch that follows the speed: no parameter set can be made "
            "of this design; drive-profiles realise shows what it makes of one speed"
        )


def summary(verdict: NotchVerdict) -> str:
    """Margins and predicted peaks of the filters in one line."""
    worst = {check.name: check for check in verdict.checks}
    peaks = ", ".join(f"k = {row.order}: {row.rising_mm:.4f} mm, worst plant {row.worst_mm:.4f} mm" for row in verdict.peaks)
    return (
        f"M_s {worst['M_s'].value:.2f}, phase margin {worst['phase margin'].value:.1f}°, gain margin "
        f"{worst['gain margin'].value:.1f} dB at every speed and plant; predicted tip peak {peaks}"
    )


def designed_axis(outcome: NotchDesignOutcome) -> DesignedAxis:
    """Filters as an entry of the design file."""
    best, worst = outcome.best, {check.name: check for check in outcome.best.checks}
    return DesignedAxis(
        notch=tuple(notch_table(notch) for notch in best.notches),
        tip_peak_mm={str(row.order): row.rising_mm for row in best.peaks},
        worst_tip_peak_mm={str(row.order): row.worst_mm for row in best.peaks},
        sensitivity_peak=worst["M_s"].value,
        phase_margin_deg=worst["phase margin"].value,
        gain_margin_db=min(worst["gain margin"].value, 200.0),
        period_s=outcome.problem.period_s,
        delay_samples=outcome.problem.delay_samples,
        note=outcome.source,
    )


def result_of(outcome: NotchDesignOutcome) -> NotchDesignResult:
    """Result of a design for `design.json`: SI units, None for values without a bound."""
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
        none=_verdict(outcome.none),
        given=None if outcome.given is None else _verdict(outcome.given),
        designed=None if outcome.designed is None else _verdict(outcome.designed),
        effort=outcome.request.effort,
        seconds=round(outcome.seconds, 2),
        emulated=True if outcome.emulated else None,
    )


def _verdict(verdict: NotchVerdict) -> DesignVerdict:
    return DesignVerdict(
        notch=tuple(notch_table(notch) for notch in verdict.notches),
        holds=verdict.holds,
        checks=tuple(DesignCheck(**asdict(check), holds=check.holds) for check in verdict.checks),
        tip_peaks=tuple(TipPeak(**asdict(row)) for row in verdict.peaks),
        margins=tuple(SpeedMarginsEntry(speed_rps=speed, **asdict(one)) for speed, one in verdict.margins.items()),
    )
