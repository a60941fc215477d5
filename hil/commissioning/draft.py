"""Text of a bench file from a scan of the bus.

Values that no scan can find are placeholders, with which no command accepts the file.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drive_profiles.address import parse_address
from drive_profiles.files.toml import toml_value
from drive_profiles.files.toml_lines import key_lines
from hil.arm.urdf import turning_joints
from hil.bench.bench import AS_FOUND, TO_BE_TYPED, Bench
from hil.commissioning.scan import FoundNode
from hil.errors import NotPossibleError
from hil.plan.advice import SYNC_PERIODS_S
from hil.plan.check import check
from hil.robot_tables import Control

LEAST_SYNC_S: Final = 1e-3
"""Shortest SYNC period that is tried: set-points of a loop in the drive need no shorter one."""
APPROACH_RPS: Final = 1.0
"""Speed of the way to a motion's start in a new bench file."""

_UNSAID: Final = {
    "encoder_counts_per_rev": "position units of this drive per motor revolution, as set with its maker's tool",
    "rated_torque_nm": "torque that the drive reports as 1000 per mille, in N·m, as set with its maker's tool",
    "torque_constant_nm_a": "torque of the motor per ampere, in N·m/A, from its data sheet, because the drive reports a current",
}
"""What is asked of a user, by the key of the bench file, where the drive does not say how it counts."""


@dataclass(frozen=True)
class ArmDrawing:
    """An arm's drawing.

    Attributes:
        folder: Folder of the bench file, from which its path counts.
        joints: Joints of the drives, in ascending order of node-IDs; empty if that is not known.
        tip_link: Link that is the tip; None: the only one at the end.
    """

    path: Path
    folder: Path
    joints: tuple[str, ...] = ()
    tip_link: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Its turning joints, from the base on."""
        return turning_joints(self.path)

    @property
    def relative(self) -> str:
        """Its path as the bench file has it."""
        return Path(os.path.relpath(self.path.absolute(), self.folder.absolute())).as_posix()


def draft(name: str, address: str, nodes: Sequence[FoundNode], drawing: ArmDrawing | None = None) -> str:
    """Text of the bench file.

    Raises:
        NotPossibleError: There is no drive, or the joints do not fit the drives.
    """
    axes = {node.node: node for node in nodes if node.is_drive}  # the number of an axis is its drive's node-ID
    if not axes:
        raise NotPossibleError("no drive answers; a bench needs at least one")
    joints = {} if drawing is None else _joints(drawing, len(axes))
    lines = [
        f"# Made from a scan of {address}. Lines with {TO_BE_TYPED!r} are for you to fill in: no command runs until then.",
        "# Run hil check before anything else moves the robot: it compares the robot with this file.",
        f"name = {toml_value(name)}",
        f"approach_rps = {APPROACH_RPS:g}                  # motor speed to the start of a motion and back: slow, raise it later",
        "",
        "[bus]",
        f"address = {toml_value(address)}",
        *_sync_lines(address, axes),
        *_sensor_lines(nodes),
    ]
    if drawing is not None:
        lines += _arm_lines(drawing)
    for i, (number, node) in enumerate(axes.items()):
        lines += _axis_lines(number, node, None if drawing is None else (joints.get(i), drawing.names))
    return "\n".join([*lines, *_motion_lines(), ""])


def left_to_type(text: str) -> list[tuple[int, str]]:
    """Return the lines of a bench file with placeholders, and their keys."""
    rows = text.splitlines()
    there = {line: key for key, line in key_lines(text).items()}
    return [
        (number, ".".join(map(str, there[number])))
        for number, row in enumerate(rows, 1)
        if number in there and f'"{TO_BE_TYPED}' in row
    ]


def _ask(what: str) -> str:
    return toml_value(f"{TO_BE_TYPED} {what}")


def _joints(drawing: ArmDrawing, drives: int) -> dict[int, str]:
    """Return the joints by the row of their drive."""
    if not drawing.joints:
        return {}
    unknown = [name for name in drawing.joints if name not in drawing.names]
    if unknown:
        raise NotPossibleError(f"{drawing.path} has no turning joint {unknown[0]}; it has {', '.join(drawing.names)}")
    if len(drawing.joints) != drives or len(set(drawing.joints)) != drives:
        raise NotPossibleError(
            f"{len(drawing.joints)} joints for {drives} drives: name one for each, in ascending order of node-IDs"
        )
    return dict(enumerate(drawing.joints))


def _sync_lines(address: str, axes: dict[int, FoundNode]) -> list[str]:
    """Return the lines with the shortest SYNC period that fits.

    The bus then carries all drives with a torque offset each, by the arithmetic of `hil plan`.
    """
    parsed = parse_address(address)
    known = {number: node for number, node in axes.items() if node.profile is not None}
    if len(known) < len(axes):
        return [f"sync_period_s = {_ask('once profiles are known, hil plan shows which fits')}"]
    bench = _stand_in(address, axes)
    words = []
    for period_s in (each for each in SYNC_PERIODS_S if each >= LEAST_SYNC_S):
        verdict = check(bench, tuple(axes), "drive", period_s, with_notch=False, torque_offset=True)
        if verdict.fits:
            rate = "an ideal bus" if parsed.bitrate is None else f"{parsed.bitrate} bit/s"
            fit = "1 axis fits" if len(axes) == 1 else f"{len(axes)} axes fit"
            return [f"sync_period_s = {period_s:g}                 # {fit} on {rate} (hil plan has the numbers)"]
        words.append(verdict.sentence)
    rate = "the bit rate is not known; give it in the address, as socketcan:can0@1M" if parsed.bitrate is None else words[-1]
    return [f"sync_period_s = {_ask(rate)}"]


def _stand_in(address: str, axes: dict[int, FoundNode]) -> Bench:
    """Return a bench for counting frames alone."""
    limits = {"torque_nm": 1.0, "speed_rps": 100.0, "position_min_rev": -1.0, "position_max_rev": 1.0}
    tables = {
        number: {
            "node_id": node.node, "profile": node.profiles[0], "reduction_ratio": 1.0, "tip_lever_m": 1.0, "limits": limits,
            "control": AS_FOUND,
        }
        for number, node in axes.items()
    }  # fmt: skip
    sensor = next(node for node in range(1, 127) if node not in axes)
    bus, approach = {"address": address}, 1.0
    return Bench.model_validate({
        "name": "x", "approach_rps": approach, "bus": bus, "accelerometer": {"node_id": sensor}, "axis": tables
    })  # fmt: skip


def _sensor_lines(nodes: Sequence[FoundNode]) -> list[str]:
    sensors = [node for node in nodes if not node.is_drive and node.profile is not None and node.profile.kind == "accelerometer"]
    lines = ["", "[accelerometer]"]
    if len(sensors) == 1:
        lines += [f"node_id = {sensors[0].node}", f"profile = {toml_value(sensors[0].profiles[0])}"]
    else:
        seen = f"nodes {', '.join(str(node.node) for node in sensors)} are accelerometers" if sensors else "the scan found none"
        remedy = "or a [accelerometer.serial] table, or from_load_encoders = true instead of this line"
        lines.append(f"node_id = {_ask(f'node-ID of the sensor at the tip ({seen}), {remedy}')}")
    others = [node for node in nodes if not node.is_drive and node not in sensors]
    lines += [
        f"# node {node.node} is neither a drive nor a known accelerometer: {node.identity.name or 'nameless'}" for node in others
    ]
    return [*lines, f"range_m_s2 = {_ask('largest measurement of the sensor, from its data sheet; or leave the line out')}"]


def _arm_lines(drawing: ArmDrawing) -> list[str]:
    """The arm, whose lengths the drawing has."""
    names = ", ".join(drawing.names)
    return [
        "",
        "[arm]",
        f"urdf = {toml_value(drawing.relative)}",
        *([] if drawing.tip_link is None else [f"tip_link = {toml_value(drawing.tip_link)}"]),
        f"home_deg = {_ask(f'joint angles where all motor angles are zero, in degrees, as [0, -90, 90]: {names}')}",
    ]


def _axis_lines(number: int, node: FoundNode, drawn: tuple[str | None, tuple[str, ...]] | None) -> list[str]:
    """One axis.

    `drawn` has its joint, None if unknown, and all joints of the drawing.
    """
    identity, known = node.identity, node.profile is not None
    who = identity.name or "a drive"
    choice = (
        f"one of {', '.join(node.profiles)}" if node.profiles else "a drive profile; no profile of the package fits this device"
    )
    lines = ["", f"[axis.{number}]                            # {who}", f"node_id = {node.node}"]
    lines.append(f"profile = {toml_value(node.profiles[0]) if known else _ask(choice)}")
    if identity.serial_number:
        lines.append(f"serial_number = {identity.serial_number}            # so that no other drive is taken for this one")
    if node.scaling is not None:
        at = node.position_rev
        where = (
            "the position of its motor is not known" if at is None or not math.isfinite(at) else f"its motor is at {at:.3f} rev"
        )
        lines.append(f"# the drive counts {node.scaling.encoder_counts_per_rev} increments per motor revolution; {where}")
    elif not node.unsaid:
        lines.append(
            f"# {node.doubt or 'the position counts of this node are not known without a profile'}: see docs/drive-needs.md"
        )
    lines += [f"{key} = {_ask(_UNSAID[key])}" for key in node.unsaid]
    if drawn is not None:
        joint, names = drawn
        listed = ", ".join(names)
        lines.append(f"joint = {_ask(f'one of {listed}') if joint is None else toml_value(joint)}")
    lines.append(f"reduction_ratio = {_ask('N of the gear, from its data sheet')}")
    if drawn is None:
        lines.append(f"tip_lever_m = {_ask('distance of the accelerometer from this axis, in m, measured')}")
    if _is_as_found(node):
        lines += [
            "# its maker's tool sets the gains of its loop; to cancel the vibration, state them here (docs/real-drive.md)",
            f"control = {toml_value(AS_FOUND)}",
        ]
    return [*lines, *_limit_lines(number, node), *_control_lines(number, node)]


def _limit_lines(number: int, node: FoundNode) -> list[str]:
    """Return the lines of an axis' limits, most of them placeholders."""
    allows = "" if node.speed_limit_rps is None else f"; the drive itself allows {node.speed_limit_rps:.4g}"
    torque = _ask("largest motor torque, in N·m")
    if node.scaling is not None:
        torque = f"{node.scaling.rated_torque_nm:.6g}                   # rated torque of the drive (6076h); less is better"
    return [
        "",
        f"[axis.{number}.limits]                     # motor side; master and drive hold them",
        f"torque_nm = {torque}",
        f"speed_rps = {_ask(f'largest motor speed, in rev/s{allows}')}",
        f"acceleration_rps_s = {_ask('largest motor acceleration that a motion may ask for, in rev/s²')}",
        f"position_min_rev = {_ask('lowest position of the motor, in rev, before the stop; measured')}",
        f"position_max_rev = {_ask('highest position of the motor, in rev, before the stop; measured')}",
    ]


def _control_lines(number: int, node: FoundNode) -> list[str]:
    """Return the lines of the loop's gains, if the drive has any."""
    if _is_as_found(node):
        return []
    if node.control is not None:
        lines = [f"{key} = {value:.6g}" for key, value in node.control.model_dump().items()]
        return ["", f"[axis.{number}.control]                    # gains of the loop, as the drive holds them now", *lines]
    lines = [f"{key} = {_ask('gain of the loop, docs/tuning.md')}" for key in Control.model_fields]
    return [
        "",
        f"[axis.{number}.control]                    # gains of the loop, which the drive does not show",
        *lines,
    ]


def _is_as_found(node: FoundNode) -> bool:
    """True if the profile has no gains, which the maker's tool sets."""
    return node.profile is not None and not node.knows_gains


def _motion_lines() -> list[str]:
    """A motion for `hil run constant-acceleration`."""
    return [
        "",
        "[constant_acceleration]              # a ramp of the motor's speed, within the limits",
        f"acceleration_rps_s = {_ask('in rev/s², 4 or so')}",
        f"end_rps = {_ask('highest speed, in rev/s, below speed_rps')}",
        f"deceleration_rps_s = {_ask('in rev/s²')}",
        "dwell_s = 0.2",
        "tail_s = 0.5",
    ]
