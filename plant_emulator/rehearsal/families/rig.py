"""A robot with drives of given families, and its bench file."""

from collections.abc import Mapping

from drive_profiles.family.profile import Profile, available
from hil.bench.bench import AxisTable, Bench
from hil.robot_tables import Control
from plant_emulator.drive.family.dictionary import vendor_scaling
from plant_emulator.robots.robot import Robot, RobotAxis, with_drives
from plant_emulator.robots.tuning import tuned


def vendor_families() -> list[str]:
    """Return the names of all makers' drive families."""
    drives = (name for name in available() if Profile.load(name).kind == "drive")
    return [name for name in drives if name != "emulated_drive"]


def robot_of(robot: Robot, bench: Bench, families: Mapping[int, str]) -> Robot:
    """Return a robot with drives of these families.

    They hold the gains of the bench file, as if set by their maker's tool.

    Args:
        robot: The robot.
        bench: Its bench file, with gains.
        families: Families by axis; the other axes keep their drives.
    """
    gains = {number: bench.axis[number].gains(f"axis {number}") for number in families}
    return tuned(with_drives(robot, families), gains)


def bench_of(robot: Robot, bench: Bench, families: Mapping[int, str]) -> Bench:
    """Return the bench file of such a robot.

    It states what the drives cannot report.
    """
    tables = {number: _table(robot.axis[number], bench.axis[number], name) for number, name in families.items()}
    changed = bench.model_copy(update={"axis": {**bench.axis, **tables}})
    longest = max((Profile.load(name).sync.min_period_s or 0.0 for name in families.values()), default=0.0)
    shortest = min((Profile.load(name).sync.max_period_s or 1.0 for name in families.values()), default=1.0)
    period = min(max(bench.bus.sync_period_s, longest), shortest)
    return changed.model_copy(update={"bus": bench.bus.model_copy(update={"sync_period_s": period})})


def _table(axis: RobotAxis, table: AxisTable, name: str) -> AxisTable:
    """Return the table of an axis with such a drive."""
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
