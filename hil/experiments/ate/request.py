"""Request of an identification of the transmission error, and the knowledge of the axis that it starts from."""

from dataclasses import dataclass, field, replace

from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.design.ate_identification import JointEstimate
from hil.design.ate_model import Arm, Sensing
from hil.errors import NotPossibleError
from hil.experiments.ate.motion import end_speed
from hil.robot_tables import ORDERS, PlantTable

FITTED_ORDERS = ORDERS[1:]
"""Orders that are identified: those that a ramp through f_a/2 shows."""


@dataclass(frozen=True)
class Goal:
    """Standard errors at which the passes end: a quarter of what is asked of A_2 (2 %), φ_2 (2°), A_4 (3 %), φ_4 (3°).

    Attributes:
        amplitude_fraction: Standard error of A_k as a fraction of A_k, by order.
        phase_deg: Standard error of φ_k, by order.
    """

    amplitude_fraction: dict[float, float] = field(default_factory=lambda: {2: 0.02 / 4.0, 4: 0.03 / 4.0})
    phase_deg: dict[float, float] = field(default_factory=lambda: {2: 0.5, 4: 0.75})

    def missed(self, estimate: JointEstimate) -> list[str]:
        """Sentences on what is not known well enough; empty when the goal is reached."""
        missed = []
        for order in self.amplitude_fraction:
            error_pct = 100.0 * estimate.amplitude_error_arcsec[order] / max(estimate.error.amplitude_arcsec[order], 1e-30)
            goal_pct = 100.0 * self.amplitude_fraction[order]
            if error_pct > goal_pct:
                missed.append(f"A_{order} has a standard error of {error_pct:.2g} %, {goal_pct:.2g} % is asked")
            error_deg = estimate.phase_error_deg[order]
            if error_deg > self.phase_deg[order]:
                missed.append(f"φ_{order} has a standard error of {error_deg:.2g}°, {self.phase_deg[order]:.2g}° is asked")
        return missed


@dataclass(frozen=True)
class AteRequest:
    """Request of an identification of the transmission error.

    Attributes:
        axis: Axis number.
        acceleration_rps_s: Acceleration of the first pass; later ones are slower.
        passes: Largest number of passes.
        sensorless: Use motor torque and encoder only.
        goal: Standard errors at which the passes end.
    """

    axis: int
    acceleration_rps_s: float = 4.0
    passes: int = 6
    sensorless: bool = False
    goal: Goal = field(default_factory=Goal)


@dataclass(frozen=True)
class AxisKnowledge:
    """Knowledge of an axis before its transmission error is identified.

    Attributes:
        start: Arm from which the fit starts; None to search for it.
        plant: Plant for the sensorless variant.
        arm_inertia_fraction: Standard error of J_l as a fraction of J_l; 0 where J_l is only believed.
        source: Source of this knowledge, in words.
        resonance_error_hz: Standard error of the arm's resonance; None where it is not known.
        damping_error: Standard error of the arm's damping ratio, likewise.
    """

    start: Arm | None = None
    plant: PlantTable | None = None
    arm_inertia_fraction: float = 0.0
    source: str = "nothing"
    resonance_error_hz: float | None = None
    damping_error: float | None = None


def axis_knowledge(bench: Bench, axis: int, identified: Identified | None, *, sensorless: bool) -> AxisKnowledge:
    """Knowledge from the model file; the bench file's own model only serves the sensorless variant.

    Args:
        bench: The bench file.
        axis: Axis number.
        identified: The model file; None without one.
        sensorless: True for an identification by motor torque and encoder alone.

    Raises:
        NotPossibleError: The bench has no such axis, the model file is another robot's, or a plant is needed and there is none.
    """
    if axis not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {axis}; it has {', '.join(map(str, bench.axis))}")
    if identified is not None and identified.robot != bench.name:
        raise NotPossibleError(f"the model file is of {identified.robot!r}, this is {bench.name!r}: choose another")
    part_of = None if identified is None or axis not in identified.axis else identified.axis[axis].plant
    if part_of is not None:
        values = part_of.values
        total = values.gear_damping_nm_s_rad + values.arm_damping_nm_s_rad
        start = Arm(part_of.antiresonance_hz, part_of.damping)
        if total > 0.0:
            start = replace(start, gear_fraction=values.gear_damping_nm_s_rad / total)
        fraction = part_of.standard_error.get("arm_inertia_kg_m2", 0.0) / values.arm_inertia_kg_m2
        errors = part_of.standard_error
        return AxisKnowledge(start, values, fraction, "the model file", errors.get("antiresonance_hz"), errors.get("damping"))
    model = bench.axis[axis].model
    if not sensorless:
        return AxisKnowledge()
    if model is None:
        raise NotPossibleError(
            f"without an accelerometer J_l and J_m of axis {axis} are needed, and neither the model file nor the bench file has "
            "them: hil identify plant finds them"
        )
    return AxisKnowledge(None, PlantTable(**model.model_dump(exclude={"ate"})), 0.0, "the bench file")


def sensing_of(bench: Bench, axis: int, knowledge: AxisKnowledge, *, sensorless: bool) -> Sensing:
    """Signal that is fitted: the tip acceleration, or the motor torque without an accelerometer.

    Args:
        bench: The bench file.
        axis: Axis number.
        knowledge: Knowledge of the axis.
        sensorless: True for the motor torque.

    Raises:
        NotPossibleError: The motor torque needs a plant, and none is known.
    """
    table = bench.axis[axis]
    if not sensorless:
        return Sensing(table.tip_lever_m)
    if knowledge.plant is None:
        raise NotPossibleError("without an accelerometer a plant is needed")
    return Sensing(knowledge.plant.arm_inertia_kg_m2 / table.reduction_ratio, knowledge.plant.motor_inertia_kg_m2)


def first_end_speed(bench: Bench, request: AteRequest, knowledge: AxisKnowledge) -> float:
    """Largest motor speed of the first pass, rev/s.

    Raises:
        NotPossibleError: Limits keep it from passing f_m2.
    """
    if request.passes < 1:
        raise NotPossibleError(f"{request.passes} passes identify nothing; at least 1 is needed")
    arm_hz = None if knowledge.start is None else knowledge.start.resonance_hz
    return end_speed(bench, request.axis, request.acceleration_rps_s, arm_hz)
