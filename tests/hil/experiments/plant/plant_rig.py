"""A session without a bus: the emulated axis in one process, for identifications that look at the numbers."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from drive_profiles.family.profile import Profile
from drive_profiles.standard.units import Scaling
from hil.bench.bench import Bench, load_bench
from hil.master.motion import Motion, RunResult
from hil.recording import Recording
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.physics.tip import TipSensor
from plant_emulator.robots.robot import Robot, load_robot

SYNC = 0.004


def unknown_bench(number: int, sync_s: float = SYNC, **limits: float) -> Bench:
    """The reference bench with one axis of which nothing is known."""
    bench = load_bench("reference")
    table = bench.axis[number]
    table = table.model_copy(update={"model": None, "limits": table.limits.model_copy(update=limits)})
    bus = bench.bus.model_copy(update={"sync_period_s": sync_s})
    changes: dict[str, Any] = {"axis": {number: table}, "bus": bus, "settle_s": 0.1, "geometry": None, "line_motion": None}
    return bench.model_copy(update=changes)


class FakeSession:
    """As much of a session as an identification uses: an axis of the reference robot, or of the robot that is given.

    Attributes:
        motions: What was asked for.
    """

    def __init__(self, bench: Bench, number: int, *, seed: int = 1, tip_gain: float = 1.0, sensor_range: float = 19.62,
                 missing: tuple[int, ...] = (), sensor_missed: int = 0, profile: str = "emulated_drive",
                 robot: Robot | None = None, counts_backwards: bool = False, is_braked: bool = False) -> None:  # fmt: skip
        rng = np.random.default_rng(seed)
        if robot is None:
            robot = load_robot("reference")
            table = robot.axis[number]
            ate = {"phi2_deg": float(rng.uniform(0.0, 360.0)), "phi4_deg": float(rng.uniform(0.0, 360.0))}
            table = table.model_copy(update={"ate": table.ate.model_copy(update=ate)})
            sensor = robot.accelerometer.model_copy(update={"noise_m_s2": 0.05, "resolution_m_s2": 0.01})
            update = {"axis": {number: table}, "geometry": None, "line_motion": None, "accelerometer": sensor}
            robot = robot.model_copy(update=update)
        self.robot, table = robot, robot.axis[number]
        self.bench, self.number, self.motions = bench, number, list[Motion]()
        self._scaling = Scaling(table.encoder_counts_per_rev, table.rated_torque)
        self._rng, self._tip_gain, self._range = rng, tip_gain, sensor_range
        self._missing, self._sensor_missed = missing, sensor_missed
        self._sign, self._is_braked = -1.0 if counts_backwards else 1.0, is_braked
        drive = SimpleNamespace(
            position_rad=lambda: 0.0, scaling=self._scaling, profile=Profile.load(profile),
            control_period_s=lambda: self.robot.control_period_s,
        )  # fmt: skip
        self.axes = {number: drive}

    def check_interrupt(self) -> None:
        """Nobody interrupts."""

    def run(self, motion: Motion, compensation: str, loop: str) -> RunResult:
        """The motion on the emulated axis, sampled as over the bus: first the answers, then the set-points come into force."""
        del compensation, loop
        self.motions.append(motion)
        number, sync = self.number, motion.period_s
        axes = Axes(self.robot)
        control_s = self.robot.control_period_s
        self.bench.axis[number].gains("the rig").cascade().write(axes.cascade_config[0])
        periods, scaling = round(sync / control_s), self._scaling
        targets = np.asarray(scaling.position_counts(self._sign * motion.motor_angle_rad[:, 0]))
        count = len(targets)
        offsets = np.zeros(count) if motion.torque_offset_nm is None else motion.torque_offset_nm[:, 0]
        quantum = scaling.torque_quantum_nm
        accelerometer = self.robot.accelerometer
        sensor = TipSensor(accelerometer.noise_m_s2, accelerometer.resolution_m_s2, self._range, self._rng)
        if not self._is_braked:
            axes.open_brake(0, POSITION, periods)
        table = np.zeros((count, 3))
        axes.motion[0]["torque_limit_nm"] = self.bench.axis[number].limits.torque_nm
        for _ in range(round(0.3 / sync)):
            axes.set_point(0, int(targets[0]))
            axes.advance(periods)
        for row in range(count):
            tip = sensor.sample((0.0, 0.0, self._tip_gain * axes.sensed_acceleration()[2]))[2]
            torque = round(float(axes.motion[0]["torque_nm"]) / quantum) * quantum
            table[row] = self._sign * axes.counts(0) / scaling.counts_per_rad, torque, tip
            axes.set_point(0, int(targets[row]))
            axes.motion[0]["torque_offset_nm"] = round(float(offsets[row]) / quantum) * quantum
            axes.advance(periods)
        missing = np.zeros(count)
        missing[[row for row in self._missing if row < count]] = 1.0
        columns = {
            "time_s": motion.time_s,
            f"axis{number}_position_rad": table[:, 0],
            f"axis{number}_torque_nm": table[:, 1],
            "tip_z_m_s2": table[:, 2],
            "missing": missing,
        }
        duration = float(motion.time_s[-1])
        return RunResult(Recording(columns), count, 0, self._sensor_missed, duration, duration, control_s, None)


def true_values(number: int) -> dict[str, float]:
    """What an identification should find."""
    plant = load_bench("reference").axis[number].plant()
    assert plant is not None
    damping = 0.5 * (plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad)
    damping /= math.sqrt(plant.gear_stiffness_nm_rad * plant.arm_inertia_kg_m2)
    return {
        **vars(plant),
        "antiresonance_hz": plant.antiresonance_hz,
        "resonance_hz": plant.resonance_hz,
        "damping": damping,
    }
