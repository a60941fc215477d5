"""A whole flexible arm: the emulator's own, and its equations written down once more for scipy, with pinocchio for the links."""

import math
from pathlib import Path

import numpy as np
import pinocchio
from scipy import integrate

from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import BRAKED, TORQUE
from plant_emulator.physics.axis import PLANT
from plant_emulator.robots.robot import OF_THE_LINKS, ArmAxis, ArmRobot, load_robot
from tests.hil.arm.arms import any_arm, planar_arm
from tests.hil.arm.oracles import pinocchio_model

NAMES = ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s", "hysteresis_nm", "torque_nm")
FREE = {"coulomb_friction_nm": 0.0, "static_friction_nm": 0.0, "motor_damping_nm_s_rad": 0.0}
UNDAMPED = {**FREE, "arm_damping_nm_s_rad": 0.0, "gear_damping_nm_s_rad": 0.0}


def changed(robot, **changes):
    """The robot with some keys of every axis changed."""
    axes = {number: axis.model_copy(update={"torque_limit_nm": 1e3, **changes}) for number, axis in robot.axis.items()}
    return robot.model_copy(update={"axis": axes})


def six_axes(**changes):
    return changed(load_robot("reference-arm"), **changes)


def planar(**changes):
    """Axes 2, 3 and 5 of the reference robot on the planar arm."""
    axes = {
        number: ArmAxis(**{key: value for key, value in dict(axis).items() if key not in OF_THE_LINKS})
        for number, axis in load_robot("reference").axis.items()
    }
    return changed(ArmRobot(axis=axes, arm=planar_arm()).with_links_read(Path()), **changes)


def seven_axes(**changes):
    """Seven axes in any directions, the third link without a mass; all with the joint of axis 2 of the reference arm."""
    arm, model = any_arm(3, 7), load_robot("reference-arm").axis[2]
    keys = {key: value for key, value in dict(model).items() if key not in (*OF_THE_LINKS, "node_id")}
    robot = ArmRobot(axis={number: ArmAxis(**keys) for number in arm.axes}, arm=arm)
    return changed(robot.with_links_read(Path()), **changes)


class FlexibleArm:
    """Axes that take a torque each, none of them with a drive in between."""

    def __init__(self, robot, braked=()):
        self.axes = Axes(robot)
        self.order = [self.axes.row(number) for number in robot.links.axes]
        for number in robot.axis:
            self.axes.open_brake(self.axes.row(number), BRAKED if number in braked else TORQUE)

    @property
    def state(self):
        """Shape (n, 6), from the base on."""
        rows = self.axes.plant_state[self.order]
        return np.array([rows[name] for name in NAMES]).T

    def put(self, state):
        for row, values in zip(self.order, state, strict=True):
            for name, value in zip(NAMES, values, strict=True):
                self.axes.plant_state[row][name] = value

    def run(self, torques, periods):
        for row, torque in zip(self.order, torques, strict=True):
            self.axes.motion[row]["target_torque_nm"] = torque
        self.axes.advance(periods)
        return self.state


class Oracle:
    """The equations of docs/theory.md for an arm."""

    def __init__(self, robot, braked=()):
        axes = Axes(robot)
        self.model = pinocchio_model(robot.links)
        self.data, self.home = self.model.createData(), robot.links.home_rad()
        rows = [axes.plant[axes.row(number)] for number in robot.links.axes]
        self.p = {name: np.array([row[name] for row in rows]) for name in PLANT.names}
        self.free = np.array([0.0 if number in braked else 1.0 for number in robot.links.axes])

    def gears(self, th, wm, tl, wl, z):
        """Torque of each gear, its torsion and torsion rate, and the slope of the transmission error."""
        p = self.p
        sync, slope = np.zeros_like(th), np.zeros_like(th)
        for k in (1, 2, 4):
            turned = k * th + p[f"phi{k}_rad"]
            sync += p[f"a{k}_rad"] * np.cos(turned)
            slope -= k * p[f"a{k}_rad"] * np.sin(turned)
        for i in range(p["joint_orders"].shape[1]):  # m q of the joint, q = θ_m/N
            turned = p["joint_orders"][:, i] * th + p["joint_phi_rad"][:, i]
            sync += p["joint_rad"][:, i] * np.cos(turned)
            slope -= p["joint_orders"][:, i] * p["joint_rad"][:, i] * np.sin(turned)
        psi = th / p["reduction_ratio"] + sync - tl
        rate = wm * (1.0 / p["reduction_ratio"] + slope) - wl
        soft = 1.0 - p["wind_up_softness"] * np.exp(-((psi / p["wind_up_torsion_rad"]) ** 2))
        return p["gear_stiffness_nm_rad"] * soft * psi + z + p["gear_damping_nm_s_rad"] * rate, psi, rate, slope

    def rates(self, command, x):
        th, wm, tl, wl, z, tau = x.reshape(-1, 6).T
        p = self.p
        gear, _, rate, slope = self.gears(th, wm, tl, wl, z)
        level = p["coulomb_friction_nm"] + (p["static_friction_nm"] - p["coulomb_friction_nm"]) * np.exp(
            -((wm / p["stribeck_velocity_rad_s"]) ** 2)
        )
        lost = p["motor_damping_nm_s_rad"] * wm + level * np.tanh(wm / 0.05)
        lag = p["current_time_constant_s"]
        torque = np.where(lag > 0.0, tau, command)
        torque = torque + np.sum(p["cogging_nm"] * np.cos(p["cogging_orders"] * th[:, None] + p["cogging_phi_rad"]), axis=1)
        motor = (torque - lost - gear * (1.0 / p["reduction_ratio"] + p["gear_reaction"] * slope)) / p["motor_inertia_kg_m2"]
        links = pinocchio.aba(self.model, self.data, self.home + tl, wl, gear - p["arm_damping_nm_s_rad"] * wl)
        wound = np.zeros_like(z)
        has = p["hysteresis_torque_nm"] > 0.0
        share = p["hysteresis_torque_nm"] - np.sign(rate) * z
        wound[has] = (rate / p["hysteresis_torsion_rad"] * share)[has]
        current = np.where(lag > 0.0, (command - tau) / np.where(lag > 0.0, lag, 1.0), 0.0)
        return np.array([wm * self.free, motor * self.free, wl, links, wound, current * self.free]).T.ravel()

    def run(self, state, torques, duration_s, tolerance=1e-13):
        solved = integrate.solve_ivp(
            lambda _, x: self.rates(np.asarray(torques), x),
            (0.0, duration_s),
            state.ravel(),
            "DOP853",
            rtol=tolerance,
            atol=1e-14,
        )
        return solved.y[:, -1].reshape(-1, 6)

    def energy(self, state):
        """Kinetic energy of motors and links, the springs' and gravity's potential."""
        th, wm, tl, wl, z, _ = state.T
        p = self.p
        _, psi, _, _ = self.gears(th, wm, tl, wl, z)
        soft = p["wind_up_softness"] * p["wind_up_torsion_rad"] ** 2
        springs = 0.5 * p["gear_stiffness_nm_rad"] * (psi**2 + soft * (np.exp(-((psi / p["wind_up_torsion_rad"]) ** 2)) - 1.0))
        rotors = 0.5 * p["motor_inertia_kg_m2"] * wm**2
        q = self.home + tl
        kinetic = pinocchio.computeKineticEnergy(self.model, self.data, q, wl)
        return kinetic + pinocchio.computePotentialEnergy(self.model, self.data, q) + math.fsum(springs + rotors)
