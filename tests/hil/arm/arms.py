"""Arms for tests: a planar one, any by seed, and URDF files: one of all kinds of elements, and the UR5e."""

import numpy as np

from hil.arm.bodies import Body, Inertia
from hil.arm.tables import ArmLink, ArmTable

SIX_JOINTS = {f"joint_{i}": i for i in range(1, 7)}


def body(rng, mass_kg):
    """A body of any shape: the inertia of seven points of mass in a box."""
    points, weights = rng.uniform(-0.15, 0.15, (7, 3)), rng.uniform(0.2, 1.0, 7)
    weights *= mass_kg / weights.sum()
    centre = weights @ points
    away = points - centre
    tensor = sum(w * (a @ a * np.eye(3) - np.outer(a, a)) for w, a in zip(weights, away, strict=True))
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    inertia = Inertia(**{name: float(tensor[at]) for name, at in names.items()})
    return Body(mass_kg=mass_kg, centre_m=tuple(centre.tolist()), inertia_kg_m2=inertia)


def any_arm(seed, count):
    """Links in any place and direction, some of them without a mass, and a payload."""
    rng = np.random.default_rng(seed)
    links = [
        ArmLink(
            axis=i + 1,
            origin_m=tuple(rng.uniform(-0.4, 0.4, 3).tolist()),
            rpy_deg=tuple(rng.uniform(-180.0, 180.0, 3).tolist()),
            direction=tuple(rng.standard_normal(3).tolist()),
            body=None if i == 2 and count > 3 else body(rng, float(rng.uniform(1.0, 15.0))),
        )
        for i in range(count)
    ]
    home = tuple(rng.uniform(-90.0, 90.0, count).tolist())
    return ArmTable(link=tuple(links), tip_m=(0.1, -0.05, 0.2), payload=body(rng, 5.0), home_deg=home)


def link_xml(name, given, turn="0 0 0"):
    """A link of a URDF file; without a body it has no <inertial>."""
    if given is None:
        return f'<link name="{name}"/>'
    x, y, z = given.centre_m
    i = given.inertia_kg_m2
    return f"""<link name="{name}"><inertial><origin xyz="{x!r} {y!r} {z!r}" rpy="{turn}"/><mass value="{given.mass_kg!r}"/>
  <inertia ixx="{i.xx!r}" ixy="{i.xy!r}" ixz="{i.xz!r}" iyy="{i.yy!r}" iyz="{i.yz!r}" izz="{i.zz!r}"/></inertial></link>"""


def joint_xml(name, kind, parent, child, xyz="0 0 0", rpy="0 0 0", axis="0 0 1", inside=""):
    """A joint of a URDF file."""
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{inside}</joint>"""


LIMIT = '<limit lower="-3.0" upper="3.0" velocity="2.5" effort="150"/>'


def six_axis_urdf(seed=5):
    """A six-axis arm as makers publish theirs: fixed flange and tool frames, a weightless base, tilted frames, a transmission."""
    rng = np.random.default_rng(seed)
    lines = ['<?xml version="1.0"?><robot name="six"><link name="world"/>', link_xml("base_link", body(rng, 4.0))]
    lines.append(joint_xml("on_floor", "fixed", "world", "base_link", "0 0 0.1"))
    parent = "base_link"
    for i in range(1, 7):
        xyz = " ".join(repr(float(value)) for value in rng.uniform(-0.35, 0.35, 3))
        rpy = " ".join(repr(float(value)) for value in rng.choice([0.0, 1.5707963, -1.5707963, 0.3], 3))
        axis = ("0 0 1", "0 1 0", "0 -1 0", "1 0 0", "0 1 0", "0.6 0 0.8")[i - 1]
        kind = "continuous" if i == 6 else "revolute"
        lines.append(link_xml(f"link_{i}", body(rng, 12.0 / i), "0.1 -0.2 0.3"))
        lines.append(joint_xml(f"joint_{i}", kind, parent, f"link_{i}", xyz, rpy, axis, "" if i == 6 else LIMIT))
        parent = f"link_{i}"
    lines += [link_xml("flange", None), link_xml("gripper", body(rng, 1.5)), link_xml("tool0", None)]
    lines.append(joint_xml("to_flange", "fixed", "link_6", "flange", "0 0 0.05", "0 1.5707963267948966 0"))
    lines.append(joint_xml("to_gripper", "fixed", "flange", "gripper", "0.02 0 0", "0.2 0 0.4"))
    lines.append(joint_xml("to_tool", "fixed", "gripper", "tool0", "0.1 0 0"))
    lines.append(
        '<transmission name="drive_2"><type>simple</type><joint name="joint_2"/><actuator name="m2">'
        "<mechanicalReduction>-120</mechanicalReduction></actuator></transmission></robot>"
    )
    return "\n".join(lines)


UR5E = (  # a in m, d in m, alpha in rad, mass in kg, centre of mass in m, in the frame of Denavit and Hartenberg behind the joint
    (0.0, 0.1625, 0.5 * np.pi, 3.761, (0.0, -0.02561, 0.00193)),
    (-0.425, 0.0, 0.0, 8.058, (0.2125, 0.0, 0.11336)),
    (-0.3922, 0.0, 0.0, 2.846, (0.15, 0.0, 0.0265)),
    (0.0, 0.1333, 0.5 * np.pi, 1.37, (0.0, -0.0018, 0.01634)),
    (0.0, 0.0997, -0.5 * np.pi, 1.3, (0.0, 0.0018, 0.01634)),
    (0.0, 0.0996, 0.0, 0.365, (0.0, 0.0, -0.001159)),
)
"""The UR5e. Source: Universal Robots, DH Parameters for calculations of kinematics and dynamics."""


def ur5e_urdf():
    """A URDF file of the UR5e from its published parameters; inertias, which are not published, are those of cylinders."""
    lines, place = ['<robot name="ur5e"><link name="base"/>'], ("0 0 0", "0 0 0")
    for i, (a, d, alpha, mass, (x, y, z)) in enumerate(UR5E, 1):
        sin, cos = np.sin(alpha), np.cos(alpha)
        centre = f"{a + x!r} {float(cos * y - sin * z)!r} {float(d + sin * y + cos * z)!r}"
        along, across = mass * (3 * 0.06**2 + max(abs(a), 0.12) ** 2) / 12, 0.5 * mass * 0.06**2
        lines.append(
            f'<link name="link_{i}"><inertial><origin xyz="{centre}" rpy="{alpha!r} 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{along}" iyz="0" izz="{along}"/></inertial></link>'
        )
        parent = "base" if i == 1 else f"link_{i - 1}"
        lines.append(joint_xml(f"joint_{i}", "revolute", parent, f"link_{i}", *place, "0 0 1", LIMIT))
        place = (f"{a!r} 0 {d!r}", f"{alpha!r} 0 0")
    return "\n".join([*lines, "</robot>"])


def planar_arm():
    """Three links in a vertical plane, at home where the reference robot begins its line, with its inertias there.

    An upper arm of 15 kg, a forearm of 12 kg, a wrist of 1 kg and a load of 7 kg at the tip; q_2 = 9.28° leans forwards.
    """
    upper = Body(mass_kg=15.0, centre_m=(0.0, 0.0, 0.215), inertia_kg_m2=Inertia(xx=2.82, yy=2.81531257, zz=0.15))
    fore = Body(mass_kg=12.0, centre_m=(-0.02, 0.0, 0.18), inertia_kg_m2=Inertia(xx=0.45, yy=0.47165502, zz=0.1))
    wrist = Body(mass_kg=1.0, centre_m=(0.0, 0.0, 0.05), inertia_kg_m2=Inertia(xx=0.01, yy=0.0092, zz=0.01))
    load = Body(mass_kg=7.0, centre_m=(0.0, 0.0, 0.13), inertia_kg_m2=Inertia(xx=0.03, yy=0.03, zz=0.02))
    links = (
        ArmLink(axis=2, origin_m=(0.05, 0.0, 0.33), direction=(0.0, 1.0, 0.0), body=upper),
        ArmLink(axis=3, origin_m=(0.0, 0.0, 0.44), direction=(0.0, -1.0, 0.0), body=fore),
        ArmLink(axis=5, origin_m=(-0.035, 0.0, 0.42), direction=(0.0, -1.0, 0.0), body=wrist),
    )
    home = (9.27929847, -111.40694283, -59.31375869)
    return ArmTable(link=links, tip_m=(0.0, 0.0, 0.13), payload=load, home_deg=home)
