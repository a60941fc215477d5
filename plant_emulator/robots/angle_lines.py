"""Tables of the robot file for eccentricity and cogging."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from drive_profiles.files.toml import Table
from hil.control.angles import ARCSEC
from hil.robot_tables import NotNegative

HIGHEST_COGGING_ORDER = 200
"""Periods of cogging in a revolution: the least common multiple of poles and slots; 20 poles in 24 slots have 120."""


class EccentricityLine(Table):
    """One order of the ATE that is periodic in the joint.

    Parts on the arm side that are off centre cause it.

    Attributes:
        order: Periods in one revolution of the joint.
        a_arcsec: Amplitude, on the arm side.
        phi_deg: Phase where the motor angle is zero.
    """

    order: Annotated[int, Field(ge=1, le=20)]
    a_arcsec: NotNegative
    phi_deg: float = 0.0


class CoggingLine(Table):
    """One order of the motor's cogging torque.

    It comes from the motor's magnets.

    Attributes:
        order: Periods in one revolution of the motor.
        torque_nm: Amplitude, on the motor side.
        phi_deg: Phase.
    """

    order: Annotated[int, Field(ge=1, le=HIGHEST_COGGING_ORDER)]
    torque_nm: NotNegative
    phi_deg: float = 0.0


def check_orders(name: str, lines: Sequence[EccentricityLine | CoggingLine]) -> None:
    """Refuse two lines of one order.

    Raises:
        ValueError: The message names the order.
    """
    orders = [line.order for line in lines]
    if twice := sorted({order for order in orders if orders.count(order) > 1}):
        raise ValueError(f"{name}: order {twice[0]} is given twice")


def check_lines(eccentricity: Sequence[EccentricityLine], cogging: Sequence[CoggingLine], torque_limit_nm: float) -> None:
    """Refuse duplicate orders, and cogging that exceeds the motor torque.

    Raises:
        ValueError: The message names the order, or the torques.
    """
    check_orders("eccentricity", eccentricity)
    check_orders("cogging", cogging)
    most = math.fsum(line.torque_nm for line in cogging)
    if most >= torque_limit_nm:
        raise ValueError(f"cogging: {most:g} N·m in total exceed the motor's torque limit of {torque_limit_nm:g} N·m")


def write_lines(
    eccentricity: Sequence[EccentricityLine], cogging: Sequence[CoggingLine], reduction_ratio: float, row: Any
) -> None:
    """Write the lines into one record of a `PLANT` array.

    Orders of the joint become orders m/N of the motor.

    Args:
        row: The record, changed in place.
    """
    row["is_eccentric"], row["is_cogging"] = float(bool(eccentricity)), float(bool(cogging))
    for name in ("joint_orders", "joint_rad", "joint_phi_rad", "cogging_orders", "cogging_nm", "cogging_phi_rad"):
        row[name] = 0.0
    for i, line in enumerate(eccentricity):
        row["joint_orders"][i], row["joint_rad"][i] = line.order / reduction_ratio, line.a_arcsec * ARCSEC
        row["joint_phi_rad"][i] = math.radians(line.phi_deg)
    for i, each in enumerate(cogging):
        row["cogging_orders"][i], row["cogging_nm"][i] = each.order, each.torque_nm
        row["cogging_phi_rad"][i] = math.radians(each.phi_deg)
