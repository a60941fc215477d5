"""Robots of the kind that industry builds, each unlike the reference robot in something, and a session without a bus for them."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import signal

from drive_profiles.family.profile import Profile
from drive_profiles.standard.units import Scaling
from hil.bench.bench import AxisTable, Bench, Bus, Limits
from hil.bench.sensors import AccelerometerTable
from hil.master.motion import Motion, RunResult
from hil.recording import Recording
from hil.robot_tables import ConstantAccelerationMotion, Control, TransmissionErrorTable
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.physics.axis import hang_at_rest
from plant_emulator.physics.tip import TipSensor
from plant_emulator.robots.robot import Robot, RobotAccelerometer, RobotAxis

AXIS = 2
SETTLE_S = 2.0
"""Time for which the axis stands under torque before a motion: its arm rings for a second where f_a is 5 Hz."""

BUILT: dict[str, dict[str, Any]] = {
    "low, strong order 4": {"n": 160, "f_a": 5.0, "a2": 12.0, "a4": 16.0, "friction": 3.0, "k_pp": 18.0},
    "high, 13 bits, 4 ms": {"n": 100, "f_a": 25.3, "bits": 13, "sync_ms": 4, "a2": 12.0, "a4": 5.0},
    "soft wind-up, reaction": {
        "n": 100, "f_a": 18.0, "a1": 20.0, "a2": 60.0, "a4": 12.0, "wind_up_softness": 0.3, "gear_reaction": True,
    },
    "order 1, noise": {"n": 120, "f_a": 10.0, "a1": 40.0, "a2": 10.0, "a4": 10.0, "bits": 15, "noise": 0.1},
    "noise, 15 bits": {"n": 120, "f_a": 10.0, "a2": 10.0, "a4": 10.0, "bits": 15, "noise": 0.1},
    "hysteresis of 0.5 N m, lag": {
        "n": 100, "f_a": 11.4, "j_l": 2.0, "a2": 10.0, "a4": 5.0, "hysteresis_torque_nm": 0.5, "current_time_constant_s": 5e-4,
    },
    "all of it, mildly": {
        "n": 80, "f_a": 15.0, "j_l": 1.5, "a2": 10.0, "a4": 6.0, "hysteresis_torque_nm": 0.5, "current_time_constant_s": 3e-4,
        "friction": 2.0, "wind_up_softness": 0.2, "gear_reaction": True,
    },
    "hysteresis, 8 ms": {
        "n": 100, "f_a": 20.0, "j_l": 1.0, "a2": 20.0, "a4": 8.0, "hysteresis_torque_nm": 0.3, "sync_ms": 8,
    },
    "no error": {"n": 100, "f_a": 12.0, "a2": 0.0, "a4": 0.0},
}  # fmt: skip
"""What sets each robot apart; `built` has what they share."""


def built(name: str = "", seed: int = 1, **changes: Any) -> Robot:
    """The robot of a name of `BUILT`, with its phases drawn by the seed."""
    it: dict[str, Any] = {"n": 100.0, "f_a": 12.0, "a1": 0.0, "a2": 10.0, "a4": 5.0, "bits": 17, "noise": 0.02, "sync_ms": 2,
                          "j_l": 6.0, "friction": 1.0, "ratio": 2.0, "zeta": 0.035}  # fmt: skip
    it |= BUILT.get(name, {}) | changes
    draw = np.random.default_rng(seed)
    phases = {f"phi{k}_deg": float(draw.uniform(0.0, 360.0)) for k in (1, 2, 4)}
    phases |= {f"phi{k}_deg": it[f"phi{k}"] for k in (1, 2, 4) if f"phi{k}" in it}
    omega, arm = 2.0 * math.pi * it["f_a"], it["j_l"]
    motor, damping = arm / it["n"] ** 2 / it["ratio"], 2.0 * it["zeta"] * omega * arm
    limit = 40.0 * motor * 2.0 * math.pi * 12.0 + 0.02 * arm
    options = ("wind_up_softness", "gear_reaction", "hysteresis_torque_nm", "current_time_constant_s", "gravity_moment_nm")
    axis = RobotAxis(
        reduction_ratio=it["n"], motor_inertia_kg_m2=motor, motor_damping_nm_s_rad=3.0 * motor, arm_inertia_kg_m2=arm,
        arm_damping_nm_s_rad=0.12 * damping, gear_stiffness_nm_rad=arm * omega**2, gear_damping_nm_s_rad=0.88 * damping,
        coulomb_friction_nm=0.015 * it["friction"] * limit, static_friction_nm=0.02 * it["friction"] * limit,
        torque_limit_nm=limit, encoder_counts_per_rev=2 ** it["bits"], tip_lever_m=0.6,
        ate=TransmissionErrorTable(a1_arcsec=it["a1"], a2_arcsec=it["a2"], a4_arcsec=it["a4"], **phases),
        **({"gravity_moment_nm": 6.0 * arm} | {key: it[key] for key in options if key in it}),
    )  # fmt: skip
    sensor = RobotAccelerometer(
        noise_m_s2=it["noise"], **{key: it[key] for key in it if key in ("range_m_s2", "resolution_m_s2")}
    )
    return Robot(name=name or "built", seed=seed, sync_period_s=1e-3 * it["sync_ms"], axis={AXIS: axis}, accelerometer=sensor)


def blank_bench(robot: Robot, k_pp: float | None = None, **limits: float) -> Bench:
    """A bench of which the plant is not known: gains of 100 Hz on the rotor, limits that an engineer would give."""
    axis = robot.axis[AXIS]
    speed_gain = 2.0 * math.pi * 100.0 * axis.motor_inertia_kg_m2
    position_gain = k_pp or BUILT.get(robot.name, {}).get("k_pp", 25.0)
    table = AxisTable(
        node_id=AXIS, reduction_ratio=axis.reduction_ratio, tip_lever_m=axis.tip_lever_m,
        limits=Limits(**({"torque_nm": axis.torque_limit_nm, "speed_rps": 40.0, "position_min_rev": -22.0,
                          "position_max_rev": 22.0} | limits)),
        control=Control(position_gain_per_s=position_gain, velocity_gain_nm_s_rad=speed_gain,
                        velocity_integral_gain_nm_rad=20.0 * speed_gain),
    )  # fmt: skip
    return Bench(
        name=robot.name, bus=Bus(address="local:/tmp/none.sock", sync_period_s=robot.sync_period_s, answer_timeout_s=0.05),
        axis={AXIS: table}, accelerometer=AccelerometerTable(node_id=16), settle_s=0.1,
        constant_acceleration=ConstantAccelerationMotion(acceleration_rps_s=4.0, end_rps=10.0),
    )  # fmt: skip


class RigSession:
    """As much of a session as the identification and the learning use, on an emulated axis in this process.

    Attributes:
        motions: What was asked for.
    """

    def __init__(self, robot: Robot, bench: Bench | None = None, *, tip_gain: float = 1.0, is_held: bool = False,
                 delay_s: float = 0.0, lowpass_hz: float = 0.0, mount_hz: float = 0.0) -> None:  # fmt: skip
        self.robot, self.bench, self.motions = robot, bench or blank_bench(robot), list[Motion]()
        self.network = SimpleNamespace(channel=None)
        table = robot.axis[AXIS]
        self._scaling = Scaling(table.encoder_counts_per_rev, table.rated_torque)
        self._rng, self._tip_gain, self._is_held = np.random.default_rng(robot.seed + 1000), tip_gain, is_held
        self._delay_s, self._lowpass_hz, self._mount_hz = delay_s, lowpass_hz, mount_hz
        drive = SimpleNamespace(position_rad=lambda: self._rad, scaling=self._scaling, profile=Profile.load("emulated_drive"),
                                control_period_s=lambda: robot.control_period_s)  # fmt: skip
        self.axes = {AXIS: drive}
        self._rad = 0.0

    def check_interrupt(self) -> None:
        """Nobody interrupts."""

    def run(self, motion: Motion, filters: str, loop: str, adder: Any = None, **more: Any) -> RunResult:
        """The motion on the emulated axis, sampled as over the bus: first the answers, then the set-points come into force."""
        self.motions.append(motion)
        sync, periods = motion.period_s, round(motion.period_s / self.robot.control_period_s)
        axes, scaling = Axes(self.robot), self._scaling
        self.bench.axis[AXIS].gains("run").cascade().write(axes.cascade_config[0])
        per_rad, quantum = scaling.counts_per_rad, scaling.torque_quantum_nm
        start = self._rad
        axes.plant_state[0]["motor_angle_rad"] = start
        if self._is_held:  # an arm that nothing moves: the gear is all that gives way
            axes.plant[0]["arm_inertia_kg_m2"] *= 1e9
        hang_at_rest(axes.plant[0], axes.plant_state[0])
        targets, sensor = start + motion.motor_angle_rad[:, 0], self.robot.accelerometer
        count = len(targets)
        axes.open_brake(0, POSITION, periods)
        for _ in range(round(SETTLE_S / sync)):
            axes.set_point(0, round(start * per_rad))
            axes.advance(periods)
        table, true_tip = np.zeros((count, 2)), np.zeros(count * periods)
        measured, felt = axes.counts(0) / per_rad, 0.0
        for row in range(count):
            angle = axes.counts(0) / per_rad
            torque = round(float(axes.motion[0]["torque_nm"]) / quantum) * quantum
            table[row] = angle, torque
            addition = 0.0 if adder is None else float(adder.laws.step([measured], [felt])[0][0])
            measured, felt = angle, torque
            axes.set_point(0, round((targets[row] + addition) * per_rad))
            if self._lowpass_hz or self._mount_hz or self._delay_s:
                for step in range(periods):
                    true_tip[row * periods + step] = axes.tip_acceleration()[2]
                    axes.advance(1)
            else:
                true_tip[row * periods : (row + 1) * periods] = axes.tip_acceleration()[2]
                axes.advance(periods)
        tip = self._sensed(true_tip, periods)
        noisy = TipSensor(sensor.noise_m_s2, sensor.resolution_m_s2, sensor.range_m_s2, self._rng)
        z = np.array([noisy.sample((0.0, 0.0, self._tip_gain * float(value)))[2] for value in tip])
        self._rad = float(table[-1, 0])
        columns = {
            "time_s": motion.time_s, f"axis{AXIS}_position_rad": table[:, 0], f"axis{AXIS}_torque_nm": table[:, 1],
            "tip_z_m_s2": z, "missing": np.zeros(count),
        }  # fmt: skip
        duration = float(motion.time_s[-1])
        return RunResult(Recording(columns), count, 0, 0, duration, duration, self.robot.control_period_s, None)

    def _sensed(self, true_tip: np.ndarray, periods: int) -> np.ndarray:
        """The acceleration behind mounting, low-pass and delay, sampled at every SYNC."""
        rate, values = 1.0 / self.robot.control_period_s, true_tip
        if self._mount_hz:
            w, z = 2.0 * math.pi * self._mount_hz, 0.05
            values = signal.lfilter(*signal.bilinear([2 * z * w, w * w], [1.0, 2 * z * w, w * w], rate), values)
        if self._lowpass_hz:
            values = signal.lfilter(*signal.butter(2, self._lowpass_hz, fs=rate), values)
        late = round(self._delay_s * rate)
        return np.concatenate([np.zeros(late), values])[: len(values)][::periods]
