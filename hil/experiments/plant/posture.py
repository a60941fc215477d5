"""Postures of an arm in which a plant is identified."""

import math
from collections.abc import Mapping

from hil.bench.bench import Bench
from hil.bench.model import IdentifiedMode, IdentifiedPlant, IdentifiedPosture
from hil.errors import NotPossibleError
from hil.experiments.move import way_of
from hil.master.session import Session

THERE_DEG = 0.01
"""Accuracy: turn of a joint that is no way."""


def check_posture(bench: Bench, posture_deg: Mapping[int, float]) -> None:
    """Refuse a posture that the bench does not allow.

    The bench has no arm or no such axis, or a joint would leave its range.

    Raises:
        NotPossibleError: It is one of these.
    """
    if not posture_deg:
        return
    if bench.arm is None:
        raise NotPossibleError(
            f"bench {bench.name!r} has no [arm], and a single axis has one plant in all postures; leave --posture-deg out"
        )
    for number, angle in posture_deg.items():
        bench.check_axis(number)
        link = bench.arm.link[bench.arm.axes.index(number)]
        low, high = link.range_deg or (-math.inf, math.inf)
        if not low <= angle <= high:
            raise NotPossibleError(f"{link.label} at {angle:g}° is outside of its range_deg, {low:g} to {high:g}")


def joint_deg(bench: Bench, number: int, motor_rad: float) -> float:
    """Convert a motor angle to the angle of its joint.

    Raises:
        ValueError: The bench has no arm.
    """
    if bench.arm is None:
        raise ValueError(f"bench {bench.name!r} has no arm")
    home_rad = float(bench.arm.home_rad()[bench.arm.axes.index(number)])
    return math.degrees(home_rad + motor_rad / bench.axis[number].reduction_ratio)


def standing_deg(session: Session) -> dict[int, float]:
    """Present angles of all joints of the arm, by axis."""
    arm = session.bench.arm
    numbers = () if arm is None else arm.axes
    return {number: joint_deg(session.bench, number, session.axes[number].position_rad()) for number in numbers}


def bring_to(session: Session, posture_deg: Mapping[int, float]) -> None:
    """Turn joints one after the other, and leave them there.

    Args:
        session: The session, with all drives at rest.
        posture_deg: Angles of joints, by axis; the others stay.

    Raises:
        UnsafeRequestError: A joint would leave its limits.
        SafetyStopError: The way was stopped.
    """
    bench = session.bench
    for number, wanted in posture_deg.items():
        way_deg = wanted - standing_deg(session)[number]
        if abs(way_deg) < THERE_DEG:
            continue
        way_rad = math.radians(way_deg) * bench.axis[number].reduction_ratio
        most_rps_s = bench.axis[number].limits.acceleration_rps_s
        motion = way_of(number, way_rad, bench.approach_rps, bench.bus.sync_period_s, most_rps_s)
        result = session.run(motion, "none", "drive")
        if result.stopped is not None:
            raise result.stopped


def felt_posture(plant: IdentifiedPlant, joints_deg: Mapping[int, float]) -> IdentifiedPosture:
    """Entry of the modes that a motor shows in a posture.

    For a plant with a single mode it has that one.

    Args:
        joints_deg: Joint angles by axis, from the base on, the own one in the middle of its travel.
    """
    modes = plant.modes
    if not modes:
        names = ("antiresonance_hz", "resonance_hz", "damping")
        errors = {name: plant.standard_error[name] for name in names if name in plant.standard_error}
        errors["inertia_kg_m2"] = plant.standard_error.get("arm_inertia_kg_m2", 0.0)
        modes = (
            IdentifiedMode(
                antiresonance_hz=plant.antiresonance_hz, resonance_hz=plant.resonance_hz, damping=plant.damping,
                inertia_kg_m2=plant.values.arm_inertia_kg_m2, standard_error=errors,
            ),
        )  # fmt: skip
    joints = tuple(round(angle, 4) for angle in joints_deg.values())
    return IdentifiedPosture(joints_deg=joints, mode=modes, emulated=plant.emulated)
