"""Arms drawn by seed.

Or they have the links of a URDF file, with drawn motors, gears and errors, which such a file lacks.

>>> from plant_emulator.robots.drawn_arms import draw_arm
>>> robot = draw_arm(7)
>>> robot == draw_arm(7), len(robot.arm.link)
(True, 6)
"""

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hil.arm.bodies import Body, Inertia
from hil.arm.masses import mass_matrix
from hil.arm.tables import ArmLink, ArmTable
from hil.arm.urdf import turning_joints, with_links
from plant_emulator.robots.fleet import CONTROL_PERIOD_S, RANGES, Draws, accelerometer, driven, rounded
from plant_emulator.robots.robot import SHIPPED, ArmAxis, ArmRobot, BusFacts, load_robot
from plant_emulator.trials.distributions import Distributions, Even, Logarithmic

ARM_RANGES: Distributions = {
    **RANGES,
    "length": Logarithmic(0.75, 1.35),  # factor of each length of the reference arm
    "mass": Logarithmic(0.6, 1.6),  # factor of each link's mass, beside which its inertia grows with the lengths
    "payload": Even(0.0, 10.0),  # kg
    "load offset": Even(0.0, 0.05),  # distance of its centre from the flange's axis, m
    "lean": Even(-20.0, 30.0),  # q_2 at home, degrees
    "bend": Even(-130.0, -80.0),  # q_3
    "turn": Even(-15.0, 15.0),  # q_1, q_4 and q_6; the tool points down, give or take as much
    "antiresonance_hz": Logarithmic(8.0, 20.0),  # √(K_g/H_ii)/2π at home, of axes 1 to 3
    "wrist_hz": Logarithmic(25.0, 60.0),  # the same of axes 4 to 6
}
"""Distribution of each drawn quantity."""
MOTOR_INERTIA_KG_M2 = (0.1e-4, 5e-4)
"""Limits of J_m, to which that ratio yields."""
WRIST = (4, 5, 6)


def draw_arm(seed: int) -> ArmRobot:
    """Draw an arm of six axes with linear gears.

    Equal arguments give equal arms.

    Raises:
        ValueError: The seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} is negative")
    draws = Draws(seed, ARM_RANGES, "arm ")
    arm = _links(draws)
    robot = _robot(f"arm-{seed}", seed, draws, _axes(seed, arm), arm)
    return robot.with_links_read(SHIPPED["reference-arm"].parent)


def draw_drives(
    urdf: str,
    folder: Path,
    home_deg: tuple[float, ...],
    seed: int,
    tip_link: str | None = None,
) -> ArmRobot:
    """Draw motors, linear gears and ATEs of a URDF file's arm.

    The arm's joints are axes 1, 2, … from the base on. The robot equals its file; `with_links_read` of it has the links.

    Args:
        folder: Folder from which the path counts.
        home_deg: Joint angles at which the motors are at zero, one each, or none: all 0.
        tip_link: Link whose frame is that of the tip; None: the only one at the arm's end.

    Raises:
        FileError: The file describes no arm; with line and element.
        ValueError: The seed is negative, or the home is not one of this arm.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} is negative")
    table = ArmTable(urdf=urdf, home_deg=home_deg, tip_link=tip_link)
    joints = {name: number for number, name in enumerate(turning_joints(folder / urdf), 1)}
    arm, ratios = with_links(table, folder, joints)
    axes = _axes(seed, arm, ratios)
    named = {number: axes[number].model_copy(update={"joint": name}) for name, number in joints.items()}
    return _robot(f"{Path(urdf).stem}-{seed}", seed, Draws(seed, ARM_RANGES, "arm "), named, table)


def _axes(seed: int, arm: ArmTable, ratios: Mapping[int, float] = MappingProxyType({})) -> dict[int, ArmAxis]:
    """Draw motor and gear of each joint; `ratios` are known."""
    inertias = np.diag(mass_matrix(arm, arm.home_rad())).tolist()
    return {
        link.axis: _axis(Draws(seed, ARM_RANGES, f"arm axis {link.axis} "), link.axis, inertia, weight, ratios.get(link.axis))
        for link, inertia, weight in zip(arm.link, inertias, _weights(arm), strict=True)
    }


def _robot(name: str, seed: int, draws: Draws, axes: dict[int, ArmAxis], arm: ArmTable) -> ArmRobot:
    return ArmRobot(
        name=name,
        seed=seed,
        control_period_s=CONTROL_PERIOD_S,
        sync_period_s=0.002,
        bus=BusFacts(bitrate=1_000_000),
        axis=axes,
        accelerometer=accelerometer(draws),
        arm=arm,
    )


def arm_facts(robot: ArmRobot) -> dict[str, float]:
    """Return mass, reach and resonances of an arm."""
    arm, home = robot.arm, robot.arm.home_rad()
    gears = np.diag([robot.axis[number].gear_stiffness_nm_rad for number in arm.axes])
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass_matrix(arm, home), gears)).real) / (2.0 * math.pi)
    load = 0.0 if arm.payload is None else arm.payload.mass_kg
    facts = {"mass_kg": sum(body.mass_kg for body in arm.bodies()) - load, "payload_kg": load}
    facts["reach_m"] = sum(math.hypot(*link.origin_m) for link in arm.link[2:]) + math.hypot(*arm.tip_m)
    return facts | {f"mode_{number}_hz": float(mode) for number, mode in enumerate(sorted(modes), 1)}


def _links(draws: Draws) -> ArmTable:
    """Draw the links: the reference arm's, scaled in length and mass."""
    model = load_robot("reference-arm").links
    assert model is not None  # noqa: S101 - it is an arm
    links, stretch = [], 1.0
    for link in model.link:
        before, stretch = stretch, draws(f"length {link.axis}", "length")
        links.append(_stretched(link, before, stretch, draws(f"mass {link.axis}", "mass")))
    lean, bend = draws("lean"), draws("bend")
    turns = [draws(f"turn {axis}", "turn") for axis in (1, 4, 5, 6)]
    # the tool points down where q₃ + q₅ − q₂ = −180°
    home = (turns[0], lean, bend, turns[1], rounded(lean - bend - 180.0 + turns[2]), turns[3])
    reach = rounded(stretch * model.tip_m[2])
    mass, away = draws("payload"), draws("load offset")
    load = Body(mass_kg=mass, centre_m=(away, 0.0, reach), inertia_kg_m2=_box(mass, 0.2)) if mass > 0.0 else None
    return model.model_copy(update={"link": tuple(links), "home_deg": home, "tip_m": (0.0, 0.0, reach), "payload": load})


def _stretched(link: ArmLink, before: float, own: float, heavier: float) -> ArmLink:
    """Scale a link in length and mass."""
    body = link.body or Body(mass_kg=0.0)
    mass, inertia = rounded(heavier * body.mass_kg), body.inertia_kg_m2
    size = heavier * own**2
    scaled = Inertia(xx=rounded(size * inertia.xx), yy=rounded(size * inertia.yy), zz=rounded(size * inertia.zz))
    centre = tuple(rounded(own * value) for value in body.centre_m)
    origin = tuple(rounded(before * value) for value in link.origin_m)
    whole = Body(mass_kg=mass, centre_m=(centre[0], centre[1], centre[2]), inertia_kg_m2=scaled)
    return link.model_copy(update={"origin_m": origin, "body": whole})


def _box(mass_kg: float, size_m: float) -> Inertia:
    moment = rounded(mass_kg * size_m**2 / 6.0)
    return Inertia(xx=moment, yy=moment, zz=moment)


def _weights(arm: ArmTable) -> list[float]:
    """Return each axis' greatest moment of gravity, all links stretched out level."""
    found, moment, mass = [], 0.0, 0.0
    for link, body in zip(reversed(arm.link), reversed(arm.bodies()), strict=True):
        moment += body.mass_kg * math.hypot(*body.centre_m)
        mass += body.mass_kg
        found.append(moment * math.hypot(*arm.gravity_m_s2))
        moment += mass * math.hypot(*link.origin_m)
    return found[::-1]


def _axis(draws: Draws, number: int, inertia: float, weight_nm: float, known_ratio: float | None = None) -> ArmAxis:
    """Draw motor and gear in proportion to an axis' inertia at home."""
    ratio = known_ratio or draws("reduction_ratio")
    low, high = MOTOR_INERTIA_KG_M2
    wanted = inertia / ratio**2 / draws("inertia_ratio")
    motor = rounded(min(high, max(low, wanted)))
    drive = driven(draws, ratio, motor, inertia, draws("antiresonance_hz", "wrist_hz" if number in WRIST else None))
    friction_nm = 3.0 * drive["static_friction_nm"]
    most_nm = rounded(9000.0 * (motor + 1.5 * inertia / ratio**2) + 1.2 * weight_nm / ratio + friction_nm)
    return ArmAxis(**drive, node_id=number, torque_limit_nm=most_nm)
