"""Scales of the nodes' numbers, from overheard objects or files."""

import math
from dataclasses import dataclass

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.profile import Profile
from drive_profiles.standard.units import counts_per_rev
from hil.bench.bench import AxisTable
from hil.errors import NodeError
from hil.logs.nodes import Node
from hil.master.drive.needs import Need
from hil.master.drive.overheard import OverheardQuestions
from hil.master.drive.scale import read_scaling
from hil.master.sensor import DIGITS_OBJECT, METRE_PER_SECOND_SQUARED, UNIT_OBJECT

_USER_UNITS = (0x607E, 0x60A8, 0x60A9)


@dataclass(frozen=True)
class Scales:
    """Scales of a drive.

    None if a scale is not known; the numbers are then shown as they are.

    Attributes:
        rev_per_count: Motor revolutions per unit of position.
        rps_per_count: Motor revolutions per second per unit of speed.
        nm_per_mille: Torque of one per mille, N·m.
    """

    rev_per_count: float | None = None
    rps_per_count: float | None = None
    nm_per_mille: float | None = None


def scales_of(node: Node, number: int, table: AxisTable | None, profile: Profile | None) -> Scales:
    """Scales of a drive.

    Args:
        node: The node as far as it is known.
        number: Number of the axis.
        table: Its table in the bench file, or None.
        profile: Its drive profile, or None.
    """
    if table is not None and profile is not None:
        try:
            scaling = read_scaling(OverheardQuestions(node), number, table, profile)
        except NodeError:
            return Scales()
        if scaling is not None:
            return Scales(
                1.0 / (2.0 * math.pi * scaling.counts_per_rad) * scaling.position_sign,
                1.0 / (2.0 * math.pi * scaling.speed_units_per_rad_s),
                scaling.torque_nm(1),
            )
    return _by_the_standard(node, table)


def _by_the_standard(node: Node, table: AxisTable | None) -> Scales:
    """Return scales by 608Fh and 6076h.

    Only for a drive without units of its own.
    """
    asked = OverheardQuestions(node)

    def said(index: int, subindex: int = 0) -> int | None:
        return asked.number(Need((index, subindex), "", ""), is_optional=True)

    increments, revolutions, feed, rated = said(0x608F, 1), said(0x608F, 2), said(0x6092, 1), said(0x6076)
    counts = None if table is None else table.encoder_counts_per_rev
    if increments and revolutions and not any(said(index) for index in _USER_UNITS):
        try:
            counts = counts_per_rev("608Fh", increments, revolutions)
        except DriveProfileError:
            counts = None
        if feed is not None and feed != counts:  # it may count by it
            counts = None
    torque = None if table is None else table.rated_torque_nm
    torque = rated * 1e-3 if rated else torque
    return Scales(
        None if counts is None else 1.0 / counts,
        None if counts is None else 1.0 / counts,
        None if torque is None else torque * 1e-3,
    )


def acceleration_scale(node: Node) -> float | None:
    """Return m/s² per step of an accelerometer."""
    asked = OverheardQuestions(node)
    digits = asked.number(Need((DIGITS_OBJECT, 1), "", ""), is_optional=True)
    unit = asked.number(Need((UNIT_OBJECT, 1), "", ""), is_optional=True)
    return 10.0**-digits if digits is not None and unit == METRE_PER_SECOND_SQUARED else None
