"""`hil design notch`: from a bench file and what has been identified to filters, and to what a drive takes of them."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from drive_profiles.catalogue import Catalogue
from drive_profiles.parameters import Header, Item, ParameterSet
from drive_profiles.profile import Profile
from drive_profiles.realisation import Target, realise
from hil.analysis import WINDOWS_RPS, tip_displacement_mm
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from hil.control.trajectory import ConstantAcceleration, sample_times
from hil.design.frequency import Loop
from hil.design.notch_design import Check, Problem, Requirements, Verdict
from hil.design.notch_search import Effort, judged, search, workers
from hil.design.ramp import Motion
from hil.design.transmission_error import TransmissionError
from hil.design.uncertainty import around
from hil.errors import HilError, NotPossibleError
from hil.master.bench import Axis, Bench
from hil.master.designed import DesignedAxis, notch_table
from hil.master.identified import Identified, IdentifiedAxis, with_identified

SCHEMA = 1

SETTLE_RPS = 1.0
"""How far below the lowest judged speed the ramp down goes on, so that the band-pass has what it needs."""


class InfeasibleError(HilError):
    """No filter keeps everything that is asked."""

    exit_code: ClassVar[int] = 9

    def __init__(self, axis: int, what: str, missed: Sequence[Check]) -> None:
        """Keep the axis, what was looked for, and what the closest misses."""
        self.axis, self.what, self.missed = axis, what, tuple(missed)
        super().__init__(f"axis {axis}: {what}: {'; '.join(map(str, missed))}")


@dataclass(frozen=True)
class TipDisplacement:
    """The metric of a run (`hil.analysis`), of a simulated one.

    Attributes:
        lever_m: From the arm's axis to the tip.
        f_al_hz: Peak of |G_al|.
    """

    lever_m: float
    f_al_hz: float

    def __call__(self, motion: Motion, low_rps: float, high_rps: float) -> tuple[float, float]:
        """Largest tip displacement in mm between two speeds, while the speed rises and while it falls."""
        displacement = np.abs(tip_displacement_mm(self.lever_m * motion.arm_acceleration_rad_s2, motion.period_s, self.f_al_hz))
        speed = np.abs(motion.motor_speed_rps)
        inside = (speed >= low_rps) & (speed <= high_rps)
        rising = np.arange(len(speed)) < int(np.argmax(speed))
        peaks = [float(np.max(displacement[inside & part], initial=0.0)) for part in (rising, ~rising)]
        return peaks[0], peaks[1]


@dataclass(frozen=True)
class Request:
    """What is wanted.

    Attributes:
        axis: Number.
        orders: k, in the order in which their filters are designed.
        shapes: Which are tried.
        requirements: What must be kept; None for the defaults with the bench file's specification.
        uncertainty_percent: Of K_g and J_l; None for the model file's standard errors, or 5 %.
        period_s: Sampling time of the loop; None for the drive family's, or 250 µs.
        delay_samples: Whole samples between measurement and torque.
        effort: How long is searched.
        jobs: Processes; 0 for this one alone.
        is_given: Judge the bench file's own filters only.
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
class Outcome:
    """What came of it.

    Attributes:
        bench: As it was used, with what has been identified.
        source: Where the plant is from, in words.
        request: What was wanted.
        problem: What was solved.
        f_al_hz: Peak of |G_al| of the believed plant without a filter.
        none: Without filters.
        given: The bench file's filters; None without them.
        designed: The best filters, or those that miss least; None where only the given ones were judged.
        failure: Why there is none; None where there is.
        seconds: How long it took.
    """

    bench: Bench
    source: str
    request: Request
    problem: Problem
    f_al_hz: float
    none: Verdict
    given: Verdict | None
    designed: Verdict | None
    failure: InfeasibleError | None
    seconds: float

    @property
    def table(self) -> Axis:
        """The axis in the bench file."""
        return self.bench.axis[self.request.axis]

    @property
    def best(self) -> Verdict:
        """What the report is about: the designed filters, else the given ones."""
        found = self.designed or self.given
        assert found is not None  # noqa: S101 - one of them has been asked for
        return found

    def loop(self, notches: Sequence[Notch] = ()) -> Loop:
        """The loop around the believed plant."""
        return self.problem.loop(self.problem.members[0], notches)


def design(
    bench: Bench,
    request: Request,
    identified: Identified | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Outcome:
    """Filters for one axis; where none keeps everything, the outcome says by what the closest fails.

    Args:
        bench: The bench file.
        request: What is wanted.
        identified: A model file, which counts before the bench file's model.
        progress: Called with the share that is done.

    Raises:
        NotPossibleError: The bench has not what a design needs.
        ValueError: A request outside its range.
    """
    began = time.monotonic()
    source = "bench file"
    known = IdentifiedAxis()
    if identified is not None:
        known = identified.axis.get(request.axis, known)
        parts = [name for name in ("plant", "ate") if getattr(known, name) is not None]
        source = (
            f"model file ({', '.join(parts)}), the rest: bench file" if parts else "bench file; the model file lacks the axis"
        )
        bench = with_identified(bench, identified)
    problem, f_al = problem_of(bench, request, known)
    table = bench.axis[request.axis]
    given = tuple(one.notch() for one in table.notch)
    with workers(request.jobs) as pool:
        none = judged(problem, (), request.orders, pool)
        judged_given = judged(problem, given, request.orders, pool) if given else None
        designed: Verdict | None = None
        failure: InfeasibleError | None = None
        if request.is_given:
            if judged_given is None:
                raise NotPossibleError(f"axis {request.axis}: the bench file gives it no notch")
            if not judged_given.holds:
                failure = InfeasibleError(request.axis, "the given filters miss what is asked", judged_given.missed)
        elif bare := _bare_failure(request.axis, none):
            failure, designed = bare, none
        else:
            designed, failure = _searched(problem, request, f_al, given, pool, progress)
    seconds = time.monotonic() - began
    return Outcome(bench, source, request, problem, f_al, none, judged_given, designed, failure, seconds)


def _bare_failure(axis: int, none: Verdict) -> InfeasibleError | None:
    """Margins that are missed without any filter: none can mend them where it does not act."""
    missed = [check for check in none.missed if check.name in {"pole radius", "M_s", "phase margin", "gain margin"}]
    if not missed:
        return None
    return InfeasibleError(axis, "these gains miss what is asked already without a filter", missed)


def _searched(
    problem: Problem,
    request: Request,
    f_al_hz: float,
    given: Sequence[Notch],
    pool: Any,
    progress: Callable[[float], None],
) -> tuple[Verdict, InfeasibleError | None]:
    """One filter after the other; those of orders that are not asked for stay as they are given."""
    kept = tuple(notch for notch in given if notch.order not in request.orders)
    if len(kept) + len(request.orders) > NOTCHES:
        raise NotPossibleError(f"axis {request.axis}: {len(kept)} filters of other orders leave no room; an axis has {NOTCHES}")
    found: Verdict | None = None
    for place, order in enumerate(request.orders):
        own = [notch for notch in given if notch.order == order and notch.mode != NOTCH_OFF]
        present = replace(problem, fixed=kept)

        def told(share: float, place: int = place) -> None:
            progress((place + share) / len(request.orders))

        result = search(
            present, order, request.shapes, f_al_hz, effort=request.effort, pool=pool, given=own,
            template=own[0] if own else None, progress=told,
        )  # fmt: skip
        found = result.best
        if not found.holds:
            shapes = " or ".join(request.shapes)
            what = f"no {shapes} filter of order {order} keeps all that is asked; the closest misses"
            return found, InfeasibleError(request.axis, what, found.missed)
        kept = found.notches
    assert found is not None  # noqa: S101 - there is at least one order
    whole = judged(problem, found.notches, request.orders, pool)
    if whole.holds:
        return whole, None
    return whole, InfeasibleError(request.axis, "the filters together miss what is asked", whole.missed)


def problem_of(bench: Bench, request: Request, known: IdentifiedAxis | None = None) -> tuple[Problem, float]:
    """What is to be solved, and f_al.

    Raises:
        NotPossibleError: No such axis, no model of it, no ramp, or a transmission error that nobody knows.
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
    for order in request.orders:
        if order not in WINDOWS_RPS:
            raise NotPossibleError(
                f"filters of order {order} are not judged; of order {' and '.join(map(str, WINDOWS_RPS))} they are"
            )
        if not getattr(table.model.ate, f"a{order}_arcsec") > 0.0:
            raise NotPossibleError(f"axis {number}: the transmission error of order {order} is not known: hil identify ate")
    ate = table.model.ate
    error = TransmissionError({2: ate.a2_arcsec, 4: ate.a4_arcsec}, {2: ate.phi2_deg, 4: ate.phi4_deg})
    period = request.period_s or _period_s(table)
    bare = Loop(plant, table.control.cascade(), (), period, request.delay_samples)
    f_al = bare.peak_hz()
    errors, amplitudes = _standard_errors(known)
    members = around(plant, error, percent=request.uncertainty_percent, standard_error=errors, amplitude_error_arcsec=amplitudes)
    problem = Problem(
        members=members,
        cascade=table.control.cascade(),
        period_s=period,
        delay_samples=request.delay_samples,
        lever_m=table.tip_lever_m,
        speed_limit_rps=table.limits.speed_rps,
        reference_rad=_reference(bench, request, period),
        windows_rps={
            order: WINDOWS_RPS[order]
            for order in sorted({*request.orders, *(n.order for n in table.notch)})
            if order in WINDOWS_RPS
        },
        tip_peak=TipDisplacement(table.tip_lever_m, f_al),
        requirements=request.requirements or Requirements(tip_mm=bench.specification.tip_mm),
    )
    return problem, f_al


def _period_s(table: Axis) -> float:
    """Of the loop inside the drive, as its profile says."""
    loop = Profile.load(table.profile).loop
    return 250e-6 if loop is None or loop.period_s is None else loop.period_s


def _standard_errors(known: IdentifiedAxis | None) -> tuple[Mapping[str, float], Mapping[int, float]]:
    errors: dict[str, float] = {}
    amplitudes: dict[int, float] = {}
    if known is not None and known.plant is not None:
        errors = dict(known.plant.standard_error)
    if known is not None and known.ate is not None:
        amplitudes = {order: known.ate.standard_error.get(f"a{order}_arcsec", 0.0) for order in WINDOWS_RPS}
    return errors, amplitudes


def _reference(bench: Bench, request: Request, period_s: float) -> Any:
    """θ_ref of the bench file's ramp, up at its rate and down at the same, until the lowest judged speed is well behind."""
    table = bench.constant_acceleration
    assert table is not None  # noqa: S101 - the caller has looked
    rate, top = table.acceleration_rps_s, min(table.end_rps, bench.axis[request.axis].limits.speed_rps)
    ramp = ConstantAcceleration(rate, top, rate, dwell_s=0.1, tail_s=0.0)
    lowest = min(WINDOWS_RPS[order][0] for order in request.orders)
    down = (top - max(0.0, lowest - SETTLE_RPS)) / rate
    return ramp.motor_angle(sample_times(0.1 + top / rate + down, period_s))


# -- what is kept ----------------------------------------------------------------------------------------------------------


def parameter_set(bench: Bench, axis: int, found: Verdict, f_al_hz: float) -> ParameterSet:
    """The filters as `drive-profiles upload` takes them; the drive's other filters are switched off.

    Raises:
        NotPossibleError: The drive family has no variable notch.
        DriveProfileError: It has one that does not hold these values.
    """
    table = bench.axis[axis]
    profile = Profile.load(table.profile)
    check_drive(bench, axis)
    items: dict[str, Item] = {}
    for column in range(NOTCHES):
        name = f"notch_{column + 1}"
        if column >= len(found.notches):
            items[f"{name}.mode"] = Item(value=NOTCH_OFF)
            continue
        notch = found.notches[column]
        target = Target.at_speed(notch.order, f_al_hz / notch.order, notch.offset_hz, notch.zeta_rn, notch.zeta_rdth)
        realise(profile, target, section=column)
        values = {**vars(notch)}
        mode = values.pop("mode")  # last: until then the filter is the one before, or off
        for key, value in {**values, "mode": mode}.items():
            items[f"{name}.{key}"] = Item(value=value, unit=profile.parameter(f"{name}.{key}").unit)
    header = Header(
        profile=profile.name,
        node_id=table.node_id,
        vendor_id=profile.identity.vendor_id,
        serial_number=table.serial_number,
        title=f"axis {axis} of {bench.name}: {summary(found)}",
    )
    made = ParameterSet(header=header, tuning=items)
    made.writes(Catalogue(profile))
    return made


def check_drive(bench: Bench, axis: int) -> None:
    """Refuse a drive family that does not vary a notch by itself.

    Raises:
        NotPossibleError: It does not, with what it has.
    """
    profile = Profile.load(bench.axis[axis].profile)
    names = [f"notch_{column + 1}.{name}" for column in range(NOTCHES) for name in vars(Notch())]
    missing = [name for name in names if name not in profile.parameters]
    if profile.notch is None or profile.notch.form != "variable" or missing:
        has = "no filter" if profile.notch is None else f"a filter of the form {profile.notch.form!r}"
        raise NotPossibleError(
            f"axis {axis}: drive family {profile.name} has {has}, no notch that follows the speed: no parameter set can be made "
            "of this design; drive-profiles realise shows what it makes of one speed"
        )


def summary(found: Verdict) -> str:
    """The filters' margins and predicted peaks in one line."""
    worst = {check.name: check for check in found.checks}
    peaks = ", ".join(f"k = {row.order}: {row.rising_mm:.4f} mm, worst plant {row.worst_mm:.4f} mm" for row in found.peaks)
    return (
        f"M_s {worst['M_s'].value:.2f}, phase margin {worst['phase margin'].value:.1f}°, gain margin "
        f"{worst['gain margin'].value:.1f} dB at every speed and plant; predicted tip peak {peaks}"
    )


def designed_axis(outcome: Outcome) -> DesignedAxis:
    """What the design file keeps."""
    found, worst = outcome.best, {check.name: check for check in outcome.best.checks}
    return DesignedAxis(
        notch=tuple(notch_table(notch) for notch in found.notches),
        tip_peak_mm={str(row.order): row.rising_mm for row in found.peaks},
        worst_tip_peak_mm={str(row.order): row.worst_mm for row in found.peaks},
        sensitivity_peak=worst["M_s"].value,
        phase_margin_deg=worst["phase margin"].value,
        gain_margin_db=min(worst["gain margin"].value, 200.0),
        period_s=outcome.problem.period_s,
        delay_samples=outcome.problem.delay_samples,
        note=outcome.source,
    )


def document(outcome: Outcome) -> dict[str, Any]:
    """All of it as JSON: SI units, None for what has no bound."""
    asked = outcome.problem.requirements
    whole = {
        "schema": SCHEMA,
        "bench": outcome.bench.name,
        "axis": outcome.request.axis,
        "orders": list(outcome.request.orders),
        "plant_from": outcome.source,
        "period_s": outcome.problem.period_s,
        "delay_samples": outcome.problem.delay_samples,
        "speed_limit_rps": outcome.problem.speed_limit_rps,
        "f_al_hz": outcome.f_al_hz,
        "requirements": asdict(asked),
        "plants": [{"label": member.label, **asdict(member.plant)} for member in outcome.problem.members],
        "feasible": outcome.failure is None,
        "reason": None if outcome.failure is None else str(outcome.failure),
        "none": _verdict(outcome.none),
        "given": None if outcome.given is None else _verdict(outcome.given),
        "designed": None if outcome.designed is None else _verdict(outcome.designed),
        "effort": asdict(outcome.request.effort),
        "seconds": round(outcome.seconds, 2),
    }
    made: dict[str, Any] = _finite(whole)
    return made


def _verdict(found: Verdict) -> dict[str, Any]:
    return {
        "notch": [notch_table(notch).model_dump() for notch in found.notches],
        "holds": found.holds,
        "checks": [{**asdict(check), "holds": check.holds} for check in found.checks],
        "tip_peaks": [asdict(row) for row in found.peaks],
        "margins": [{"speed_rps": speed, **asdict(one)} for speed, one in found.margins.items()],
    }


def _finite(value: Any) -> Any:
    """JSON has no NaN and no infinity."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    return [_finite(part) for part in value] if isinstance(value, list | tuple) else value
