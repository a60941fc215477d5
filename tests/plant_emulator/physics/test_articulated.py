"""Forward dynamics of rigid links against pinocchio and MuJoCo."""

import mujoco
import numpy as np
import pinocchio
import pytest

from hil.arm.tables import ArmTable
from hil.arm.urdf import with_links
from plant_emulator.physics.articulated import accelerations, along_z, holding_torques, link_rows
from plant_emulator.robots.robot import load_robot
from tests.hil.arm.arms import SIX_JOINTS, any_arm, planar_arm, six_axis_urdf, ur5e_urdf
from tests.hil.arm.oracles import mujoco_model, pinocchio_model

STATES = 2000


class Links:
    """An arm that is asked for its accelerations."""

    def __init__(self, arm):
        self.rows, self.joints = link_rows(arm, arm.axes), np.zeros((4, len(arm.link)))

    def accelerations(self, angles, speeds, torques):
        self.joints[0], self.joints[1], self.joints[2] = angles, speeds, torques
        accelerations(self.rows, self.joints)
        return self.joints[3].copy()


def random_states(count, states=STATES):
    rng = np.random.default_rng(7)
    return zip(*(rng.uniform(-reach, reach, (states, count)) for reach in (3.1, 4.0, 100.0)), strict=True)


def worst(arm, oracle, states=STATES):
    """The largest deviation from an oracle over random states, relative to the largest acceleration of each."""
    links, found = Links(arm), 0.0
    for angles, speeds, torques in random_states(len(arm.link), states):
        want = oracle(angles, speeds, torques)
        found = max(found, np.max(np.abs(links.accelerations(angles, speeds, torques) - want)) / np.max(np.abs(want)))
    return found


def of_pinocchio(model):
    data = model.createData()

    def answer(angles, speeds, torques):
        if model.nq > model.nv:  # a last joint without an end counts as cosine and sine
            angles = np.append(angles[:-1], (np.cos(angles[-1]), np.sin(angles[-1])))
        return pinocchio.aba(model, data, angles, speeds, torques)

    return answer


def of_mujoco(model):
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # the ends of the joints
    data = mujoco.MjData(model)

    def answer(angles, speeds, torques):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = angles, speeds, torques
        mujoco.mj_forward(model, data)
        return data.qacc

    return answer


ARMS = {"planar": planar_arm(), "ours": load_robot("reference-arm").links}


@pytest.mark.parametrize("name", ARMS)
def test_accelerations_are_those_of_pinocchio_and_of_mujoco(name):
    assert worst(ARMS[name], of_pinocchio(pinocchio_model(ARMS[name]))) < 1e-12
    assert worst(ARMS[name], of_mujoco(mujoco_model(ARMS[name])), 200) < 1e-10  # MuJoCo turns inertias to their axes by iteration


@pytest.mark.parametrize("text", [ur5e_urdf(), six_axis_urdf(3)], ids=["ur5e", "of all kinds"])
def test_accelerations_of_a_urdf_file_are_those_that_others_read_from_it(tmp_path, text):
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    arm, _ = with_links(ArmTable(urdf="arm.urdf"), tmp_path, SIX_JOINTS)
    assert worst(arm, of_pinocchio(pinocchio.buildModelFromXML(text))) < 1e-12
    assert worst(arm, of_mujoco(mujoco.MjModel.from_xml_string(text)), 200) < 1e-9


@pytest.mark.parametrize(("seed", "count"), [(1, 1), (2, 4), (3, 7), (4, 12)])
def test_any_number_of_axes_in_any_directions(seed, count):
    arm = any_arm(seed, count)
    assert worst(arm, of_pinocchio(pinocchio_model(arm)), 200) < 1e-11


def test_gravity_may_point_anywhere():
    arm = any_arm(5, 5).model_copy(update={"gravity_m_s2": (3.0, -4.0, 5.0)})
    assert worst(arm, of_pinocchio(pinocchio_model(arm)), 100) < 1e-12


def test_the_torques_that_hold_the_arm_leave_it_at_rest():
    for arm in ARMS.values():
        links, rng = Links(arm), np.random.default_rng(1)
        for _ in range(10):
            links.joints[0] = rng.uniform(-3.0, 3.0, len(arm.link))
            holding_torques(links.rows, links.joints)
            angles, torques = links.joints[0].copy(), links.joints[2].copy()
            np.testing.assert_allclose(links.accelerations(angles, 0.0, torques), 0.0, atol=1e-11)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.6, 0.0, -0.8), (1e-9, 0.0, -1.0)])
def test_a_frame_along_a_joint_is_a_rotation_with_it_as_z(direction):
    frame = along_z(np.array(direction))
    np.testing.assert_allclose(frame[:, 2], direction, atol=1e-12)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
