"""The true tip of a robot."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hil.analysis import band_passed, motor_speed_rps, order_window_rps, tip_scale
from hil.bench.bench import Bench, Model
from hil.experiments.judge import peak_hz
from hil.recording import Recording
from hil.robot_tables import ORDERS, PlantTable, TransmissionErrorTable
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.robot import Robot

END_S = 0.15
"""Part before the top of the ramp that is left out: its braking shows there."""


def quiet(robot: Robot, late_s: float = 0.0) -> Robot:
    """Return the robot with an ideal sensor."""
    still = robot.accelerometer.model_copy(
        update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0, "delay_s": late_s, "lowpass_hz": None, "mounting_resonance_hz": None}
    )
    return robot.model_copy(update={"accelerometer": still})


def without_error(robot: Robot) -> Robot:
    """Return the robot with perfect gears, and encoders with noise alone."""
    none = TransmissionErrorTable.of({}, {})
    axes = {
        number: axis.model_copy(update={"ate": none, "encoder": MotorEncoder(noise_counts=axis.encoder.noise_counts)})
        for number, axis in robot.axis.items()
    }
    return robot.model_copy(update={"axis": axes})


def with_true_models(bench: Bench, robot: Robot) -> Bench:
    """Return the bench with the true plant of every axis."""
    axes = {}
    for number, table in bench.axis.items():
        plant = {name: getattr(robot.axis[number], name) for name in PlantTable.model_fields}
        model = Model(**plant, ate=TransmissionErrorTable(a2_arcsec=0.0, phi2_deg=0.0))
        axes[number] = table.model_copy(update={"model": model})
    return bench.model_copy(update={"axis": axes})


def true_f_al_hz(bench: Bench, robot: Robot, axis: int) -> float:
    """Return f_al, the peak of |G_al|, of an axis as tuned."""
    found = peak_hz(with_true_models(bench, robot), axis, robot.control_period_s)
    assert found is not None  # noqa: S101 - the model has just been put in
    return found


def tip_by_order_mm(
    recording: Recording, axis: int, f_al_hz: float, speed_rps: NDArray[np.float64] | None = None
) -> dict[float, float]:
    """Return the largest tip displacement by order, mm.

    Args:
        recording: Recording on a quiet sensor.
        f_al_hz: The robot's own.
        speed_rps: Motor speed of the same motion with perfect gears, the same rows for all treatments: what a cancellation adds
            to the speed would let a window begin half a swing of the motion's own jolt earlier. The recording's own unless given.
    """
    scale = tip_scale(f_al_hz)
    period = recording.period_s
    band = (scale.band_hz[0], min(scale.band_hz[1], 0.45 / period))
    displacement = np.abs(band_passed(recording.columns["tip_z_m_s2"], period, band)) * 1e3 / (2.0 * math.pi * f_al_hz) ** 2
    speed = np.abs(motor_speed_rps(recording, axis) if speed_rps is None else speed_rps)[: len(displacement)]
    top = int(np.argmax(speed)) - round(END_S / period)
    return {order: float(displacement[rows].max()) for order, rows in _windows(speed[: max(top, 0)], f_al_hz).items()}


def _windows(speed_rps: NDArray[np.float64], f_al_hz: float) -> dict[float, NDArray[np.intp]]:
    """Rows of a rising ramp in which each order shakes the arm near f_al.

    An order whose resonance the ramp does not pass is left out, unless it passes none: then those count that it comes near.
    """
    near: dict[float, NDArray[np.intp]] = {}
    for order in ORDERS:
        low, high = order_window_rps(f_al_hz, order)
        rows = np.flatnonzero((speed_rps >= low) & (speed_rps <= high))
        if len(rows):
            near[order] = rows
    passed = {order: rows for order, rows in near.items() if float(speed_rps[rows].max()) >= f_al_hz / order}
    return passed or near


def ratio_of_tips(after: Mapping[float, float], before: Mapping[float, float]) -> float | None:
    """Return the largest ratio of tips, those before at least 0.002 mm."""
    ratios = [after[order] / max(before[order], 0.002) for order in after if order in before]
    return max(ratios, default=None)
