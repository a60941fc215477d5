"""Tables that bench files and robot files share.

Both sides of the bus have the same keys and ranges. The values differ: a bench file has an engineer's assumptions, a robot file
the values of the emulated robot. A side with more keys derives its table from the one here.
"""

from collections.abc import Collection, Mapping
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, model_validator

from drive_profiles.files.toml import Table
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, Notch
from hil.control.order_keys import amplitude_key, phase_key
from hil.control.trajectory import ConstantAcceleration, Line, PlanarChain, PointToPoint, Smooth

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

MOST_LEVER_M = 20.0
"""Longest lever of a robot's axis: arms reach some 5 m, so that more was typed in another unit."""


def _in_metres(lever_m: float) -> float:
    if lever_m > MOST_LEVER_M:
        raise ValueError(f"{lever_m:g} m is too long for a lever; expected at most {MOST_LEVER_M:g} m: state it in m, not in mm")
    return lever_m


Lever = Annotated[NotNegative, AfterValidator(_in_metres)]
"""Distance of the tip from an axis, m."""

K = TypeVar("K", bound=float)

LEAST_MOVE_REV = 0.01
"""Least way of a point-to-point move at the motor."""

MOST_AXES = 126
"""The most drives that one bus has node IDs for, beside the accelerometer (CiA 301, 7.2.8.2: 1 to 127)."""

AxisNumber = Annotated[int, Field(ge=1, le=MOST_AXES)]

ORDERS = (1, 2, 4)
"""Orders k of the transmission error that are looked for in every gear: the first, which real ones show, and the paper's two."""
HIGHEST_ORDER = 100.0
MOST_MORE_ORDERS = 4
"""Orders beside them that one axis can have."""


class PlantTable(Table):
    """The linear plant of an axis.

    Motor side for the motor, arm side for gear and arm.
    """

    motor_inertia_kg_m2: Positive
    motor_damping_nm_s_rad: NotNegative
    arm_inertia_kg_m2: Positive
    arm_damping_nm_s_rad: NotNegative
    gear_stiffness_nm_rad: Positive
    gear_damping_nm_s_rad: NotNegative


def _whole_is_int(order: float) -> float:
    return int(order) if float(order).is_integer() else order


class TransmissionErrorLine(Table):
    """One order of the transmission error besides `ORDERS`.

    It may be a fraction, as of a belt or a bearing.

    Attributes:
        order: Periods of the error in one revolution of the motor.
        a_arcsec: Amplitude.
        phi_deg: Phase.
    """

    order: Annotated[float, Field(gt=0.0, le=HIGHEST_ORDER), AfterValidator(_whole_is_int)]
    a_arcsec: NotNegative
    phi_deg: float = 0.0


class TransmissionErrorTable(Table):
    """Amplitudes and phases of the transmission error θ_sync; eq. (2)."""

    a1_arcsec: NotNegative = 0.0
    phi1_deg: float = 0.0
    a2_arcsec: NotNegative
    phi2_deg: float
    a4_arcsec: NotNegative = 0.0
    phi4_deg: float = 0.0
    more: Annotated[tuple[TransmissionErrorLine, ...], Field(max_length=MOST_MORE_ORDERS)] = ()

    @model_validator(mode="after")
    def _each_order_once(self) -> Self:
        orders = [*ORDERS, *(line.order for line in self.more)]
        twice = sorted({order for order in orders if orders.count(order) > 1})
        if twice:
            own = ", ".join(f"{order:g}" for order in twice)
            raise ValueError(f"more has order {own} twice, or together with its own key (a1_arcsec, a2_arcsec, a4_arcsec)")
        return self

    @classmethod
    def of(cls, amplitudes_arcsec: Mapping[K, float], phases_deg: Mapping[K, float]) -> Self:
        """Return the table of amplitudes and phases by order.

        A missing order of `ORDERS` is 0.

        Raises:
            ValueError: An amplitude has no phase, or the orders are more than a table holds.
        """
        amplitudes: dict[float, float] = {order: float(value) for order, value in amplitudes_arcsec.items()}
        phases: dict[float, float] = {order: float(value) for order, value in phases_deg.items()}
        without = sorted(amplitudes.keys() - phases.keys())
        if without:
            raise ValueError(f"order {', '.join(f'{order:g}' for order in without)} has an amplitude but no phase; give both")
        named: dict[str, float] = {}
        for order in ORDERS:
            named[amplitude_key(order)] = amplitudes.get(order, 0.0)
            named[phase_key(order)] = phases.get(order, 0.0)
        lines = [
            {"order": order, "a_arcsec": amplitudes[order], "phi_deg": phases[order]}
            for order in sorted(amplitudes.keys() - set(ORDERS))
        ]
        return cls.model_validate({**named, "more": tuple(lines)})

    def amplitudes_arcsec(self) -> dict[float, float]:
        """Amplitudes A_k above 0, by order."""
        named: dict[float, float] = {order: getattr(self, amplitude_key(order)) for order in ORDERS}
        named |= {each.order: each.a_arcsec for each in self.more}
        return {order: named[order] for order in sorted(named) if named[order] > 0.0}

    def phases_deg(self) -> dict[float, float]:
        """Phases φ_k of the orders that `amplitudes_arcsec` has."""
        named: dict[float, float] = {order: getattr(self, phase_key(order)) for order in ORDERS}
        named |= {each.order: each.phi_deg for each in self.more}
        return {order: named[order] for order in self.amplitudes_arcsec()}


def orders_of(text: str) -> tuple[float, ...]:
    """Read a set of orders, in rising order.

    Whole ones are int.

    >>> orders_of("1,2,4,0.5")
    (0.5, 1, 2, 4)

    Raises:
        ValueError: A word is not an order, one appears twice, or there are more than a table holds.
    """
    words = [word.strip() for word in text.split(",")]
    try:
        orders = sorted(_whole_is_int(float(word)) for word in words)
    except ValueError:
        raise ValueError(f"{text!r} is not a set of orders; expected numbers between commas, e.g. 1,2,4") from None
    if not all(0.0 < order <= HIGHEST_ORDER for order in orders):
        raise ValueError(f"{text!r}: an order must be above 0, and at most {HIGHEST_ORDER:g}")
    if len(set(orders)) < len(orders):
        raise ValueError(f"{text!r}: an order appears twice; give each once")
    if len(set(orders) - set(ORDERS)) > MOST_MORE_ORDERS:
        raise ValueError(f"{text!r}: at most {MOST_MORE_ORDERS} orders are possible in addition to {', '.join(map(str, ORDERS))}")
    return tuple(orders)


class Control(Table):
    """Gains of the P-PI cascade."""

    position_gain_per_s: NotNegative
    velocity_gain_nm_s_rad: NotNegative
    velocity_integral_gain_nm_rad: NotNegative
    lowpass_hz: Positive = 300.0

    def cascade(self) -> Cascade:
        """The gains for the law."""
        return Cascade(**self.model_dump())


class NotchShape(Table):
    """Range and depth of a variable notch: Table 3 of the paper."""

    shape: Literal["switched", "trapezoid"] = "switched"
    order: Annotated[int, Field(ge=1, le=8)] = 2
    start_rps: Positive
    end_rps: Positive
    offset_hz: NotNegative
    zeta_rn: Positive
    zeta_rdth: Positive

    def notch(self) -> Notch:
        """The filter for the law."""
        mode = NOTCH_SWITCHED if self.shape == "switched" else NOTCH_TRAPEZOID
        return Notch(mode=mode, **self.model_dump(exclude={"shape"}))


class NotchTable(NotchShape):
    """A variable notch with the parameters of its switching.

    Hysteresis, low-pass of the speed, slopes of the trapezoid.
    """

    hysteresis_rps: NotNegative = 0.15
    speed_lowpass_hz: Positive = 50.0
    ramp_rps: Positive = 1.0

    @model_validator(mode="after")
    def _is_a_filter(self) -> Self:
        if self.start_rps >= self.end_rps:
            raise ValueError(f"start_rps {self.start_rps} is not below end_rps {self.end_rps}")
        self.notch()
        return self


class Geometry(Table):
    """The planar chain that moves the tip in its vertical plane.

    Attributes:
        axes: Numbers of its three axes, from the base on: shoulder, elbow, wrist.
        shoulder_offset_m: From axis 1 to the shoulder, horizontally.
        shoulder_height_m: Height of the shoulder.
        upper_arm_m: From the shoulder to the elbow.
        forearm_m: From the elbow to the wrist, along and across.
        tool_m: From the wrist to the tip.
    """

    axes: tuple[AxisNumber, AxisNumber, AxisNumber] = (2, 3, 5)
    shoulder_offset_m: float
    shoulder_height_m: float
    upper_arm_m: Positive
    forearm_m: tuple[Positive, float]
    tool_m: Positive

    @model_validator(mode="after")
    def _three_axes(self) -> Self:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes {', '.join(map(str, self.axes))}: the chain needs three different axes")
        return self

    def check_axes(self, present: Collection[int], what: str) -> None:
        """Refuse a robot that lacks an axis of the chain.

        Raises:
            ValueError: An axis is missing; the message has the remedy.
        """
        if not set(self.axes) <= set(present):
            raise ValueError(
                f"{what} needs axes {', '.join(map(str, self.axes))}; the file has axes {', '.join(map(str, sorted(present)))}: "
                "put the numbers of shoulder, elbow and wrist into geometry, axes = [2, 3, 5]"
            )

    def chain(self) -> PlanarChain:
        """The arm for trajectories and the tip."""
        return PlanarChain(**self.model_dump(exclude={"axes"}))


class Point(Table):
    """A tip position in m; in the vertical plane y is 0."""

    x: float
    y: float = 0.0
    z: float


class LineMotion(Table):
    """The line motion of a planar chain or an arm.

    The start of a planar chain is the robot's home, where all motor angles are zero.

    Attributes:
        start_m: Place of the tip at the start.
        end_m: Place of the tip at the end.
        orientation: `kept`, or `free` for any axes of the tip. A planar chain's tool points down.
        start_rpy_deg: Roll, pitch and yaw of the tip's axes at the start; left out, those at home.
        end_rpy_deg: The same at the end; left out, those at the start.
        duration_s: Duration of the motion.
        ramp_s: Duration of its acceleration, and of its deceleration.
        dwell_s: Time of rest before it.
        tail_s: Time of rest after it.
    """

    start_m: Point
    end_m: Point
    orientation: Literal["kept", "free"] = "kept"
    start_rpy_deg: tuple[float, float, float] | None = None
    end_rpy_deg: tuple[float, float, float] | None = None
    duration_s: Positive
    ramp_s: Positive = 0.3
    dwell_s: NotNegative = 0.2
    tail_s: NotNegative = 0.6

    @model_validator(mode="after")
    def _ramps_fit(self) -> Self:
        Smooth(self.duration_s, self.ramp_s)
        if self.orientation == "free" and (self.start_rpy_deg or self.end_rpy_deg):
            raise ValueError('orientation = "free" excludes start_rpy_deg and end_rpy_deg; leave out one or the other')
        return self

    def check_planar(self) -> None:
        """Refuse a line that a planar chain has no axes for.

        Raises:
            ValueError: It leaves the vertical plane, or says how the tool is to point.
        """
        if self.start_m.y or self.end_m.y or self.orientation == "free" or self.start_rpy_deg or self.end_rpy_deg:
            raise ValueError(
                "a line with y, orientation, start_rpy_deg or end_rpy_deg needs an arm table; a geometry's chain moves its tip "
                "in a vertical plane, with its tool pointing down"
            )

    def line(self, chain: PlanarChain) -> Line:
        """The trajectory of the joints."""
        start, end = (self.start_m.x, self.start_m.z), (self.end_m.x, self.end_m.z)
        return Line(chain, start, end, Smooth(self.duration_s, self.ramp_s), self.dwell_s, self.tail_s)


class ConstantAccelerationMotion(Table):
    """The single-axis motion through the resonant speeds."""

    acceleration_rps_s: Positive
    end_rps: Positive
    deceleration_rps_s: Positive = 20.0
    dwell_s: NotNegative = 0.2
    tail_s: NotNegative = 0.5

    def trajectory(self) -> ConstantAcceleration:
        """The trajectory of the motor."""
        return ConstantAcceleration(**self.model_dump())


class PointToPointMotion(Table):
    """The move of one motor from rest to rest.

    The arm rings after it.
    """

    distance_rev: float
    speed_rps: Positive
    acceleration_rps_s: Positive
    dwell_s: NotNegative = 0.2
    tail_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.0

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        if abs(self.distance_rev) < LEAST_MOVE_REV:
            raise ValueError(f"distance_rev {self.distance_rev:g} is too short; expected at least {LEAST_MOVE_REV:g}")
        return self

    def trajectory(self) -> PointToPoint:
        """The trajectory of the motor."""
        return PointToPoint(**self.model_dump())
