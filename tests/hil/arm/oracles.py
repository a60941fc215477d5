"""The same arms for pinocchio and for MuJoCo."""

import mujoco
import numpy as np
import pinocchio
from scipy.spatial.transform import Rotation


def pinocchio_model(arm):
    """A model of pinocchio, joint by joint from the tables."""
    model, parent = pinocchio.Model(), 0
    for link, body in zip(arm.link, arm.bodies(), strict=True):
        joint = pinocchio.JointModelRevoluteUnaligned(link.unit_direction())
        place = pinocchio.SE3(link.rotation(), np.array(link.origin_m))
        parent = model.addJoint(parent, joint, place, str(link.axis))
        inertia = pinocchio.Inertia(body.mass_kg, np.array(body.centre_m), body.inertia_kg_m2.tensor())
        model.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
    model.gravity.linear = np.array(arm.gravity_m_s2)
    return model


def mujoco_model(arm):
    """A model of MuJoCo, written as its own kind of file."""
    lines, ends = [], []
    for link, body in zip(arm.link, arm.bodies(), strict=True):
        x, y, z, w = Rotation.from_matrix(link.rotation()).as_quat()
        i = body.inertia_kg_m2
        lines.append(
            f'<body pos="{words(link.origin_m)}" quat="{words((w, x, y, z))}">'
            f'<joint type="hinge" axis="{words(link.unit_direction())}"/>'
            f'<inertial pos="{words(body.centre_m)}" mass="{body.mass_kg!r}" '
            f'fullinertia="{words((i.xx, i.yy, i.zz, i.xy, i.xz, i.yz))}"/>'
        )
        ends.append("</body>")
    inside = "".join(lines + ends)
    option = f'<option gravity="{words(arm.gravity_m_s2)}"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{inside}</worldbody></mujoco>")


def words(values):
    return " ".join(repr(float(value)) for value in values)


def acceleration(arm, angles, speeds, rates, of=None):
    """J q̈ + J̇ q̇ of a point in the base frame, without gravity; shape (..., 3).

    α_i = α_{i−1} + z_i q̈_i + ω_{i−1} × z_i q̇_i, a = Σ α_i × r_i + ω_i × (ω_i × r_i) over the links' vectors r_i.
    """
    of = arm.tip if of is None else of
    rotations, origins = arm.links(angles)
    point, _ = arm.pose(angles, of)
    directions = np.einsum("...ijk,ik->...ij", rotations, arm.axes)
    rate, change, found = np.zeros_like(point), np.zeros_like(point), np.zeros_like(point)
    for i in range(of.link):
        own = directions[..., i, :] * np.asarray(speeds)[..., i, np.newaxis]
        change = change + directions[..., i, :] * np.asarray(rates)[..., i, np.newaxis] + np.cross(rate, own)
        rate = rate + own
        vector = (point if i + 1 == of.link else origins[..., i + 1, :]) - origins[..., i, :]
        found = found + np.cross(change, vector) + np.cross(rate, np.cross(rate, vector))
    return found
