"""The closed loop in plain Python, floats and lists: what one writes first, and what general solvers call."""

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import apart
from plant_emulator.motion.axes import Axes

Real = NDArray[np.float64]
Rates = Callable[[float, float, float, float, float], tuple[float, float]]


def _axis(axes: Axes, row: int) -> Rates:
    """θ̈_m and θ̈_l of one axis; `plant_emulator.physics.axis.derivatives` without the options that are off."""
    p = {name: float(axes.plant[row][name]) for name in axes.plant.dtype.names or () if not axes.plant.dtype[name].shape}
    n, a1, a2, a4 = p["reduction_ratio"], p["a1_rad"], p["a2_rad"], p["a4_rad"]
    phi1, phi2, phi4 = p["phi1_rad"], p["phi2_rad"], p["phi4_rad"]
    coulomb, rise, stribeck = (
        p["coulomb_friction_nm"],
        p["static_friction_nm"] - p["coulomb_friction_nm"],
        p["stribeck_velocity_rad_s"],
    )
    stiffness, damping, gravity, home = (
        p["gear_stiffness_nm_rad"],
        p["gear_damping_nm_s_rad"],
        p["gravity_moment_nm"],
        p["home_angle_rad"],
    )
    inertia_m, damping_m = p["motor_inertia_kg_m2"], p["motor_damping_nm_s_rad"]
    inertia_l, damping_l, reaction = p["arm_inertia_kg_m2"], p["arm_damping_nm_s_rad"], p["gear_reaction"]

    def rates(torque: float, th: float, wm: float, tl: float, wl: float) -> tuple[float, float]:
        x1, x2, x4 = th + phi1, 2.0 * th + phi2, 4.0 * th + phi4
        sync = a1 * math.cos(x1) + a2 * math.cos(x2) + a4 * math.cos(x4)
        slope = -a1 * math.sin(x1) - 2.0 * a2 * math.sin(x2) - 4.0 * a4 * math.sin(x4)
        gear = stiffness * (th / n + sync - tl) + damping * (wm / n + slope * wm - wl)
        ratio = wm / stribeck
        friction = (coulomb + rise * math.exp(-ratio * ratio)) * math.tanh(wm / 0.05)
        motor = (torque - damping_m * wm - friction - gear * (1.0 / n + reaction * slope)) / inertia_m
        return motor, (gear - damping_l * wl - gravity * math.cos(tl + home)) / inertia_l

    return rates


def rates(axes: Axes) -> Callable[[Real, Real], Real]:
    """dx/dt of all axes for a general solver; x is θ_m, ω_m, θ_l, ω_l of each in turn."""
    each = [_axis(axes, row) for row in range(len(axes.numbers))]

    def found(state: Real, torque: Real) -> Real:
        x, out = state.tolist(), np.empty(len(state))
        for row, of in enumerate(each):
            th, wm, tl, wl = x[4 * row : 4 * row + 4]
            a, b = of(float(torque[row]), th, wm, tl, wl)
            out[4 * row : 4 * row + 4] = wm, a, wl, b
        return out

    return found


def _runge_kutta(rates: Rates, torque: float, x: list[float], period: float, substeps: int) -> None:
    th, wm, tl, wl = x
    h = period / substeps
    half, sixth = 0.5 * h, h / 6.0
    for _ in range(substeps):
        a1, b1 = rates(torque, th, wm, tl, wl)
        wm2, wl2 = wm + half * a1, wl + half * b1
        a2, b2 = rates(torque, th + half * wm, wm2, tl + half * wl, wl2)
        wm3, wl3 = wm + half * a2, wl + half * b2
        a3, b3 = rates(torque, th + half * wm2, wm3, tl + half * wl2, wl3)
        wm4, wl4 = wm + h * a3, wl + h * b3
        a4, b4 = rates(torque, th + h * wm3, wm4, tl + h * wl3, wl4)
        th += sixth * (wm + 2.0 * (wm2 + wm3) + wm4)
        tl += sixth * (wl + 2.0 * (wl2 + wl3) + wl4)
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
    x[:] = th, wm, tl, wl


class Law:
    """The servo law of one axis with its notches off; `hil.control.servo.servo_step`."""

    def __init__(self, axes: Axes, row: int) -> None:
        gains, period = axes.cascade_config[row], axes.robot.control_period_s
        self.kpp, self.kvp, self.kvi, corner = (float(gains[name]) for name in gains.dtype.names or ())
        self.limit, self.half = float(axes.motion[row]["torque_limit_nm"]), 0.5 * period
        c, w = 2.0 / period, 2.0 * math.pi * corner
        self.keep, self.take = (c - w) / (c + w), w * c / (c + w)
        self.angle = self.speed = self.error = self.integral = 0.0

    def __call__(self, position: float, angle: float) -> float:
        """One sample: torque in N·m."""
        self.speed = self.keep * self.speed + self.take * (angle - self.angle)
        self.angle = angle
        error, before = self.kpp * (position - angle) - self.speed, self.integral
        self.integral += self.kvi * self.half * (error + self.error)
        self.error = error
        wanted = self.kvp * error + self.integral
        torque = min(self.limit, max(-self.limit, wanted))
        if torque != wanted and (wanted - torque) * error > 0.0:
            self.integral = before
        return torque


def _states(axes: Axes) -> list[list[float]]:
    return [
        [float(row[name]) for name in ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s")]
        for row in axes.plant_state
    ]


def _put_back(axes: Axes, states: list[list[float]]) -> None:
    for row, state in zip(axes.plant_state, states, strict=True):
        for name, value in zip(("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s"), state, strict=True):
            row[name] = value


def follow(axes: Axes, wanted: Real) -> None:
    """Set-point by set-point, everything in Python."""
    laws = [Law(axes, row) for row in range(len(axes.numbers))]
    plants = [_axis(axes, row) for row in range(len(axes.numbers))]
    states, scales = _states(axes), axes.motion["counts_per_rad"].tolist()
    period, substeps, periods = (
        axes.robot.control_period_s,
        axes.robot.plant_substeps,
        int(axes.motion[0]["periods_per_set_point"]),
    )
    before = [0.0] * len(laws)
    for target in wanted.tolist():
        for number in range(1, periods + 1):
            fraction = number / periods
            for row, (law, rates_of, x) in enumerate(zip(laws, plants, states, strict=True)):
                scale = scales[row]
                angle = math.floor(x[0] * scale + 0.5) / scale
                torque = law((before[row] + (target[row] - before[row]) * fraction) / scale, angle)
                _runge_kutta(rates_of, torque, x, period, substeps)
        before = target
    _put_back(axes, states)


def follow_with(axes: Axes, wanted: Real, step: Callable[[Real, Real, float], Real]) -> None:
    """The same law in Python, the plant by a general solver, one control period per call."""
    laws = [Law(axes, row) for row in range(len(axes.numbers))]
    scales = axes.motion["counts_per_rad"].tolist()
    periods = int(axes.motion[0]["periods_per_set_point"])
    state, before = np.array(_states(axes)).ravel(), [0.0] * len(laws)
    for target in wanted.tolist():
        for number in range(1, periods + 1):
            torque = np.empty(len(laws))
            for row, (law, scale) in enumerate(zip(laws, scales, strict=True)):
                angle = math.floor(float(state[4 * row]) * scale + 0.5) / scale
                torque[row] = law((before[row] + (target[row] - before[row]) * number / periods) / scale, angle)
            state = step(state, torque, axes.robot.control_period_s)
        before = target
    _put_back(axes, state.reshape(-1, 4).tolist())


def measure(axes: Axes, wanted: Real) -> float:
    """Seconds that `follow` takes."""
    begin = time.perf_counter()
    follow(axes, wanted)
    return time.perf_counter() - begin


def agreement(mine: Axes, theirs: Axes, wanted: Real) -> float:
    """The largest difference between the arm angles at the end, relative to their way."""
    start = theirs.plant_state["arm_angle_rad"].copy()
    follow(mine, wanted)
    for row in wanted:
        theirs.motion["previous_counts"] = theirs.motion["target_counts"]
        theirs.motion["target_counts"], theirs.motion["elapsed_periods"] = row, 0
        theirs.advance(int(theirs.motion[0]["periods_per_set_point"]))
    way = np.abs(theirs.plant_state["arm_angle_rad"] - start).max()
    return apart(mine.plant_state["arm_angle_rad"] / way, theirs.plant_state["arm_angle_rad"] / way)
