"""One axis of a robot with a tracking cancellation."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Union

import numpy as np
from numpy.typing import NDArray

from drive_profiles.files.toml import loads
from drive_profiles.standard.units import Scaling, real32
from hil.analysis import band_passed, integrated_twice
from hil.bench.bench import Bench, Model
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.cancellation import CancellationLaw
from hil.control.cancellation_table import CancellationTable, MotorLoad
from hil.control.cascade import Cascade
from hil.control.following import ArmModel, Followed, FollowingLaw
from hil.design.following import Resonance, arm_model, band_pass, resonance_of
from hil.design.inverse import CyclicTiming
from hil.experiments.cancellation.cancellation import Pace, table_of
from hil.recording import Recording
from hil.robot_tables import PlantTable, TransmissionErrorTable
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import antiresonance_hz, small_motion_antiresonance_hz
from plant_emulator.robots.robot import Robot

if TYPE_CHECKING:
    from plant_emulator.rehearsal.following.laws import FollowerBase

Follower = Union[FollowingLaw, "FollowerBase"]
"""A tracking law: the product's, or one of those that are compared with it."""

NOISE_SEED = 4711
NO_BEGINS: Mapping[float, float] = {}
RIG_SETTLE_S = 0.5


@dataclass(frozen=True)
class Assumed:
    """Assumed values of the axis, relative to the true ones.

    Attributes:
        amplitude: Factor of each A_k.
        turn_deg: Turn of each φ_k.
        stretch: Factor of f_al.
        damping: Factor of the damping.
    """

    amplitude: float = 1.0
    turn_deg: float = 0.0
    stretch: float = 1.0
    damping: float = 1.0
    delay_s: float = 0.0


RIGHT = Assumed()


@dataclass(frozen=True)
class RigRun:
    """One run.

    Attributes:
        time_s: Shape (n,).
        speed_rps: Shape (n,).
        tip_mm: True displacement of the tip in the band of its vibration; shape (n,).
        factors: w of each order; shape (n,).
        recording: What the master would have recorded.
    """

    time_s: Real
    speed_rps: Real
    tip_mm: Real
    factors: dict[float, NDArray[np.complex128]]
    recording: Recording

    @property
    def has_moved(self) -> bool:
        """True if an order's factor has changed."""
        return any(bool(np.any(each != 1.0)) for each in self.factors.values())


class Rig:
    """An axis, its cancellation, and the motion.

    Args:
        number: Axis; the first unless given.
        bench: The bench file, for its gains; the robot's blank one unless given.
    """

    def __init__(self, robot: Robot, assumed: Assumed = RIGHT, number: int | None = None, bench: Bench | None = None) -> None:
        self.robot, self.number, self.assumed = robot, min(robot.axis) if number is None else number, assumed
        self.axis = robot.axis[self.number]
        self.bench = loads(blank_bench(robot), Bench) if bench is None else bench
        plant = {name: getattr(self.axis, name) for name in PlantTable.model_fields}
        # an identification finds the resonance of motions between the smallest and those that bend the gear whole
        plant["gear_stiffness_nm_rad"] *= small_motion_antiresonance_hz(self.axis) / antiresonance_hz(self.axis)
        table = self.bench.axis[self.number]
        true = table.model_copy(update={"model": Model(**plant, ate=self.axis.apparent_ate)})
        loop = true.loop(robot.control_period_s, with_notch=False)
        assert loop is not None  # noqa: S101 - the model has just been put in
        self.f_al_hz, self.resonance = loop.peak_hz(), resonance_of(loop.arm_per_transmission_error, loop.peak_hz())
        sizes = {order: assumed.amplitude * size for order, size in self.axis.apparent_ate.amplitudes_arcsec().items()}
        phases = {order: phase + assumed.turn_deg for order, phase in self.axis.apparent_ate.phases_deg().items()}
        self.error = TransmissionErrorTable.of(sizes, {order: phase % 360.0 for order, phase in phases.items()})
        model = Model(**plant, ate=self.error)
        self.bench = self.bench.model_copy(
            update={"axis": {**self.bench.axis, self.number: table.model_copy(update={"model": model})}}
        )
        self.sync_s = robot.sync_period_s
        self.lever_m = self.axis.tip_lever_m

    def followed(self, begins: Mapping[float, float] = NO_BEGINS) -> list[Followed]:
        """Return the tracked orders, each from a part of it on."""
        sizes, phases = self.error.amplitudes_arcsec(), self.error.phases_deg()
        return [
            Followed(order, math.radians(phases[order]), size * ARCSEC, begins.get(order, 0.0)) for order, size in sizes.items()
        ]

    def known_arm(self) -> Resonance:
        """Return the arm as it is assumed to be."""
        r, b = self.resonance, self.assumed
        return Resonance(
            r.b0 * b.stretch**2, r.b1 * b.damping, r.a1 * b.damping * b.stretch, r.a0 * b.stretch**2, r.f_al_hz * b.stretch
        )

    def known_model(self) -> ArmModel:
        """Return the arm's model for the laws."""
        delay_s = self.robot.accelerometer.delay_s + self.assumed.delay_s
        return arm_model(self.known_arm(), self.axis.reduction_ratio, self.sync_s, delay_s)

    def band(self) -> tuple[float, float, float, float, float]:
        """Return the section of the band-pass."""
        f_al_hz = self.known_arm().f_al_hz
        return band_pass(f_al_hz, f_al_hz, self.sync_s)

    def follower(self, begins: Mapping[float, float] = NO_BEGINS) -> FollowingLaw:
        """Return the product's law for this axis."""
        return FollowingLaw([self.known_model()], [self.followed(begins)], self.band(), self.sync_s)

    def _table(self, angles_rad: Real) -> CancellationTable:
        """Return the feed-forward's table for a motion."""
        axis, sync_s, steps = self.axis, self.sync_s, np.abs(np.diff(angles_rad))
        pace = Pace(
            float(np.max(steps)) / sync_s / math.tau, float(np.quantile(np.abs(np.diff(angles_rad, 2)), 0.98)) / sync_s**2
        )
        model = self.bench.axis[self.number].model
        assert model is not None  # noqa: S101 - put in above
        load = None
        if axis.gear_reaction:
            most_nm = 1.5 * (abs(axis.gravity_moment_nm) + axis.arm_inertia_kg_m2 * pace.most_rad_s2 / axis.reduction_ratio)
            inertia = axis.motor_inertia_kg_m2, axis.motor_damping_nm_s_rad
            load = MotorLoad(axis.reduction_ratio, *inertia, axis.coulomb_friction_nm, 1.0, most_nm)
        timing = CyclicTiming(sync_s, self.robot.control_period_s)
        lag_s = axis.current_time_constant_s
        return table_of(
            self.bench, self.number, model, timing, pace, "reference", with_notch=False, torque_lag_s=lag_s, load=load
        )[0]

    def run(
        self,
        angles_rad: Real,
        follower: Follower | None,
        true_turn_deg: Callable[[float], float] = lambda time_s: 0.0,
        cancels: bool = True,
        only: float | None = None,
        noise_seed: int = NOISE_SEED,
    ) -> RigRun:
        """Run a motion; the gear's ATE may turn meanwhile.

        Args:
            angles_rad: Motor angles at each SYNC; shape (n,).
            follower: What follows; None: the cancellation alone.
            true_turn_deg: Turn of φ_k at a time.
            cancels: False: nothing is cancelled.
            only: The only order that turns; None for all.
            noise_seed: Seed of the sensor's noise, with the robot's own.
        """
        robot, axis, sync_s = self.robot, self.axis, self.sync_s
        settle = round(RIG_SETTLE_S / sync_s)
        wanted = np.concatenate([np.full(settle, angles_rad[0]), angles_rad])
        time = np.arange(len(wanted), dtype=np.float64) * sync_s - settle * sync_s
        axes, row, periods = self._axes()
        plant, turned = axes.plant[row], 0.0
        phases = {f"phi{k}_rad": float(plant[f"phi{k}_rad"]) for k in (1, 2, 4) if only is None or k == only}
        law = CancellationLaw([self._table(angles_rad)], sync_s)
        scaling = Scaling(axis.encoder_counts_per_rev, axis.rated_torque)
        random = np.random.default_rng((noise_seed, robot.seed or 0))
        noise = robot.accelerometer.noise_m_s2 * random.standard_normal(len(wanted))
        arm, seen, heard, torque = np.zeros((4, len(wanted)))
        orders = [each.order for each in self.followed()]
        factors = np.ones((len(wanted), len(orders)), dtype=np.complex128)
        waiting, to_rad = axes.counts(row), math.tau / axis.encoder_counts_per_rev
        for i, reference in enumerate(wanted.tolist()):
            if (turn_deg := true_turn_deg(float(time[i]))) != turned:
                turned = turn_deg
                for name, phase in phases.items():
                    plant[name] = phase + math.radians(turned)
            seen[i] = angle = axes.counts(row) * to_rad
            heard[i] = axes.sensed_acceleration()[2] + noise[i]
            arm[i], added = axes.plant_state[row]["arm_acceleration_rad_s2"], 0.0
            if follower is not None:
                follower.step([angle], [reference], [self.lever_m], float(heard[i]))
                factors[i] = list(follower.factors(0).values())
                if i == 0 or np.any(factors[i] != factors[i - 1]):
                    law.multiply(0, follower.factors(0))
            torque[i] = axes.motion[row]["torque_nm"]
            if cancels:
                added = law.step([angle], [float(torque[i])])[0][0]
            axes.set_point(row, waiting)  # what was sent before this SYNC
            axes.advance(periods)
            waiting = scaling.position_counts(float(wanted[min(i + 1, len(wanted) - 1)]) + added)
        band = (0.5 * self.f_al_hz, min(2.5 * self.f_al_hz, 0.45 / sync_s))
        tip = integrated_twice(band_passed(arm, sync_s, band) * self.lever_m * 1e3, sync_s, band[0])
        speed = np.asarray(np.gradient(seen, sync_s)) / math.tau
        named = {order: factors[:, m] for m, order in enumerate(orders)}
        return RigRun(time, speed, tip, named, self._recording(time - time[0], heard, np.stack([wanted, seen, torque])))

    def _recording(self, time_s: Real, heard_m_s2: Real, moved: Real) -> Recording:
        """Return the recording that the master would have made.

        Args:
            time_s: Shape (n,).
            heard_m_s2: The sensor's acceleration; shape (n,).
            moved: Set-point, angle and torque of the motor; shape (3, n).
        """
        nothing = np.zeros(len(time_s))
        columns = {"time_s": time_s, "tip_x_m_s2": nothing, "tip_y_m_s2": nothing, "tip_z_m_s2": heard_m_s2}
        names = ("reference_rad", "position_rad", "torque_nm")
        columns |= {f"axis{self.number}_{name}": values for name, values in zip(names, moved, strict=True)}
        return Recording(columns | {f"axis{self.number}_notch_hz": nothing})

    def _axes(self) -> tuple[Axes, int, int]:
        """Return axes, row of this axis, and periods per SYNC.

        The axes have gains and open brakes; the periods are control periods.
        """
        axes, periods = Axes(self.robot), round(self.sync_s / self.robot.control_period_s)
        row = axes.row(self.number)
        control = self.bench.axis[self.number].gains("a study")
        gains = {name: real32(value) for name, value in control.model_dump().items()}
        Cascade(**gains).write(axes.cascade_config[row])
        axes.open_brake(row, POSITION, periods)
        return axes, row, periods
