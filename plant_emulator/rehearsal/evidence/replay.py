"""Kept recordings of drawn robots, and estimates from them, made again without a robot."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drive_profiles.files.safefile import write_atomically
from drive_profiles.files.toml import load, loads
from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedPlant
from hil.design.ate.model import Sweep
from hil.errors import HilError
from hil.experiments.ate.identify import as_part, estimate_of, simulated
from hil.experiments.ate.request import AteRequest, axis_knowledge
from hil.experiments.ate.sweeps import sweep_on_time
from hil.recording import Recording
from hil.results.ate import AteResult, AteRun
from hil.results.files import load_result
from plant_emulator.rehearsal.estimates import quantities_of
from plant_emulator.rehearsal.gear import gear_plant
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.record import QUANTITIES, QuantityRecord
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.robots.blank_bench import file_text
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.trials.rows import Row, plain

HELD_OUT_FROM = 50_001
"""Seeds from here on are for the final statement: no evidence is made of them."""


class RecordedRobot:
    """Folder of one robot: truth, bench file, and files of the identifications."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.kind, self.files = folder, folder.name.partition("-")[0], PathFiles(folder)
        self._robot_file, self._bench_file = folder / "robot.toml", folder / "bench.toml"

    @property
    def robot(self) -> Robot:
        """The robot, all its truth in it."""
        return load_robot(self._robot_file)

    @property
    def bench(self) -> Bench:
        """The bench file that it was identified with."""
        return load(self._bench_file, Bench)

    @property
    def is_complete(self) -> bool:
        """True if its identifications have ended; the truth is written last."""
        return self._robot_file.exists()

    def record(self, robot: Robot, bench_text: str) -> tuple[str, ...]:
        """Identify plant and transmission error, and keep all recordings.

        Returns the words of each refusal.
        """
        bench = loads(bench_text, Bench, "blank bench")
        steps = StepsInProcess(robot, bench, min(bench.axis), self.files)
        refused = []
        for step in (steps.plant, steps.ate):
            try:
                step()
            except HilError as error:
                refused.append(str(error))
        write_atomically(self._bench_file, bench_text.encode(), force=True)
        write_atomically(self._robot_file, file_text(robot).encode(), force=True)
        return tuple(refused)


def record(seeds: Sequence[int], kind: str, folder: Path) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Record the robots of some seeds that are not in a folder yet.

    Raises:
        ValueError: A seed is held out.
    """
    if held_out := [seed for seed in seeds if seed >= HELD_OUT_FROM]:
        raise ValueError(f"seed {held_out[0]} is held out; expected seeds below {HELD_OUT_FROM}")
    for seed in seeds:
        recorded = RecordedRobot(folder / f"{kind}-{seed}")
        if not recorded.is_complete:
            yield seed, recorded.record(*drawn(seed, kind))


def recorded_robots(folder: Path) -> list[RecordedRobot]:
    """Return the complete robots of a folder, by name; none of a folder that is missing."""
    found = [RecordedRobot(path) for path in sorted(folder.glob("*")) if path.is_dir()]
    return [each for each in found if each.is_complete]


POSTURES = 60
"""Arm angles of a ramp at which the true gear is evaluated."""
RAMP_QUANTITIES = ("ramps_arm_hz", "ramps_damping")
"""f_a and ζ as the ramps show them, beside those of the plant."""
REPLAYED = (*(name for name in QUANTITIES if not name.startswith("learnt_")), *RAMP_QUANTITIES)
"""Quantities of a replay."""


def replayed(recorded: RecordedRobot) -> Row:
    """Estimate the transmission error from a robot's recordings again.

    Returns a row with truth, estimate, standard error and z by the names of `REPLAYED`. The plant is the one that was
    identified when the recordings were made.
    """
    robot, bench, axis = recorded.robot, recorded.bench, min(recorded.bench.axis)
    known = recorded.files.identified()
    plant = None if known is None else known.axis[axis].plant
    found = quantities_of(robot, axis, _identified(bench, axis, plant), None)
    found |= dict.fromkeys(RAMP_QUANTITIES, QuantityRecord())
    words = ""
    try:
        found |= _of_ramps(recorded, bench, axis, plant)
    except (HilError, ValueError, OSError) as error:
        words = f"{type(error).__name__}: {error}"
    row: dict[str, object] = {"seed": robot.seed, "kind": recorded.kind, "words": words}
    for name in REPLAYED:
        each = found[name]
        row |= {f"{name}_true": each.true, f"{name}_estimate": each.estimate, f"{name}_error": each.error}
        row[f"{name}_z"] = each.z(is_angle=name.endswith("_deg"))
    return {name: plain(value) for name, value in row.items()}


def _identified(bench: Bench, axis: int, plant: IdentifiedPlant | None) -> Identified | None:
    return None if plant is None else Identified(robot=bench.name, axis={axis: IdentifiedAxis(plant=plant)})


def _of_ramps(recorded: RecordedRobot, bench: Bench, axis: int, plant: IdentifiedPlant | None) -> dict[str, QuantityRecord]:
    """Fit the passes as they were fitted on the bus, each with those before it."""
    result = load_result(recorded.folder / "ate", AteResult, "an identification")
    sweeps = [_sweep(each, Recording.load(recorded.folder / "ate" / each.recording), axis) for each in result.passes]
    request = AteRequest(axis)
    knowledge = axis_knowledge(bench, axis, _identified(bench, axis, plant), sensorless=False)
    estimate = None
    for count in range(1, len(sweeps) + 1):
        before = None if estimate is None else estimate.arm
        estimate = estimate_of(
            sweeps[:count], bench.axis[axis].reduction_ratio, result.sensing, knowledge, before, request.orders
        )
    if estimate is None:
        return {}
    linear = estimate
    estimate = simulated(linear, sweeps, bench.axis[axis].reduction_ratio, result.sensing, knowledge)
    part = as_part(estimate, request, "", knowledge)
    model = Identified(robot=bench.name, axis={axis: IdentifiedAxis(plant=plant, ate=part)})
    true_hz, true_damping = _arm_on_its_gear(recorded.robot, axis, sweeps, part.torsion_arcsec)
    return quantities_of(recorded.robot, axis, model, None) | {
        "ramps_arm_hz": QuantityRecord(true_hz, part.arm_hz, part.standard_error["arm_hz"]),
        "ramps_damping": QuantityRecord(true_damping, part.damping, part.standard_error["damping"]),
    }


def _sweep(made: AteRun, recording: Recording, axis: int) -> Sweep:
    """Return a kept pass as input of the fit."""
    direction = np.zeros(len(recording.time_s), dtype=np.int8)
    for from_s, sign in ((made.forward_from_s, 1), (made.backward_from_s, -1)):
        since = recording.time_s - recording.time_s[0] - from_s
        direction[(since > -0.5 * recording.period_s) & (since <= made.ramp_s + 1e-9)] = sign
    torque = recording.axis(axis, "torque_nm")
    return sweep_on_time(recording, axis, recording.felt_m_s2, direction, torque)


def _arm_on_its_gear(robot: Robot, number: int, sweeps: Sequence[Sweep], torsion_arcsec: float | None) -> tuple[float, float]:
    """Return the true f_a and ζ of ramps.

    The gear is that of the stated torsion. Gravity adds to its stiffness −m g l sin q on average over the ramps.
    """
    axis, home_rad = robot.axis[number], robot.home_angle(number)
    postures = np.concatenate([each.motor_angle_rad[each.direction != 0] for each in sweeps]) / axis.reduction_ratio + home_rad
    gear = gear_plant(axis, torsion_arcsec, np.quantile(postures, np.linspace(0.0, 1.0, POSTURES)))
    stiffer = math.sqrt(1.0 - axis.gravity_moment_nm * float(np.mean(np.sin(postures))) / gear.stiffness_nm_rad)
    return gear.antiresonance_hz * stiffer, gear.damping / stiffer
