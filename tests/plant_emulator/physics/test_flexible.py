"""An arm on elastic joints: against scipy's adaptive integrator, the conservation of energy, and its linearised model."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh

from hil.arm.bodies import Body, Inertia
from hil.arm.masses import mass_matrix
from hil.arm.tables import ArmLink, ArmTable
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.robot import ArmAxis, ArmRobot, load_robot
from tests.oracles.links import gravity_torques
from tests.plant_emulator.physics.flexible_rig import FREE, UNDAMPED, FlexibleArm, Oracle, changed, planar, seven_axes, six_axes
from tests.plant_emulator.physics.stepping import plant_step

T = 250e-6
EVERYTHING = {
    "gear_reaction": True, "wind_up_softness": 0.3, "wind_up_torsion_arcsec": 60.0, "current_time_constant_s": 1e-3,
    "hysteresis_torque_nm": 2.0,
}  # fmt: skip
TORQUES = (2.0, -1.5, 0.3, 0.2, 0.1, -0.2, 0.1)
MAKES = {"planar": planar, "six axes": six_axes, "seven of any kind": seven_axes}


def run_beside_scipy(robot, speeds=0.0, periods=400, braked=()):
    """States of the emulator and of scipy's integrator after the same torques."""
    arm, oracle = FlexibleArm(robot, braked), Oracle(robot, braked)
    start = arm.state
    start[:, 1] = speeds * oracle.free
    start[:, 3] = start[:, 1] / oracle.p["reduction_ratio"]
    arm.put(start)
    torques = TORQUES[: len(start)]
    return arm.run(torques, periods), oracle.run(start, torques, periods * T)


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKES.values(), ids=MAKES)
def test_the_whole_arm_is_what_an_adaptive_integrator_finds(make):
    got, want = run_beside_scipy(make(**FREE))
    assert np.max(np.abs(want[:, 2])) > 0.09  # rad: it has left its posture
    np.testing.assert_allclose(got[:, 2], want[:, 2], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(got[:, 0], want[:, 0], rtol=0.0, atol=1e-8)


@pytest.mark.ci
def test_so_it_is_with_one_axis_braked_whose_motor_stands_while_its_link_swings():
    got, want = run_beside_scipy(six_axes(**FREE), braked=(3, 5))
    np.testing.assert_allclose(got[:, :4], want[:, :4], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(got[:, 2], want[:, 2], rtol=0.0, atol=1e-10)
    assert got[2, 0] == got[4, 0] == 0.0
    assert abs(got[2, 3]) > 0.01


@pytest.mark.slow
def test_so_it_is_with_friction_hysteresis_reaction_soft_gears_and_a_slow_current():
    """Friction turns round within 0.1 rad/s: only small steps follow it there to so many digits."""
    robot = six_axes(**EVERYTHING).model_copy(update={"plant_substeps": 64})
    got, want = run_beside_scipy(robot, speeds=np.array([40.0, -40.0, 40.0, -40.0, 40.0, 40.0]), periods=200)
    np.testing.assert_allclose(got[:, 2], want[:, 2], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(got[:, 4:], want[:, 4:], rtol=0.0, atol=1e-6)


def test_the_error_falls_with_the_fourth_power_of_the_substep():
    errors = []
    for substeps in (4, 8):
        got, want = run_beside_scipy(six_axes(**FREE).model_copy(update={"plant_substeps": substeps}), periods=200)
        errors.append(np.max(np.abs(got[:, 2] - want[:, 2])))
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)


@pytest.mark.parametrize(("seconds", "braked"), [(10, (1, 2, 3, 4, 5, 6)), pytest.param(60, (), marks=pytest.mark.slow)])
def test_without_friction_energy_stays(seconds, braked):
    """Braked, the arm rings on its gears; free, it falls and swings while its motors spin, with the gears' reaction on them."""
    robot = six_axes(**UNDAMPED, gear_reaction=True)
    arm, oracle = FlexibleArm(robot, braked), Oracle(robot, braked)
    rest = arm.state
    arm.put(rest + np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    stored = oracle.energy(arm.state) - oracle.energy(rest) if braked else 100.0
    before = oracle.energy(arm.state)
    after = [oracle.energy(arm.run(np.zeros(6), 4000)) for _ in range(seconds)]
    assert np.max(np.abs(np.array(after) - before)) < 1e-6 * seconds / 60.0 * stored


def linear(robot, angles, with_motors):
    """Inertias and stiffnesses of small motions around a posture: links, and before them the motors, where these are free."""
    arm = robot.links
    inertia, count = mass_matrix(arm, angles), len(angles)
    step = 1e-5
    gravity = [(gravity_torques(arm, angles + d) - gravity_torques(arm, angles - d)) / (2.0 * step) for d in step * np.eye(count)]
    axes = [robot.axis[number] for number in arm.axes]
    gears = np.array([axis.gear_stiffness_nm_rad for axis in axes])
    ratios = np.array([axis.reduction_ratio for axis in axes])
    links = np.diag(gears) + np.array(gravity).T
    if not with_motors:
        return inertia, links
    rotors = np.diag([axis.motor_inertia_kg_m2 for axis in axes])
    across = np.diag(gears / ratios)
    nothing = np.zeros((count, count))
    return (
        np.block([[rotors, nothing], [nothing, inertia]]),
        np.block([[np.diag(gears / ratios**2), -across], [-across, links]]),
    )


@pytest.mark.slow
@pytest.mark.parametrize("with_motors", [False, True])
@pytest.mark.parametrize("make", [planar, six_axes])
def test_it_rings_at_the_frequencies_of_its_linearised_model(make, with_motors):
    robot = make(**UNDAMPED, ate=load_robot("reference").axis[2].ate.of({}, {}))
    probe = FlexibleArm(robot)
    rest, home = probe.state, robot.links.home_rad()
    axes = [robot.axis[number] for number in robot.links.axes]
    ratios = np.array([axis.reduction_ratio for axis in axes])
    holding = gravity_torques(robot.links, home + rest[:, 2]) / ratios
    squares, shapes = eigh(*reversed(linear(robot, home + rest[:, 2], with_motors)))
    count = len(rest)
    duration_s, periods = 1.0, 4000
    for square, shape in list(zip(squares, shapes.T, strict=True))[count if with_motors else 0 :]:  # the others fall
        small = 1e-6 * shape / np.max(np.abs(shape[-count:]))
        ends = []
        for sign in (1.0, -1.0):  # half their difference knows no centrifugal force, nor how far from balance the rest is
            arm = FlexibleArm(robot, () if with_motors else tuple(robot.axis))
            start = rest.copy()
            start[:, 2] += sign * small[-count:]
            if with_motors:
                start[:, 0] += sign * small[:count]
            arm.put(start)
            ends.append(arm.run(holding, periods)[:, 2])
        want = small[-count:] * math.cos(math.sqrt(square) * duration_s)
        np.testing.assert_allclose(0.5 * (ends[0] - ends[1]), want, rtol=0.0, atol=1e-4 * 1e-6)  # after 10 to 100 turns


def test_an_arm_of_one_link_is_an_axis_by_itself():
    reference = load_robot("reference")
    own = reference.axis[2].model_copy(update={"hysteresis_torque_nm": 3.0, "gear_reaction": True})
    body = Body(mass_kg=10.0, centre_m=(0.5, 0.0, 0.0), inertia_kg_m2=Inertia(xx=0.1, yy=1.5, zz=1.5))
    link = ArmLink(axis=2, origin_m=(0.3, 0.1, 0.2), direction=(0.0, -2.0, 0.0), body=body)
    table = ArmTable(link=(link,), home_deg=(20.0,))
    keys = {
        key: value
        for key, value in dict(own).items()
        if key not in ("arm_inertia_kg_m2", "gravity_moment_nm", "home_deg", "tip_lever_m")
    }
    arm = FlexibleArm(changed(ArmRobot(axis={2: ArmAxis(**keys)}, arm=table)))
    alone = own.model_copy(
        update={"arm_inertia_kg_m2": 1.5 + 10.0 * 0.25, "gravity_moment_nm": 10.0 * 0.5 * 9.81, "home_deg": 20.0}
    )
    axes = Axes(reference.model_copy(update={"axis": {2: alone}, "geometry": None, "line_motion": None}))
    plant, state = axes.plant.copy(), axes.plant_state.copy()
    np.testing.assert_allclose(arm.state[0, 2], state[0]["arm_angle_rad"], atol=1e-15)
    for command in (1.0, -2.0, 0.5):
        got = arm.run([command], 400)[0]
        for _ in range(400):
            plant_step(plant[0], state[0], command, False, T, 4)
        np.testing.assert_allclose(got, [state[0][name] for name in state.dtype.names[:6]], rtol=1e-9, atol=1e-11)


def test_a_run_in_many_pieces_gives_the_bits_of_a_run_in_one():
    whole, pieces = FlexibleArm(six_axes(**EVERYTHING)), FlexibleArm(six_axes(**EVERYTHING))
    whole.run(TORQUES[:6], 64)
    for _ in range(16):
        pieces.run(TORQUES[:6], 4)
    assert whole.axes.rows["plant_state"].tobytes() == pieces.axes.rows["plant_state"].tobytes()


def test_braked_it_hangs_at_rest():
    robot = six_axes(**EVERYTHING)
    arm = FlexibleArm(robot, tuple(robot.axis))
    before = arm.state
    after = arm.run(np.zeros(6), 400)
    np.testing.assert_allclose(after, before, atol=1e-12)
    gears = Oracle(robot).gears(*before.T[:5])[0]
    np.testing.assert_allclose(gears, gravity_torques(robot.links, robot.links.home_rad() + before[:, 2]), atol=1e-9)
