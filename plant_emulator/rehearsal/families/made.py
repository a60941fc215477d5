"""Move, identify and cancel a family's emulated drive, as `hil` does."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drive_profiles.family.profile import Profile, available
from drive_profiles.family.runs import FamilyRun, FamilyRuns
from hil.bench.bench import AxisTable, Bench, load_bench
from hil.control.treatments import TreatmentName
from hil.errors import HilError
from hil.experiments.plan import Experiment
from hil.experiments.treatment import Knowledge
from hil.master.drive.limits import holders
from hil.master.drive.mapping import mode_of
from hil.results.runs import ExperimentsResult
from hil.robot_tables import Control
from plant_emulator.drive.family.dictionary import vendor_scaling
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess, channel_of, note_of_run, run_of
from plant_emulator.robots.blank_bench import file_text
from plant_emulator.robots.robot import Robot, RobotAxis, load_robot, part_of, with_drives
from plant_emulator.robots.tuning import tuned


def vendor_families() -> list[str]:
    """Return the names of all makers' drive families."""
    drives = (name for name in available() if Profile.load(name).kind == "drive")
    return [name for name in drives if name != "emulated_drive"]


def robot_of(robot: Robot, bench: Bench, families: Mapping[int, str]) -> Robot:
    """Return a robot with drives of these families.

    They hold the gains of the bench file, as if set by their maker's tool.

    Args:
        families: Families by axis; the other axes keep their drives.
    """
    gains = {number: bench.axis[number].gains(f"axis {number}") for number in families}
    return tuned(with_drives(robot, families), gains)


def bench_of(robot: Robot, bench: Bench, families: Mapping[int, str]) -> Bench:
    """Return the bench file of such a robot."""
    tables = {number: _table(robot.axis[number], bench.axis[number], name) for number, name in families.items()}
    changed = bench.model_copy(update={"axis": {**bench.axis, **tables}})
    longest = max((Profile.load(name).sync.min_period_s or 0.0 for name in families.values()), default=0.0)
    shortest = min((Profile.load(name).sync.max_period_s or 1.0 for name in families.values()), default=1.0)
    period = min(max(bench.bus.sync_period_s, longest), shortest)
    return changed.model_copy(update={"bus": bench.bus.model_copy(update={"sync_period_s": period})})


def _table(axis: RobotAxis, table: AxisTable, name: str) -> AxisTable:
    profile = Profile.load(name)
    scaling, torque = vendor_scaling(profile, axis), profile.torque
    has_gains = all(gain in profile.parameters for gain in Control.model_fields)
    limits = table.limits
    held = profile.parameters.get("torque_limit_per_mille")
    if held is not None and held.maximum is not None:  # a drive whose object takes no more than this
        most_nm = held.maximum * scaling.torque_quantum_nm
        limits = limits.model_copy(update={"torque_nm": min(limits.torque_nm, most_nm)})
    update = {
        "profile": name,
        "limits": limits,
        "notch": (),
        "gains_are_set": not has_gains,
        "encoder_counts_per_rev": scaling.encoder_counts_per_rev,
        "rated_torque_nm": axis.rated_torque if torque is not None and torque.rated_torque is None else None,
        "torque_constant_nm_a": axis.torque_constant_nm_a,
    }
    return table.model_copy(update=update)


AXIS = 2


@dataclass(frozen=True)
class Family:
    """A family's drive as axis 2 of the reference robot, alone."""

    bench: Bench
    robot: Robot

    def steps(self, files: PathFiles) -> StepsInProcess:
        """Return the steps of the documented path, with these files."""
        return StepsInProcess(self.robot, self.bench, AXIS, files)

    def run(self, folder: Path, treatment: TreatmentName, knowledge: Knowledge) -> ExperimentsResult:
        """Execute one run; raise the error that ended it."""
        experiment = Experiment("constant-acceleration", AXIS, treatment)
        return run_of(self.bench, experiment, folder / treatment, knowledge, channel_of(self.robot))


def family_alone(name: str) -> Family:
    """Return a family's drive alone on its bus, with bench file."""
    families, bench = {AXIS: name}, load_bench("reference")
    robot = robot_of(part_of(load_robot("reference"), [AXIS]), bench, families)
    made = bench_of(robot, bench, families)
    alone = {"axis": {AXIS: made.axis[AXIS]}, "geometry": None, "line_motion": None, "reference": None}
    return Family(made.model_copy(update=alone), robot)


def family_run(name: str) -> FamilyRun:
    """Move, identify and cancel a family; the result states what was refused."""
    profile, family = Profile.load(name), family_alone(name)
    mode, held = mode_of("drive", profile), holders(profile)
    facts: dict[str, Any] = {
        "mode": "" if mode is None else mode.name,
        "held_by_drive": tuple(held.get("drive", ())),
        "held_by_master": tuple(held.get("master alone", ())),
        "kept_by_drive": tuple(held.get("drive, as found", ())),
    }
    with tempfile.TemporaryDirectory() as name_of_folder:
        folder = Path(name_of_folder)
        files = PathFiles(folder / "model")
        files.folder.mkdir()
        try:
            plain = family.run(folder, "none", Knowledge())
        except HilError as error:
            return FamilyRun(is_moved=False, refusal=str(error), **facts)
        facts["plant_refusal"] = _plant_refusal(family, folder / "plant")
        is_moved = not plain.not_restored
        try:
            family.steps(files).ate()
            knowledge = Knowledge(files.identified())
            tip = _tip_mm(family.run(folder, "none", knowledge))
            cancelled = family.run(folder, "cancellation", knowledge)
            note_of_run(cancelled)  # a trial that refuses it
        except HilError as error:
            return FamilyRun(is_moved=is_moved, refusal=str(error), **facts)
        return FamilyRun(is_moved=is_moved, tip_mm=tip, cancelled_tip_mm=_tip_mm(cancelled), **facts)


def _plant_refusal(family: Family, folder: Path) -> str:
    folder.mkdir()
    try:
        family.steps(PathFiles(folder)).plant()
    except HilError as error:
        return str(error)
    return ""


def _tip_mm(result: ExperimentsResult) -> float:
    return round(max(run.tip_peak_mm for run in result.runs if run.tip_peak_mm is not None), 4)


def as_toml(runs: dict[str, FamilyRun]) -> str:
    """Return the package's table of all families."""
    head = "# What a run does with each family: written by python -m plant_emulator.rehearsal.families, never by hand."
    return f"{head}\n\n{file_text(FamilyRuns(family=dict(sorted(runs.items()))))}"
