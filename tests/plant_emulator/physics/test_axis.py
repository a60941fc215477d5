"""The axis against linear system theory, scipy's integrators, and the conservation of energy."""

import math

import numpy as np
import pytest
from scipy import integrate, optimize, signal

from hil.control.angles import ARCSEC
from hil.design.frequency import TwoInertia
from plant_emulator.physics.axis import PLANT, PLANT_STATE, hang_at_rest, synchronous_error
from plant_emulator.robots.robot import load_robot
from tests.oracles.plant import derivatives, friction
from tests.oracles.records import plain
from tests.plant_emulator.physics.stepping import plant_step

ROBOT = load_robot("reference")
T = 250e-6
LINEAR = {"coulomb_friction_nm": 0.0, "static_friction_nm": 0.0, "gravity_moment_nm": 0.0}
NO_ATE = {"a1_rad": 0.0, "a2_rad": 0.0, "a4_rad": 0.0}
UNDAMPED = {"motor_damping_nm_s_rad": 0.0, "arm_damping_nm_s_rad": 0.0, "gear_damping_nm_s_rad": 0.0}
MORE = {
    "has_more_orders": 1.0,
    "more_orders": (3.0, 0.5, 6.25, 0.0),
    "more_rad": (80 * ARCSEC, 150 * ARCSEC, 40 * ARCSEC, 0.0),
    "more_phi_rad": (0.4, 2.0, -1.0, 0.0),
}
BIG_ATE = {"a1_rad": 100 * ARCSEC, "a2_rad": 300 * ARCSEC, "phi2_rad": 1.0, "a4_rad": 200 * ARCSEC, "gear_reaction": 1.0}


def friction_torque(p, speed):
    rise, stribeck = p["static_friction_nm"] - p["coulomb_friction_nm"], p["stribeck_velocity_rad_s"]
    return friction(p["coulomb_friction_nm"], rise, 1.0 / stribeck, speed)


class Axis:
    """One axis of the reference robot with some parameters changed."""

    def __init__(self, number=2, **changes):
        self.plant, self.state = np.zeros(1, PLANT), np.zeros(1, PLANT_STATE)
        ROBOT.axis[number].write(self.plant[0], ROBOT.home_angle(number))
        for name, value in changes.items():
            self.plant[0][name] = value

    def __getattr__(self, name):
        return float(self.__dict__["state"][0][name])

    def at(self, motor_angle_rad=0.0, motor_speed_rad_s=0.0, arm_angle_rad=0.0, arm_speed_rad_s=0.0):
        self.state[0] = (motor_angle_rad, motor_speed_rad_s, arm_angle_rad, arm_speed_rad_s, 0.0, 0.0, 0.0)
        return self

    def step(self, command=0.0, braked=False, period_s=T, substeps=4):
        plant_step(self.plant[0], self.state[0], command, braked, period_s, substeps)
        return self

    def run(self, commands, names=("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s"), **how):
        rows = []
        for command in commands:
            self.step(command, **how)
            rows.append([float(self.state[0][name]) for name in names])
        return np.array(rows)

    @property
    def torsion(self):
        p = self.plant[0]
        return self.motor_angle_rad / p["reduction_ratio"] + synchronous_error(p, self.motor_angle_rad)[0] - self.arm_angle_rad

    def torsion_rate(self):
        p = self.plant[0]
        slope = synchronous_error(p, self.motor_angle_rad)[1]
        return self.motor_speed_rad_s * (1.0 / p["reduction_ratio"] + slope) - self.arm_speed_rad_s

    def energy(self):
        """Kinetic energies, the gear's potential with the soft wind-up, gravity's potential."""
        p, psi = self.plant[0], self.torsion
        soft = p["wind_up_softness"] * p["wind_up_torsion_rad"] ** 2
        gear = 0.5 * p["gear_stiffness_nm_rad"] * psi**2
        if soft > 0.0:
            gear += 0.5 * p["gear_stiffness_nm_rad"] * soft * (math.exp(-((psi / p["wind_up_torsion_rad"]) ** 2)) - 1.0)
        return (
            0.5 * p["motor_inertia_kg_m2"] * self.motor_speed_rad_s**2
            + 0.5 * p["arm_inertia_kg_m2"] * self.arm_speed_rad_s**2
            + gear
            + p["gravity_moment_nm"] * math.sin(self.arm_angle_rad + p["home_angle_rad"])
        )

    def dissipation(self):
        """Power lost in bearings, friction and gear, W."""
        p = self.plant[0]
        return (
            p["motor_damping_nm_s_rad"] * self.motor_speed_rad_s**2
            + friction_torque(p, self.motor_speed_rad_s) * self.motor_speed_rad_s
            + p["arm_damping_nm_s_rad"] * self.arm_speed_rad_s**2
            + p["gear_damping_nm_s_rad"] * self.torsion_rate() ** 2
        )


def torques(count, seed=1, size=0.5):
    return size * np.random.default_rng(seed).standard_normal(count)


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 3, 5])
def test_the_linear_plant_is_the_state_space_of_the_design_discretised_by_scipy(number):
    axis = Axis(number, **LINEAR, **NO_ATE)
    names = TwoInertia.__dataclass_fields__
    plant = TwoInertia(**{name: float(axis.plant[0][name]) for name in names})
    a, b = plant.state_space()
    u = torques(4000)
    got = axis.run(u)
    _, _, want = signal.dlsim(signal.cont2discrete((a, b[:, None], np.eye(4), np.zeros((4, 1))), T), np.append(u, 0.0)[:, None])
    scale = np.array([1.0, 1.0, 1.0 / plant.reduction_ratio, 1.0 / plant.reduction_ratio])
    want = want[1:] * scale
    np.testing.assert_allclose(got, want, atol=1e-6 * np.max(np.abs(want)), rtol=1e-5)


@pytest.mark.slow
def test_the_transmission_error_shakes_the_arm_as_scipys_lsim_says():
    """The motor turns at a constant speed, so the arm is a linear system behind θ_m/N + θ_sync."""
    axis = Axis(2, **LINEAR, motor_inertia_kg_m2=1e7)  # nothing slows this motor down
    p = axis.plant[0]
    speed = 2.0 * math.pi * 5.0
    start = synchronous_error(p, 0.0)
    axis.at(0.0, speed, start[0], speed * (1.0 / 120.0 + start[1]))
    p["motor_damping_nm_s_rad"] = 0.0
    got = axis.run(np.zeros(20_000))[:, 2]
    t = T * np.arange(20_001)
    drive = np.array([speed * x / 120.0 + synchronous_error(p, speed * x)[0] for x in t])
    k, d = p["gear_stiffness_nm_rad"], p["gear_damping_nm_s_rad"]
    system = signal.TransferFunction([d, k], [p["arm_inertia_kg_m2"], d + p["arm_damping_nm_s_rad"], k])
    # lsim starts at rest at 0: go over to the deviation from the start
    ramp = speed / 120.0 * t
    _, vibration, _ = signal.lsim(system, drive - ramp - (drive - ramp)[0], t)
    _, along, _ = signal.lsim(system, ramp, t)
    rest = got - (vibration + along + start[0])[1:]
    # what is left is the free decay of the different start, gone at the end
    assert np.max(np.abs(rest[-1000:])) < 2e-3 * np.max(np.abs(vibration))


def everything(number=2):
    return Axis(number, **BIG_ATE, **MORE, wind_up_softness=0.4, wind_up_torsion_rad=60 * ARCSEC, current_time_constant_s=2e-3)


def by_hand(p, command):
    """The equations of `PHYSICS.md`, written down once more for scipy."""

    def rates(_, x):
        th, wm, tl, wl, tau = x
        n = p["reduction_ratio"]
        lines = [(k, p[f"a{k}_rad"], p[f"phi{k}_rad"]) for k in (1, 2, 4)]
        lines += zip(p["more_orders"], p["more_rad"], p["more_phi_rad"], strict=True)
        sync = sum(size * math.cos(k * th + phase) for k, size, phase in lines)
        slope = sum(-k * size * math.sin(k * th + phase) for k, size, phase in lines)
        psi, rate = th / n + sync - tl, wm / n + slope * wm - wl
        soft = 1.0 - p["wind_up_softness"] * math.exp(-((psi / p["wind_up_torsion_rad"]) ** 2))
        gear = p["gear_stiffness_nm_rad"] * soft * psi + p["gear_damping_nm_s_rad"] * rate
        level = p["coulomb_friction_nm"] + (p["static_friction_nm"] - p["coulomb_friction_nm"]) * math.exp(
            -((wm / p["stribeck_velocity_rad_s"]) ** 2)
        )
        friction = level * math.tanh(wm / 0.05)
        load = gear * (1.0 / n + p["gear_reaction"] * slope)
        gravity = p["gravity_moment_nm"] * math.cos(tl + p["home_angle_rad"])
        return [
            wm,
            (tau - p["motor_damping_nm_s_rad"] * wm - friction - load) / p["motor_inertia_kg_m2"],
            wl,
            (gear - p["arm_damping_nm_s_rad"] * wl - gravity) / p["arm_inertia_kg_m2"],
            (command - tau) / p["current_time_constant_s"],
        ]

    return rates


@pytest.mark.parametrize("speed", [0.0, 1e-4, -0.4, 3.0, -60.0, 377.0, 2000.0])
@pytest.mark.parametrize("angle", [0.0, 0.03125, -1.0, 400.0])
def test_the_short_polynomials_change_nothing_near_or_far(speed, angle):
    """One Runge-Kutta step with the library's sine, cosine and tanh; at 2000 rad/s the motor leaves the polynomials' range."""
    axis = everything().at(angle, speed, angle / 120.0 + 2e-4, speed / 120.0 - 1e-3)
    rates = by_hand({name: axis.plant[0][name].tolist() for name in PLANT.names}, 1.5)
    x = np.array([angle, speed, angle / 120.0 + 2e-4, speed / 120.0 - 1e-3, 0.0])
    k1 = np.array(rates(0.0, x))
    k2 = np.array(rates(0.0, x + 0.5 * T * k1))
    k3 = np.array(rates(0.0, x + 0.5 * T * k2))
    k4 = np.array(rates(0.0, x + T * k3))
    want = x + T / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    axis.step(1.5, substeps=1)
    got = [axis.motor_angle_rad, axis.motor_speed_rad_s, axis.arm_angle_rad, axis.arm_speed_rad_s, axis.torque_nm]
    np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-12)
    assert axis.arm_acceleration_rad_s2 == pytest.approx(rates(0.0, want)[3], rel=1e-8, abs=1e-7)


def test_with_every_nonlinearity_on_it_is_what_scipys_integrator_finds():
    axis = everything()
    p = {name: axis.plant[0][name].tolist() for name in PLANT.names}
    x = np.zeros(5)
    names = ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s", "torque_nm")
    # pieces of constant torque through standstill and both directions
    for command in (1.5, -2.0, 0.0, 3.0):
        solved = integrate.solve_ivp(by_hand(p, command), (0.0, 0.1), x, rtol=1e-9, atol=1e-11, method="LSODA")
        x = solved.y[:, -1]
        got = axis.run([command] * 400, names)[-1]
        np.testing.assert_allclose(got, x, rtol=1e-4, atol=1e-6)


def test_halving_the_substep_changes_next_to_nothing():
    commands = [*[1.5] * 400, *[-2.0] * 400, *[0.3] * 400]
    coarse, fine = everything().run(commands, substeps=4)[-1], everything().run(commands, substeps=8)[-1]
    # the friction's turn at standstill, 0.1 rad/s wide, is what is left
    np.testing.assert_allclose(coarse, fine, rtol=5e-4)


def test_the_error_falls_with_the_fourth_power_of_the_substep():
    def end(substeps):
        smooth = Axis(2, **LINEAR)
        return smooth.run([2.0] * 200, period_s=2e-3, substeps=substeps)[-1, 1]

    exact = end(64)
    assert (end(2) - exact) / (end(4) - exact) == pytest.approx(16.0, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("softness", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_energy_never_grows_without_input_when_the_gear_loads_the_motor_too(seed, softness):
    rng = np.random.default_rng(seed)
    for changes in (NO_ATE, BIG_ATE):
        axis = Axis(2, **{"gear_reaction": 1.0, **changes}, wind_up_softness=softness, gravity_moment_nm=52.0 * (seed % 2))
        axis.at(*rng.uniform(-1.0, 1.0, 4) * [10.0, 40.0, 0.002, 0.3])
        energies = [axis.energy()]
        for _ in range(4000):
            axis.step()
            energies.append(axis.energy())
        swing = max(energies) - min(energies)
        assert np.max(np.diff(energies)) < 1e-7 * swing
        assert energies[-1] < energies[0] - 0.3 * swing  # and it does get less


def balance(axis, commands, dt=40e-6):
    """Work put in, minus what was stored and lost, over the work; Simpson would be finer, the trapezoid is enough."""
    energy, work, lost = axis.energy(), 0.0, 0.0
    loss = axis.dissipation()
    for command in commands:
        speed = axis.motor_speed_rad_s
        axis.step(command, period_s=dt, substeps=1)
        work += command * 0.5 * (speed + axis.motor_speed_rad_s) * dt
        loss, before = axis.dissipation(), loss
        lost += 0.5 * (loss + before) * dt
    return (work - (axis.energy() - energy) - lost) / abs(work)


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize("softness", [0.0, 0.5])
def test_the_work_put_in_is_stored_or_lost_when_the_gear_loads_the_motor_too(number, softness):
    t = np.arange(12_000) * 40e-6
    commands = 1.0 + 0.8 * np.sin(2.0 * math.pi * 9.0 * t)
    axis = Axis(number, **BIG_ATE, wind_up_softness=softness)
    hang_at_rest(axis.plant[0], axis.state[0])
    assert abs(balance(axis, commands)) < 1e-4
    # the paper's block diagram, without that load, makes energy out of the transmission error
    paper = Axis(number, **{**BIG_ATE, "gear_reaction": 0.0}, wind_up_softness=softness)
    hang_at_rest(paper.plant[0], paper.state[0])
    assert abs(balance(paper, commands)) > 1e-3


def test_friction_is_odd_and_bounded_and_opposes_the_motion():
    p = Axis(2).plant[0]
    speeds = np.concatenate([np.geomspace(1e-6, 100.0, 300), [0.0]])
    forward = np.array([friction_torque(p, w) for w in speeds])
    backward = np.array([friction_torque(p, -w) for w in speeds])
    np.testing.assert_array_equal(backward, -forward)
    assert np.all(forward[:-1] > 0.0)
    assert forward[-1] == 0.0
    assert np.max(forward) <= p["static_friction_nm"]
    assert friction_torque(p, 100.0) == pytest.approx(p["coulomb_friction_nm"])
    assert np.max(forward) > p["coulomb_friction_nm"]  # the Stribeck peak


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_slope_of_the_transmission_error_is_its_derivative(order):
    p = Axis(2, **{**NO_ATE, f"a{order}_rad": 7 * ARCSEC, f"phi{order}_rad": 0.7}).plant[0]
    for theta in np.linspace(-7.0, 7.0, 29):
        value, slope = synchronous_error(p, theta)
        assert value == pytest.approx(7 * ARCSEC * math.cos(order * theta + 0.7), abs=1e-15)
        h = 1e-5
        numeric = (synchronous_error(p, theta + h)[0] - synchronous_error(p, theta - h)[0]) / (2 * h)
        assert slope == pytest.approx(numeric, abs=1e-9)


@pytest.mark.ci
def test_the_hysteresis_torque_follows_dahls_exponential():
    """Loading from zero at a constant torsion rate: z = F (1 − exp(−ψ/ψ_h))."""
    axis = Axis(2, **LINEAR, **NO_ATE, hysteresis_torque_nm=3.0, hysteresis_torsion_rad=20 * ARCSEC)
    dt, rate = 1e-5, 1e-3
    axis.at(arm_speed_rad_s=-rate)
    p, s = axis.plant[0], axis.state[0]
    for _ in range(20_000):
        s["hysteresis_nm"] += dt * derivatives(plain(p), plain(s), 0.0, True)[2]
    z = axis.hysteresis_nm
    assert z == pytest.approx(3.0 * (1.0 - math.exp(-0.2 * rate / (20 * ARCSEC))), rel=1e-3)


@pytest.mark.slow
def test_a_hysteresis_loop_dissipates_and_stays_within_its_torque():
    def swing(hysteresis):
        axis = Axis(2, **LINEAR, **NO_ATE, **UNDAMPED, hysteresis_torque_nm=hysteresis, hysteresis_torsion_rad=20 * ARCSEC)
        axis.at(arm_angle_rad=4e-4)
        rows = axis.run([0.0] * 8000, ("arm_angle_rad", "hysteresis_nm", "arm_speed_rad_s"), braked=True)
        # ∮ z dψ: what the loop takes out
        return rows, float(np.sum(rows[:, 1] * -rows[:, 2]) * T)

    free, nothing = swing(0.0)
    held, lost = swing(2.0)
    assert nothing == 0.0
    assert np.max(np.abs(free[-1000:, 0])) == pytest.approx(4e-4, rel=1e-3)
    assert np.max(np.abs(held[-1000:, 0])) < 0.5 * 4e-4
    assert np.max(np.abs(held[:, 1])) <= 2.0 * (1.0 + 1e-6)
    before = 0.5 * 48950.0 * 4e-4**2
    assert 0.5 * before < lost <= 1.02 * before


@pytest.mark.slow
def test_the_gear_is_softer_around_zero_torsion():
    """Small swings with the motor held: √(1 − r) of the frequency; large ones: the full stiffness."""
    for size, share in ((1e-6, 0.6), (0.05, 1.0)):
        axis = Axis(2, **LINEAR, **NO_ATE, **UNDAMPED, wind_up_softness=0.4, wind_up_torsion_rad=60 * ARCSEC)
        arm = axis.at(arm_angle_rad=size).run([0.0] * 8000, braked=True)[:, 2]
        crossings = np.flatnonzero((arm[:-1] < 0.0) & (arm[1:] >= 0.0))
        frequency = (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * T)
        assert frequency == pytest.approx(math.sqrt(share * 48950.0 / 8.0) / (2.0 * math.pi), rel=3e-3)


def test_the_current_loop_lags_by_its_time_constant():
    axis = Axis(2, current_time_constant_s=2e-3)
    got = axis.run([1.2] * 80, ("torque_nm",))[:, 0]
    t = T * np.arange(1, 81)
    np.testing.assert_allclose(got, 1.2 * (1.0 - np.exp(-t / 2e-3)), rtol=1e-7)
    assert Axis(2).step(1.2).torque_nm == 1.2


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 3, 5])
def test_the_brake_holds_the_motor_whatever_the_torque_while_the_arm_swings_on_the_gear(number):
    axis = Axis(number, **NO_ATE, gravity_moment_nm=0.0, arm_damping_nm_s_rad=0.0, gear_damping_nm_s_rad=0.0)
    axis.at(motor_angle_rad=3.0, motor_speed_rad_s=50.0, arm_angle_rad=3.0 / axis.plant[0]["reduction_ratio"] + 1e-4)
    rows = axis.run([5.0] * 8000, braked=True)
    assert np.all(rows[:, 0] == 3.0)
    assert np.all(rows[:, 1] == 0.0)
    arm = rows[:, 2] - 3.0 / axis.plant[0]["reduction_ratio"]
    t = T * np.arange(1, 8001)
    natural = math.sqrt(axis.plant[0]["gear_stiffness_nm_rad"] / axis.plant[0]["arm_inertia_kg_m2"])
    np.testing.assert_allclose(arm, 1e-4 * np.cos(natural * t), atol=2e-3 * 1e-4)


@pytest.mark.parametrize("number", [2, 3, 5])
@pytest.mark.parametrize("softness", [0.0, 0.6])
def test_an_axis_settles_where_gravity_and_gear_are_in_balance_and_stays_there(number, softness):
    axis = Axis(number, wind_up_softness=softness, wind_up_torsion_rad=60 * ARCSEC).at(motor_angle_rad=30.0)
    hang_at_rest(axis.plant[0], axis.state[0])
    p = axis.plant[0]
    rigid = 30.0 / p["reduction_ratio"] + synchronous_error(p, 30.0)[0]

    def unbalanced(arm):
        psi = rigid - arm
        stiffness = p["gear_stiffness_nm_rad"] * (1.0 - softness * math.exp(-((psi / (60 * ARCSEC)) ** 2)))
        return stiffness * psi - p["gravity_moment_nm"] * math.cos(arm + p["home_angle_rad"])

    assert axis.arm_angle_rad == pytest.approx(optimize.brentq(unbalanced, rigid - 0.1, rigid + 0.1, xtol=1e-15), abs=1e-12)
    rows = axis.run([0.0] * 400, ("arm_angle_rad", "arm_acceleration_rad_s2"), braked=True)
    assert np.ptp(rows[:, 0]) < 1e-12
    assert np.max(np.abs(rows[:, 1])) < 1e-6


def test_the_reported_arm_acceleration_is_the_second_derivative_of_the_arm_angle():
    axis = Axis(2)
    rows = axis.run(
        1.0 + 0.5 * np.sin(0.02 * np.arange(4000)), ("arm_angle_rad", "arm_acceleration_rad_s2"), period_s=1e-4, substeps=1
    )
    numeric = np.diff(rows[:, 0], 2) / 1e-8
    np.testing.assert_allclose(numeric, rows[1:-1, 1], atol=2e-3 * np.max(np.abs(rows[:, 1])))
