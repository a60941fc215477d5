"""Cancellation of the transmission error in a run.

It acts by additions to the set-points, or inside the drives.

What is added is bounded by its table, and checked with the motion against every limit before anything moves. No cancellation is
trusted before its trial at the tip: `hil.experiments.cancellation.trial`.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np

from drive_profiles.family.profile import Profile
from hil.analysis import TipScale, joint_scale
from hil.bench.bench import AxisTable, Bench, Limits, Model
from hil.bench.model import Identified, IdentifiedError, identified_axis, significant, with_identified
from hil.can.channel import Channel
from hil.control.angles import ARCSEC
from hil.control.cancellation import CancellationLaw
from hil.control.cancellation_table import LIMIT_USED, CancellationTable, MotorLoad
from hil.design.frequency import CONTROL_PERIOD_S, TIP_HZ
from hil.design.inverse import Actuation, CyclicTiming, cancellation_table
from hil.design.ringing import RINGING
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.bus_demand import BusDemand, check_load, takes_torque_offset
from hil.experiments.cancellation.effect import Part, Response
from hil.experiments.cancellation.waves import response_of
from hil.experiments.judge import scale_at
from hil.experiments.motor_inertia import nothing_known
from hil.master.motion import Motion
from hil.master.session import Session
from hil.master.whereabouts import way_out
from hil.results.acted import CancelledOrder
from hil.robot_tables import TransmissionErrorTable

MAX_ERROR_ARCSEC = 200.0
"""Bound: ΣA_k that is cancelled: harmonic gears have a tenth to a half of it, so more is a slip in a model file."""
HIGHEST_OVER_RESONANCE = 4.0
"""Measured: highest k f_m of a cancellation in units of f_al, if that is more than the usual one. Of 300 drawn robots whose true
error is cancelled, 3.2 leaves over 3 % more of the tip on 39 and over 3 % less on 2, and 5 costs one the goal."""
MAX_TORQUE_FRACTION = 0.2
"""Largest torque offset as a fraction of the torque limit."""
ORDINARY = 0.98
"""Probability: fraction of a motion's samples that has no larger acceleration than the largest that counts."""
LOAD_ROOM = 1.5
"""Accuracy: largest gear torque that counts, over that of gravity and of the motion's largest acceleration: a factor of 2 changes
0.16, and no tip by 0.0002 mm."""
FOLLOWING_PART = 0.05
"""Largest addition to a set-point as a part of the following error, unless the bench file says `cancellation_rev`. The drawn
robots 50201, 50202, 50204 and 50205 need 0.6 to 2.1 %."""


class Pace(NamedTuple):
    """Speed and acceleration of a motion.

    Attributes:
        peak_rps: Highest motor speed; 0 if it is not known.
        most_rad_s2: Largest acceleration, likewise.
    """

    peak_rps: float = 0.0
    most_rad_s2: float = 0.0


@dataclass
class CancellationAdder:
    """Set-point adder of a cancellation.

    Attributes:
        uses_torque: True if torque offsets (60B2h) are mapped.
    """

    uses_torque: bool
    laws: CancellationLaw

    @property
    def data(self) -> Any:
        """The core's record of the laws."""
        return self.laws.data


@dataclass(frozen=True)
class Cancellation:
    """Additions to the set-points of some axes.

    Attributes:
        axes: Axis numbers in the order of the motion.
        tables: Cancellation tables by axis; an axis without one is left alone.
        scales: Scales by which the vibration is judged, by axis.
        responses: Responses of the arm by axis, with which its trial reads the orders.
        is_learnt_on_motion: True if all of it was learnt by probing a motion: its orders are known together, not each.
    """

    axes: tuple[int, ...]
    tables: Mapping[int, CancellationTable]
    period_s: float
    torque_steps_nm: Mapping[int, float] = field(default_factory=dict)
    scales: Mapping[int, TipScale] = field(default_factory=dict)
    responses: Mapping[int, Response] = field(default_factory=dict)
    is_learnt_on_motion: bool = False

    @property
    def uses_torque(self) -> bool:
        """True if any axis needs a torque offset."""
        return any(table.largest_torque_nm() > 0.0 for table in self.tables.values())

    @property
    def scale(self) -> TipScale | None:
        """Scale of all axes together; None without one."""
        scales = list(self.scales.values())
        return scales[0] if len(scales) == 1 else joint_scale(scales) if scales else None

    @property
    def parts(self) -> tuple[Part, ...]:
        """Each order of each axis."""
        return tuple(Part(number, order) for number, table in self.tables.items() for order in table.orders)

    def without(self, parts: Collection[Part]) -> "Cancellation":
        """Copy of the cancellation without some orders of some axes."""
        left = {
            number: table.without([part.order for part in parts if part.axis == number]) for number, table in self.tables.items()
        }
        return replace(self, tables={number: table for number, table in left.items() if table is not None})

    def on(self, axes: Sequence[int]) -> "Cancellation":
        """Cancellation of some of its axes, for a motion of these alone."""
        return replace(self, axes=tuple(axes), tables={n: table for n, table in self.tables.items() if n in axes})

    def adder(self, gain: float = 1.0, only: int | None = None) -> CancellationAdder:
        """Adder for one run."""
        wanted = [self.tables[n].scaled(gain) if n in self.tables and only in {None, n} else None for n in self.axes]
        steps = [self.torque_steps_nm.get(number, 0.0) for number in self.axes]
        return CancellationAdder(self.uses_torque, CancellationLaw(wanted, self.period_s, steps))

    def check(self, bench: Bench, motion: Motion, starts_rad: Sequence[float] | None = None) -> None:
        """Check motion and approach with the largest additions against all limits.

        Raises:
            UnsafeRequestError: A limit could be exceeded.
        """
        turn = 2.0 * math.pi
        for column, number in enumerate(self.axes):
            if number not in self.tables:
                continue
            limits, name, own = bench.axis[number].limits, f"axis {number}", self.tables[number]
            angle = motion.motor_angle_rad[:, column] + (0.0 if starts_rad is None else starts_rad[column])
            peak_rps = pace_of(bench, motion, column).peak_rps
            reach_rev = own.largest_reference_rad(peak_rps) / turn
            remedy, allowed_rev = "check the transmission error in the model file", allowed_reference_rev(limits)
            if reach_rev > allowed_rev:
                where = f"limits.cancellation_rev of {name} in the bench file sets it; the default is {FOLLOWING_PART:g} of "
                where += f"following_error_rev; {remedy}"
                raise UnsafeRequestError(f"the cancellation of {name}", reach_rev, allowed_rev, "rev", where)
            torque, allowed = own.largest_torque_nm(peak_rps), MAX_TORQUE_FRACTION * limits.torque_nm
            if torque > allowed:
                raise UnsafeRequestError(f"the torque offset of {name}", torque, allowed, "N·m", remedy)
            speed = own.largest_speed_rps(peak_rps)
            if speed > limits.speed_rps:
                raise UnsafeRequestError(f"the speed of {name} with its cancellation", speed, limits.speed_rps, "rev/s")
            high, low = float(angle.max()) / turn + reach_rev, float(angle.min()) / turn - reach_rev
            if limits.position_min_rev <= low and high <= limits.position_max_rev:
                continue
            is_high, remedy = high > limits.position_max_rev, ""
            if starts_rad is not None and not motion.starts_at_home:
                stands_rev = starts_rad[column] / turn
                remedy = way_out(number, stands_rev, limits, low - stands_rev, high - stands_rev)
            value, limit = (high, limits.position_max_rev) if is_high else (low, limits.position_min_rev)
            raise UnsafeRequestError(f"the position of {name} with its cancellation", value, limit, "rev", remedy)


def allowed_reference_rev(limits: Limits) -> float:
    """Largest addition to a set-point, in motor revolutions.

    The bench file states it, or it is a part of the following error.
    """
    if limits.cancellation_rev is not None:
        return limits.cancellation_rev
    return FOLLOWING_PART * limits.following_error_rev


class Way(TypedDict, total=False):
    """Way in which a cancellation reaches the drives.

    Attributes:
        actuation: `reference`, the default, for the set-point alone, `torque` with a torque offset.
        control_periods_s: T_c by axis; 250 µs where it is not given.
        torque_steps_nm: Resolution of the drives' torque offsets, by axis.
    """

    actuation: Actuation
    with_notch: bool
    control_periods_s: Mapping[int, float]
    torque_steps_nm: Mapping[int, float]


def cancellation_for(
    bench: Bench,
    identified: Identified | None,
    axes: Sequence[int],
    period_s: float,
    *,
    paces: Mapping[int, Pace] | None = None,
    by_torque: bool = False,
    **way: Unpack[Way],
) -> Cancellation:
    """Cancellation of some axes, from their models.

    By the set-point alone (607Ah) needs no more of a drive than CSP, and no room on the bus. With a torque offset (60B2h, two
    more bytes for each axis) the law has nothing to do for the cancellation, so no filter in it matters. Both do equally well at
    SYNC periods of 1 and 2 ms without a filter; on 1 Mbit/s three axes with torque offsets need 2 ms.

    Args:
        identified: The model file; None for the bench file's own model.
        paces: Paces of a motion by axis. Where its set-points would be faster than the axis may be, the highest orders are left
            out, though none within the resonance; without it the motor's acceleration is not allowed for either.
        by_torque: True if torque offsets can be sent: what the set-points have no room for is left to them.

    Raises:
        NotPossibleError: The model file is another robot's, or no transmission error is known of any of the axes.
        UnsafeRequestError: The model file has an error that no gear has.
    """
    tables: dict[int, CancellationTable] = {}
    scales: dict[int, TipScale] = {}
    for number in axes:
        model = treated_model(bench, identified, number)
        if model is None:
            continue
        error = identified_axis(identified, number).ate
        late_s = 0.0 if error is None else error.set_point_delay_s
        timing = CyclicTiming(period_s, way.get("control_periods_s", {}).get(number) or CONTROL_PERIOD_S, late_s)
        pace = (paces or {}).get(number, Pace())
        tables[number], scales[number] = table_of(
            bench, number, model, timing, pace, way.get("actuation", "reference"),
            with_notch=way.get("with_notch", False), by_torque=by_torque, torque_lag_s=known_lag_s(identified, number),
            load=motor_load(bench, identified, model, number, pace.most_rad_s2),
        )  # fmt: skip
    if not tables:
        raise NotPossibleError(nothing_known(bench, identified, axes))
    known = {number: response for number in axes if (response := response_of(bench, identified, number)) is not None}
    errors = [identified_axis(identified, number).ate for number in tables]
    is_probed = all(error is not None and error.learnt_by == "probing" for error in errors)
    return Cancellation(tuple(axes), tables, period_s, way.get("torque_steps_nm", {}), scales, known, is_probed)


def table_of(
    bench: Bench,
    number: int,
    model: Model,
    timing: CyclicTiming,
    pace: Pace,
    actuation: Actuation,
    *,
    with_notch: bool,
    by_torque: bool = False,
    torque_lag_s: float = 0.0,
    load: MotorLoad | None = None,
) -> tuple[CancellationTable, TipScale]:
    """Table of an axis, and the scale of its vibration.

    A torque offset may do what the set-points' speed limit has no room for (`by_torque`).

    Raises:
        NotPossibleError: There is nothing to cancel, or no loop.
        UnsafeRequestError: The model has an error that no gear has.
    """
    table = bench.axis[number].model_copy(update={"model": model})
    table.gains(f"cancellation on axis {number}")
    _check_size(number, model.ate)
    loop = table.loop(timing.control_period_s, with_notch=with_notch)
    assert loop is not None  # noqa: S101 - it has a model and gains
    scale, limits = scale_at(bench, number, loop.peak_hz()), table.limits
    highest_hz = max(TIP_HZ, HIGHEST_OVER_RESONANCE * scale.f_al_hz)

    def by(way: Actuation) -> CancellationTable:
        error, chirp = (amplitudes_rad(model.ate), _phases_rad(model.ate)), pace.most_rad_s2
        try:
            return cancellation_table(loop, *error, timing, limits.speed_rps, way, highest_hz, chirp, torque_lag_s, load)
        except ValueError as error_of:
            raise NotPossibleError(f"axis {number}: {error_of}", ("nothing to cancel",)) from error_of

    kept_hz = RINGING * scale.f_al_hz
    alone, room_nm = by("torque alone") if by_torque else None, LIMIT_USED * MAX_TORQUE_FRACTION * limits.torque_nm
    return by(actuation).within_speed(limits.speed_rps, pace.peak_rps, kept_hz, alone, room_nm), scale


def _check_size(number: int, ate: TransmissionErrorTable) -> None:
    """Refuse an error that no gear has."""
    total = sum(ate.amplitudes_arcsec().values())
    if total > MAX_ERROR_ARCSEC:
        remedy = "no gear has as much; check the model file"
        raise UnsafeRequestError(f"the transmission error of axis {number}, ΣA_k,", total, MAX_ERROR_ARCSEC, "arcsec", remedy)


def pace_of(bench: Bench, motion: Motion, column: int) -> Pace:
    """Pace of an axis in a motion and in its approach."""
    angle, period_s = motion.motor_angle_rad[:, column], motion.period_s
    fastest = float(np.max(np.abs(np.diff(angle)))) / period_s / (2.0 * math.pi)
    rising = np.abs(np.gradient(np.gradient(angle, period_s), period_s))
    return Pace(max(fastest, bench.approach_rps), float(np.quantile(rising, ORDINARY)))


def amplitudes_rad(ate: TransmissionErrorTable) -> dict[float, float]:
    """A_k in rad, by order; only amplitudes above 0."""
    return {order: size * ARCSEC for order, size in ate.amplitudes_arcsec().items()}


def _phases_rad(ate: TransmissionErrorTable) -> dict[float, float]:
    """φ_k from 0 to 2π."""
    return {order: math.radians(degrees) for order, degrees in phases_deg(ate).items()}


def phases_deg(ate: TransmissionErrorTable) -> dict[float, float]:
    """φ_k from 0 to 360°."""
    return {order: degrees % 360.0 for order, degrees in ate.phases_deg().items()}


def known_lag_s(identified: Identified | None, number: int) -> float:
    """Identified lag of an axis' current loop, 0 without a plant: J_m and D_m go with it, however uncertain it is."""
    part = identified_axis(identified, number).plant
    return 0.0 if part is None else part.torque_lag_s


def motor_load(bench: Bench, identified: Identified | None, model: Model, number: int, most_rad_s2: float) -> MotorLoad | None:
    """Parameters of the gear torque that reacts on a motor, or None."""
    known, table = identified_axis(identified, number), bench.axis[number]
    if known.ate is None or known.ate.gear_reaction == 0.0:
        return None
    plant = known.plant
    gravity_nm = None if plant is None else plant.gravity_moment_nm
    most_nm = table.reduction_ratio * table.limits.torque_nm
    if gravity_nm is not None:
        most_nm = min(most_nm, LOAD_ROOM * (abs(gravity_nm) + model.arm_inertia_kg_m2 * most_rad_s2 / table.reduction_ratio))
    friction_nm = known.ate.motor_friction_nm if plant is None else plant.coulomb_friction_nm or 0.0
    inertia = model.motor_inertia_kg_m2, model.motor_damping_nm_s_rad
    return MotorLoad(table.reduction_ratio, *inertia, friction_nm, known.ate.gear_reaction, most_nm)


def cancellation_of(
    bench: Bench, identified: Identified | None, motion: Motion, channel: Channel | None = None, **way: Unpack[Way]
) -> Cancellation:
    """Make the cancellation of a motion at its pace.

    It uses torque offsets if set-points do not suffice and drives and bus support them; None for a bus that is not known.

    Raises:
        NotPossibleError: As `cancellation_for`.
        UnsafeRequestError: As `cancellation_for`.
    """
    paces = {number: pace_of(bench, motion, column) for column, number in enumerate(motion.axes)}
    made = partial(cancellation_for, bench, identified, motion.axes, motion.period_s, paces=paces, **way)
    with_torque = made(by_torque=True)
    is_asked_for = not with_torque.uses_torque or way.get("actuation") == "torque"
    if is_asked_for or _takes_torque(bench, motion, channel, with_notch=way.get("with_notch", False)):
        return with_torque
    return made(by_torque=False)


def _takes_torque(bench: Bench, motion: Motion, channel: Channel | None, *, with_notch: bool) -> bool:
    """True if drives and bus support torque offsets in a motion."""
    if not all(takes_torque_offset(Profile.load(bench.axis[number].profile)) for number in motion.axes):
        return False
    demand = BusDemand("the motion", motion.axes, motion.period_s, with_notch=with_notch, with_torque_offset=True)
    try:
        return channel is None or check_load(bench, channel, demand) in {True, False}
    except NotPossibleError:
        return False


def cancellation_on(session: Session, identified: Identified | None, motion: Motion, **way: Unpack[Way]) -> Cancellation:
    """Make the cancellation of a motion on a session.

    Raises:
        NotPossibleError: As `cancellation_for`.
        UnsafeRequestError: The motion with its additions could exceed a limit.
        HilError: A drive does not answer.
    """
    axes = {number: session.axes[number] for number in motion.axes}
    way["control_periods_s"] = {number: axis.control_period_s() for number, axis in axes.items()}
    way["torque_steps_nm"] = {number: axis.scaling.torque_nm(1) for number, axis in axes.items()}
    cancellation = cancellation_of(session.bench, identified, motion, session.network.channel, **way)
    starts = None if motion.starts_at_home else [axis.position_rad() for axis in axes.values()]
    cancellation.check(session.bench, motion, starts)
    return cancellation


def cancelled_orders(
    bench: Bench, identified: Identified | None, cancellation: Cancellation | None
) -> tuple[CancelledOrder, ...]:
    """Orders of a cancellation by set-points, with their model's values."""
    found = []
    for part in () if cancellation is None else cancellation.parts:
        model = treated_model(bench, identified, part.axis)
        if model is not None:
            size, phase = model.ate.amplitudes_arcsec()[part.order], model.ate.phases_deg()[part.order]
            found.append(CancelledOrder(axis=part.axis, order=part.order, amplitude_arcsec=size, phase_deg=phase, held_by="host"))
    return tuple(found)


def treated_model(bench: Bench, identified: Identified | None, number: int) -> Model | None:
    """Model of an axis; None without a transmission error to cancel.

    Raises:
        NotPossibleError: The model file is another robot's, or the bench has no such axis.
    """
    if identified is not None:
        identified.check_robot(bench.name)
    bench.check_axis(number)
    model, error = with_identified(bench, identified).axis[number].model, identified_axis(identified, number).ate
    if model is None and error is not None:
        model = model_of_error(bench.axis[number], error)
    return model if model is not None and amplitudes_rad(model.ate) else None


def model_of_error(table: AxisTable, error: IdentifiedError) -> Model | None:
    """Model of an axis with known J_m and error only.

    None without a J_m.

    A cancellation is made of J_m alone: the one with which the error was learnt, else that of the data sheet in the bench file.
    The rest gives the arm the error's resonance and damping, with as much inertia as the motor has behind its gear; from it only
    the band follows in which a trial judges.
    """
    motor = table.motor_inertia_kg_m2 if error.motor_inertia_kg_m2 is None else error.motor_inertia_kg_m2
    if motor is None or error.arm_hz is None or error.damping is None:
        return None
    inertia, omega = table.reduction_ratio**2 * motor, 2.0 * math.pi * error.arm_hz
    return Model(
        motor_inertia_kg_m2=motor,
        motor_damping_nm_s_rad=0.0,
        arm_inertia_kg_m2=inertia,
        arm_damping_nm_s_rad=0.0,
        gear_stiffness_nm_rad=inertia * omega**2,
        gear_damping_nm_s_rad=2.0 * error.damping * omega * inertia,
        ate=significant(error),
    )
