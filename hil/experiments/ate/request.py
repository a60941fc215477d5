"""Request of an identification of the transmission error."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hil.bench.bench import Bench
from hil.bench.model import SIGNIFICANT_SIGMAS, Identified, IdentifiedPlant, identified_axis
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import DELAY_S, Arm, OtherMode, Sensing
from hil.design.ate.reaction import MotorSide
from hil.design.estimation import FAR_SIGMAS
from hil.errors import NotPossibleError
from hil.experiments.ate.ramp import Ramp, RampLimits, resonance_ramp
from hil.robot_tables import ORDERS, PlantTable

FITTED_ORDERS = ORDERS
"""Orders that are identified unless others are asked for."""
AMPLITUDE_FRACTION, PHASE_DEG = 0.0075, 0.75
"""Bound: standard errors that are asked of orders for which a goal names none: a quarter of 3 % and 3°."""
WEAK = 0.5
"""Amplitudes below this fraction of the largest are held to the absolute accuracy of that fraction: they matter less."""
NEARLY = 3.0
"""Bound: standard errors up to so many times what is asked are a result, with a note: three quarters of the required accuracy."""
GEAR_FRACTION_AT_MOST = 0.15
"""Standard error of A_k e^{jφ_k}, as a fraction and in rad, that is a result where the gear is not a spring and more passes would
not lower it: the trial decides."""


@dataclass(frozen=True)
class Miss:
    """Value that is less accurate than requested.

    Attributes:
        name: Its name, `A_2` or `φ_2`.
        over: Its standard error over the one asked for.
    """

    name: str
    order: float
    sentence: str
    over: float
    is_usable: bool


@dataclass(frozen=True)
class Goal:
    """Standard errors at which the passes end.

    They are a quarter of the accuracy required of A_2 (2 %), φ_2 (2°), A_4 (3 %) and φ_4 (3°).

    Attributes:
        amplitude_fraction: Standard error of A_k as a fraction of A_k, by order; `AMPLITUDE_FRACTION` for others.
        phase_deg: Standard error of φ_k, by order; `PHASE_DEG` for others.
    """

    amplitude_fraction: dict[float, float] = field(default_factory=lambda: {2: 0.02 / 4.0, 4: 0.03 / 4.0})
    phase_deg: dict[float, float] = field(default_factory=lambda: {2: 0.5, 4: 0.75})

    def missed(self, estimate: JointEstimate) -> list[Miss]:
        """List the values that miss the goal; empty if it is reached.

        The phase of an amplitude that is no larger than its error is not asked for.
        """
        missed = []
        largest, is_gears = max(estimate.error.amplitude_arcsec.values()), not estimate.is_spring
        for order, amplitude in estimate.error.amplitude_arcsec.items():
            size = max(amplitude, WEAK * largest, 1e-30)
            error, goal = estimate.amplitude_error_arcsec[order] / size, self.amplitude_fraction.get(order, AMPLITUDE_FRACTION)
            if error > goal:
                name = f"A_{order:g}"
                words = f"{name} has a standard error of {100.0 * error:.2g} %; the goal is {100.0 * goal:.2g} %"
                words += f" of {size:.2g}″" if size > amplitude else ""
                most = GEAR_FRACTION_AT_MOST if is_gears else NEARLY * goal
                missed.append(Miss(name, order, words, error / goal, error <= most))
            error_deg, goal_deg = estimate.phase_error_deg[order] * amplitude / size, self.phase_deg.get(order, PHASE_DEG)
            if error_deg > goal_deg and is_seen(estimate, order):
                asked_deg = goal_deg * size / max(amplitude, 1e-30)
                name = f"φ_{order:g}"
                words = f"{name} has a standard error of {estimate.phase_error_deg[order]:.2g}°; the goal is {asked_deg:.2g}°"
                most = math.degrees(GEAR_FRACTION_AT_MOST) if is_gears else NEARLY * goal_deg
                missed.append(Miss(name, order, words, error_deg / goal_deg, error_deg <= most))
        return missed


def is_seen(estimate: JointEstimate, order: float) -> bool:
    """True if an order's amplitude is more than its error."""
    return estimate.error.amplitude_arcsec[order] > SIGNIFICANT_SIGMAS * estimate.amplitude_error_arcsec[order]


@dataclass(frozen=True)
class AteRequest:
    """Request of an identification of the transmission error.

    Attributes:
        acceleration_rps_s: Acceleration of the first pass, later ones are slower; None: chosen from f_a.
        sensorless: Use motor torque and encoder only.
        goal: Standard errors at which the passes end.
    """

    axis: int
    acceleration_rps_s: float | None = None
    passes: int = 6
    sensorless: bool = False
    goal: Goal = field(default_factory=Goal)
    orders: tuple[float, ...] = FITTED_ORDERS


GEAR_FRACTION_ERROR = 0.15
"""Bound: standard error of the gear's fraction of the arm's damping, where only `GEAR_FRACTION` is known: 0.6 to 1."""


@dataclass(frozen=True)
class AxisKnowledge:
    """Knowledge of an axis before its transmission error is identified.

    Attributes:
        start: Arm from which the fit starts; None to search for it.
        plant: Plant for the sensorless variant.
        arm_inertia_fraction: Standard error of J_l as a fraction of J_l, on which A_k depends without an accelerometer; 0 with
            one, and if the error of J_l is not known.
        resonance_error_hz: Standard error of the arm's resonance; None if it is not known.
        damping_error: Standard error of the arm's damping ratio, likewise.
        gear_fraction_error: Standard error of the gear's fraction of the arm's damping.
        side: Identified motor and arm, from which the gear's reaction on the motor follows; None without them.
        delay_s: Delays of the accelerometer that are searched, from and to.
        arm_inertia: J_l in kg·m² and its standard error; None if they are not known.
    """

    start: Arm | None = None
    plant: PlantTable | None = None
    arm_inertia_fraction: float = 0.0
    source: str = "nothing"
    resonance_error_hz: float | None = None
    damping_error: float | None = None
    gear_fraction_error: float = GEAR_FRACTION_ERROR
    side: MotorSide | None = None
    delay_s: tuple[float, float] = DELAY_S
    arm_inertia: tuple[float, float] | None = None


def axis_knowledge(bench: Bench, axis: int, identified: Identified | None, *, sensorless: bool) -> AxisKnowledge:
    """Collect what the model file knows of an axis.

    The bench file's own model serves the sensorless variant only.

    Raises:
        NotPossibleError: The bench has no such axis, the model file is another robot's, or a plant is needed and there is none.
    """
    bench.check_axis(axis)
    if identified is not None:
        identified.check_robot(bench.name)
    part_of = identified_axis(identified, axis).plant
    if part_of is not None:
        values = part_of.values
        total = values.gear_damping_nm_s_rad + values.arm_damping_nm_s_rad
        start = Arm(part_of.antiresonance_hz, part_of.damping, others=_other_modes(part_of))
        if total > 0.0:
            start = replace(start, gear_fraction=values.gear_damping_nm_s_rad / total)
        errors = part_of.standard_error
        inertia_error = errors.get("arm_inertia_kg_m2")
        fraction = (inertia_error or 0.0) / values.arm_inertia_kg_m2 if sensorless else 0.0
        side = MotorSide(
            bench.axis[axis].reduction_ratio, values.motor_inertia_kg_m2, values.motor_damping_nm_s_rad,
            part_of.coulomb_friction_nm or 0.0, part_of.torque_lag_s, values.arm_inertia_kg_m2, part_of.antiresonance_hz,
            part_of.damping,
        )  # fmt: skip
        return AxisKnowledge(
            start, values, fraction, "the model file", errors.get("antiresonance_hz"), errors.get("damping"),
            _gear_fraction_error(total, errors), side,
            searched_delay_s(part_of), None if inertia_error is None else (values.arm_inertia_kg_m2, inertia_error),
        )  # fmt: skip
    model = bench.axis[axis].model
    if not sensorless:
        return AxisKnowledge()
    if model is None:
        raise NotPossibleError(
            f"without an accelerometer, axis {axis} needs J_l and J_m, which neither the model file nor the bench file has; "
            "hil identify plant finds them"
        )
    return AxisKnowledge(None, PlantTable(**model.model_dump(exclude={"ate"})), 0.0, "the bench file")


def _other_modes(plant: IdentifiedPlant) -> tuple[OtherMode, ...]:
    """Modes beside the leading one with a known part of the tip's motion."""
    leading = min((abs(mode.antiresonance_hz - plant.antiresonance_hz) for mode in plant.modes), default=0.0)
    return tuple(
        OtherMode(mode.antiresonance_hz, mode.damping, mode.tip_part)
        for mode in plant.modes
        if mode.tip_part is not None and abs(mode.antiresonance_hz - plant.antiresonance_hz) > leading
    )


def modal_arm(plant: IdentifiedPlant) -> Arm | None:
    """Leading mode of a coupled arm with the others, or None."""
    others = _other_modes(plant)
    return Arm(plant.antiresonance_hz, plant.damping, others=others) if others else None


def searched_delay_s(plant: IdentifiedPlant | None) -> tuple[float, float]:
    """Range of the accelerometer's delay that is searched.

    A delay of half a period of the resonance less, with φ_k turned by 180°, explains the arm's ringing nearly as well: what tells
    both apart is its envelope and the motor's own motion. The plant's excitation has many frequencies: there the delay
    is a slope of the phase.
    """
    delay_s = None if plant is None else plant.accelerometer_delay_s
    if plant is None or delay_s is None:
        return DELAY_S
    reach_s = min(0.25 / plant.antiresonance_hz, -DELAY_S[0])
    low, high = max(DELAY_S[0], delay_s - reach_s), min(DELAY_S[1], delay_s + reach_s)
    is_told = FAR_SIGMAS * plant.standard_error.get("accelerometer_delay_s", math.inf) < 0.5 * reach_s
    return (low, high) if is_told and low < delay_s < high else DELAY_S


def _gear_fraction_error(damping_nm_s_rad: float, errors: Mapping[str, float]) -> float:
    """Standard error of D_g/(D_g + D_l), at most that of a number between 0 and 1 of which nothing else is known."""
    error = errors.get("arm_damping_nm_s_rad")
    if error is None or not damping_nm_s_rad > 0.0:
        return GEAR_FRACTION_ERROR
    return min(error / damping_nm_s_rad, 1.0 / math.sqrt(12.0))


def sensing_of(bench: Bench, axis: int, knowledge: AxisKnowledge, *, sensorless: bool) -> Sensing:
    """Choose the fitted signal: tip acceleration, or motor torque without an accelerometer.

    Raises:
        NotPossibleError: The motor torque needs a plant, and none is known; or the axis does not move the accelerometer.
    """
    table = bench.axis[axis]
    if not sensorless:
        return Sensing(table.felt_lever_m(f"identify ate --axis {axis}"), 0.0, *knowledge.delay_s)
    if knowledge.plant is None:
        raise NotPossibleError("without an accelerometer a plant is needed, and none is known; find it with hil identify plant")
    return Sensing(knowledge.plant.arm_inertia_kg_m2 / table.reduction_ratio, knowledge.plant.motor_inertia_kg_m2)


def first_ramp(bench: Bench, request: AteRequest, knowledge: AxisKnowledge) -> Ramp:
    """Plan the first pass with the requested acceleration, or a suitable one.

    Raises:
        NotPossibleError: There is no pass, or limits keep it from passing f_m2.
        UnsafeRequestError: The requested acceleration is beyond its limit.
    """
    if request.passes < 1:
        raise NotPossibleError(f"{request.passes} passes identify nothing; at least 1 is needed")
    limits, asked = RampLimits.of(bench, request.axis), request.acceleration_rps_s
    arm_hz = None if knowledge.start is None else knowledge.start.resonance_hz
    if asked is not None:
        return resonance_ramp(limits, arm_hz, asked, is_raised=False).beyond(arm_hz)
    is_raised = limits.is_arm or arm_hz is not None
    return resonance_ramp(limits, arm_hz, limits.suited(arm_hz), is_raised=is_raised).beyond(arm_hz)
