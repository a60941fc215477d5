"""Problem of a notch design."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_profiles.family.profile import Profile
from hil.analysis import TipScale, order_window_rps, tip_displacement_mm
from hil.bench.bench import AxisTable, Bench
from hil.bench.model import IdentifiedAxis
from hil.control.cancellation_table import LIMIT_USED
from hil.control.notch import NOTCHES
from hil.control.order_keys import amplitude_key
from hil.design.frequency import CONTROL_PERIOD_S, Loop, TwoInertia
from hil.design.notch_problem import DesignRamp, NotchProblem, Requirements, speed_ranges
from hil.design.notch_search import Effort
from hil.design.ramp import RampMotion
from hil.design.transmission_error import TransmissionError
from hil.design.uncertainty import around
from hil.errors import NotPossibleError
from hil.experiments.judge import scale_at

OTHER_RAMPS = ((0.5, 1.0), (2.0, 0.75))
"""Rates of the slower and the faster ramp by the user's own, with weights: a robot's work is seldom the judged motion."""
WATCHED = 1.85
"""Bound: speed up to which ramps lead in units of f_al/k: beyond the end of any filter that is tried."""
LOWEST_WATCHED = 0.45
"""Bound: lowest speed that is looked at in units of f_al/k of the highest order: filters act from there at the earliest."""
FRICTION_FRACTION, GRAVITY_FRACTION = 0.02, 0.06
"""Measured: friction and gravity at the motor by the torque limit, where not known: on the drawn robots 10700 to 10764 0.01 and
0.03 (median), 0.03 and 0.07 (nine in ten)."""
LARGEST_ORDER = 8
"""Bound: order that a filter of a drive follows."""


@dataclass(frozen=True)
class TipDisplacement:
    """Tip displacement of a simulated run."""

    lever_m: float
    scale: TipScale

    def __call__(self, motion: RampMotion) -> NDArray[np.float64]:
        """Tip displacement in mm over the time of a motion."""
        return tip_displacement_mm(self.lever_m * motion.arm_acceleration_rad_s2, motion.period_s, self.scale)


@dataclass(frozen=True)
class NotchDesignRequest:
    """Request of a notch design.

    Attributes:
        orders: Orders k, in the order in which their filters are designed.
        requirements: Margins and tip peak; None for the defaults with the bench file's specification.
        uncertainty_percent: Uncertainty of K_g and J_l; None for the model file's standard errors, or 5 %.
        period_s: Sampling time of the loop; None for the drive family's, or 250 µs.
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


def problem_of(bench: Bench, request: NotchDesignRequest, axis_model: IdentifiedAxis | None = None) -> tuple[NotchProblem, float]:
    """Build the design problem of a request, and f_al in Hz.

    Orders of the request that the axis does not reach within its speed limit are not among the problem's.

    Raises:
        NotPossibleError: The bench lacks the axis, its model, its transmission error, or a ramp; or the axis reaches none of the
            orders, so that there is nothing to suppress.
    """
    number = request.axis
    if number not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {number}; it has {', '.join(map(str, bench.axis))}")
    table = bench.axis[number]
    plant = table.plant()
    if plant is None or table.model is None:
        raise NotPossibleError(f"axis {number} has no model; give one in the bench file, or identify it and give --model")
    period = request.period_s or _period_s(table)
    cascade = table.gains(f"a filter of axis {number}").cascade()
    f_al = Loop(plant, cascade, (), period, request.delay_samples).peak_hz()
    scale = scale_at(bench, number, f_al)
    amplitudes = table.model.ate.amplitudes_arcsec()
    _check_orders(number, request.orders, amplitudes)
    ramps, windows = _ramps(bench, request, plant, f_al, scale, sorted(amplitudes), period)
    if not any(order in windows for order in request.orders):
        raise NotPossibleError(f"{unreached_words(number, request.orders, f_al, table.limits.speed_rps)}")
    error = TransmissionError(amplitudes, table.model.ate.phases_deg())
    errors, more = _standard_errors(axis_model)
    members = around(plant, error, percent=request.uncertainty_percent, standard_error=errors, amplitude_error_arcsec=more)
    problem = NotchProblem(
        members=members,
        cascade=cascade,
        period_s=period,
        delay_samples=request.delay_samples,
        lever_m=table.tip_lever_m,
        speed_limit_rps=table.limits.speed_rps,
        f_al_hz=f_al,
        ramps=ramps,
        ranges=speed_ranges(windows, LOWEST_WATCHED * f_al / max(windows), max(ramp.top_rps for ramp in ramps)),
        displacement_mm=TipDisplacement(table.tip_lever_m, scale),
        requirements=request.requirements or Requirements(tip_mm=bench.specification.tip_mm),
        **_loads(table, axis_model),
    )
    return problem, f_al


def _loads(table: AxisTable, axis_model: IdentifiedAxis | None) -> dict[str, Any]:
    """Friction and gravity at the motor.

    They come from the model file if it has them, else they are fractions of the torque limit.
    """
    plant = None if axis_model is None else axis_model.plant
    friction = FRICTION_FRACTION * table.limits.torque_nm
    gravity, is_known = GRAVITY_FRACTION * table.limits.torque_nm, False
    if plant is not None and plant.coulomb_friction_nm is not None:
        friction = plant.coulomb_friction_nm
    if plant is not None and plant.gravity_moment_nm is not None:
        gravity, is_known = abs(plant.gravity_moment_nm) / table.reduction_ratio, True
    return {"friction_nm": friction, "gravity_nm": gravity, "is_gravity_known": is_known}


def unreached_words(axis: int, orders: Sequence[int], f_al_hz: float, limit_rps: float) -> str:
    """Sentence on orders that an axis does not reach."""
    meets = ", ".join(f"order {order} meets f_al = {f_al_hz:.2f} Hz at {f_al_hz / order:.2f} rev/s" for order in orders)
    return f"axis {axis}: {meets}, beyond its speed limit of {limit_rps:g} rev/s: there is nothing to suppress"


def _check_orders(axis: int, orders: Sequence[int], amplitudes_arcsec: Mapping[float, float]) -> None:
    """Refuse orders without a filter or without a known error."""
    if len(set(orders)) > NOTCHES:
        raise NotPossibleError(f"{len(set(orders))} orders; an axis has {NOTCHES} filters")
    for order in orders:
        if not 1 <= order <= LARGEST_ORDER:
            raise NotPossibleError(f"no filter of order {order} follows the motor; those of order 1 to {LARGEST_ORDER} do")
        if not amplitudes_arcsec.get(order, 0.0) > 0.0:
            raise NotPossibleError(
                f"axis {axis}: the transmission error of order {order} is not known; find it with hil identify ate"
            )


def _ramps(
    bench: Bench, request: NotchDesignRequest, plant: TwoInertia, f_al_hz: float, scale: TipScale, orders: Sequence[float],
    period_s: float,
) -> tuple[tuple[DesignRamp, ...], dict[float, tuple[float, float]]]:  # fmt: skip
    """Build the ramps, and the windows of the reached orders.

    The ramps are the user's own, a slower and a faster one. The windows are those of orders that the user's own ramp reaches.
    """
    if bench.constant_acceleration is None:
        raise NotPossibleError(
            f"bench {bench.name!r} has no constant_acceleration table; add it, because a filter is judged on that ramp"
        )
    limits, rate = bench.axis[request.axis].limits, bench.constant_acceleration.acceleration_rps_s
    windows = {k: scale.windows_rps.get(round(k), ()) if k == round(k) else () for k in orders}
    made = {k: window or order_window_rps(f_al_hz, k) for k, window in windows.items()}
    low = LOWEST_WATCHED * f_al_hz / max(orders)
    wanted = WATCHED * f_al_hz / min(request.orders)

    def ramp(factor: float, weight: float, top: float) -> DesignRamp:
        return DesignRamp.of(factor * rate, low, limits.speed_rps, top, f_al_hz, period_s, weight)

    own = ramp(1.0, 1.0, max(wanted, *(high for _, high in made.values())))
    inertia = plant.motor_inertia_kg_m2 + plant.arm_inertia_kg_m2 / plant.reduction_ratio**2
    fastest = LIMIT_USED * limits.torque_nm / (2.0 * np.pi * inertia)
    others = [ramp(factor, weight, wanted) for factor, weight in OTHER_RAMPS if factor * rate <= max(rate, fastest)]
    reached = {order: window for order, window in made.items() if own.top_rps >= f_al_hz / order}
    first = min((order for order in request.orders if order in reached), default=1)
    return (own, *(each for each in others if each.top_rps >= f_al_hz / first)), reached


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
