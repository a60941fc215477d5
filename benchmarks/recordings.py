"""Honesty of standard errors from recordings of the emulated robot: drawn errors, identified and held against the truth.

python -m benchmarks.recordings --form encoders --seeds 1-100
"""

import argparse
import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedPlant
from hil.control.angles import ARCSEC
from hil.design.ate.model import Arm
from hil.design.frequency import TwoInertia
from hil.experiments.ate.recorded.identify import identify_recorded
from hil.experiments.ate.recorded.request import RecordedRequest
from hil.recording import save_columns
from hil.recordings import Said
from hil.robot_tables import Control, PlantTable, TransmissionErrorTable
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.studies.simulate import simulate

Real = NDArray[np.float64]

AXIS, ORDERS = 2, (1, 2, 4)
PERIOD_S, JITTER_S = 0.004, 0.004
FORMS = ("encoders", "acceleration", "torque")
KNOWN = {"antiresonance_hz": 0.005, "damping": 0.05}
"""Standard errors of the plant that the model file has, by their size; what it says is off by as much."""


@dataclass(frozen=True)
class Truth:
    """A recording's robot.

    Attributes:
        robot: The robot.
        error: Its transmission error.
    """

    robot: Robot
    error: TransmissionErrorTable


def drawn(seed: int, form: str) -> Truth:
    """The reference robot with a transmission error drawn by a seed, and a motion that shows it."""
    random = np.random.default_rng(seed)
    error = TransmissionErrorTable.of(
        {1: random.uniform(1.0, 4.0), 2: random.uniform(3.0, 12.0), 4: random.uniform(2.0, 6.0)},
        {order: random.uniform(0.0, 360.0) for order in ORDERS},
    )
    robot = load_robot("reference")
    axis = robot.axis[AXIS].model_copy(update={"ate": error})
    slow = form == "encoders"
    motion = robot.constant_acceleration.model_copy(
        update={
            "acceleration_rps_s": 0.1 if slow else 1.5,
            "deceleration_rps_s": 0.1 if slow else 1.5,
            "end_rps": 0.8 if slow else 9.0,
        }
    )
    return Truth(robot.model_copy(update={"axis": {**robot.axis, AXIS: axis}, "constant_acceleration": motion}), error)


def recorded(truth: Truth, form: str, seed: int, path: Path) -> None:
    """Write a recording of a robot: stamps that are late by up to a period, encoders and sensors with noise of their own."""
    random = np.random.default_rng(10_000 + seed)
    control = Control(**load_bench("reference").axis[AXIS].control.model_dump())
    run = simulate(truth.robot, AXIS, controls={AXIS: control}, notches={}, sync_period_s=PERIOD_S)
    table = truth.robot.axis[AXIS]
    motor = run.position_counts[:, 0] / table.encoder_counts_per_rev * 2.0 * math.pi
    columns: dict[str, Real] = {"time_s": run.time_s + random.uniform(0.0, JITTER_S, len(motor)), "motor_rad": motor}
    if form == "encoders":
        load = run.arm_angle_rad[:, 0]
        noise = np.convolve(random.normal(0.0, 1.5, len(load) + 4), np.ones(5) / math.sqrt(5.0), "valid")
        eccentric = 30.0 * np.cos(load + random.uniform(0.0, 2.0 * math.pi))
        columns["load_rad"] = np.round((load + ARCSEC * (noise + eccentric)) / (2.0 * math.pi) * 2**24) / 2**24 * 2.0 * math.pi
    elif form == "acceleration":
        columns["acceleration_m_s2"] = run.tip_acceleration_m_s2[:, 2] + random.normal(0.0, 0.02, len(motor))
    else:
        columns["torque_nm"] = run.torque_nm[:, 0] + random.normal(0.0, 0.01, len(motor))
    save_columns(path, columns)


def model_of(truth: Truth, seed: int) -> Identified:
    """A model file whose plant is off by its standard errors."""
    random = np.random.default_rng(20_000 + seed)
    table = truth.robot.axis[AXIS]
    plant = PlantTable(**{name: getattr(table, name) for name in PlantTable.model_fields})
    arm = Arm.of(TwoInertia(reduction_ratio=1.0, **plant.model_dump()))
    part = IdentifiedPlant(
        values=plant,
        antiresonance_hz=arm.resonance_hz * (1.0 + KNOWN["antiresonance_hz"] * random.normal()),
        resonance_hz=22.0,
        damping=arm.damping * (1.0 + KNOWN["damping"] * random.normal()),
        standard_error={
            "antiresonance_hz": KNOWN["antiresonance_hz"] * arm.resonance_hz,
            "damping": KNOWN["damping"] * arm.damping,
        },
    )
    return Identified(robot="reference", axis={AXIS: IdentifiedAxis(plant=part)})


def scores(seed: int, form: str) -> dict[str, float]:
    """Distance of each number from the truth in its standard errors, by name."""
    truth = drawn(seed, form)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "recording.csv"
        recorded(truth, form, seed, path)
        said = Said(reduction_ratio=truth.robot.axis[AXIS].reduction_ratio)
        request = RecordedRequest((path,), AXIS, said, ORDERS, sensorless=form == "torque")
        needed = (None, None) if form == "encoders" else (load_bench("reference"), model_of(truth, seed))
        part = identify_recorded(request, Path(place) / "out", *needed).ate
    amplitudes, phases = truth.error.amplitudes_arcsec(), truth.error.phases_deg()
    found: dict[str, float] = {}
    shown, errors = part.values, part.standard_error
    for order in ORDERS:
        off = (shown.phases_deg()[order] - phases[order] + 180.0) % 360.0 - 180.0
        found[f"A_{order}"] = (shown.amplitudes_arcsec()[order] - amplitudes[order]) / errors[f"a{order}_arcsec"]
        found[f"phi_{order}"] = off / errors[f"phi{order}_deg"]
        found[f"e_{order}"] = errors[f"a{order}_arcsec"]
    return found


def summary(rows: list[dict[str, float]]) -> list[str]:
    """Lines on the scores of many seeds."""
    lines = []
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        if name.startswith("e_"):
            lines.append(f"{name}: standard error of the amplitude {np.median(values):.3f} arcsec")
            continue
        rms, most = float(np.sqrt(np.mean(values**2))), float(np.max(np.abs(values)))
        lines.append(f"{name}: mean {np.mean(values):+.2f}, rms {rms:.2f}, most {most:.2f}")
    every = np.array([row[name] for row in rows for name in row if not name.startswith("e_")])
    rms, most = float(np.sqrt(np.mean(every**2))), float(np.max(np.abs(every)))
    return [*lines, f"all, {len(rows)} seeds: rms {rms:.2f}, most {most:.2f}, above 4: {np.sum(np.abs(every) > 4.0)}"]


def main() -> None:
    """Print the scores of many seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--form", choices=FORMS, required=True)
    parser.add_argument("--seeds", default="1-20", help="FIRST-LAST")
    chosen = parser.parse_args()
    first, _, last = chosen.seeds.partition("-")
    rows = [scores(seed, chosen.form) for seed in range(int(first), int(last or first) + 1)]
    sys.stdout.write("\n".join(summary(rows)) + "\n")


if __name__ == "__main__":
    main()
