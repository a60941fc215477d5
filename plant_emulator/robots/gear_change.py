"""Tables of the robot file for a changing ATE."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.robot_tables import HIGHEST_ORDER, ORDERS, NotNegative, Positive, TransmissionErrorTable
from plant_emulator.physics.axis import LINES, put_error

MOST_LINES = LINES + 1
"""A line for each order that an axis can have, and one for the rest."""

LOWEST_C, HIGHEST_C = -60.0, 200.0
"""Temperatures that a gear's lubricant tolerates, with some margin."""

Celsius = Annotated[float, Field(ge=LOWEST_C, le=HIGHEST_C)]
Percent = Annotated[float, Field(ge=-100.0, le=100.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]


class ErrorChange(Table):
    """Change of one order of the ATE.

    A line without an order is for all orders that have no line of their own.

    Time and revolutions count while the axis' brake is open. Load is the torque of the gear, on the arm side, with its sign.

    Attributes:
        order: The order; left out: every other.
        phase_step_deg: The phase jumps by so much …
        phase_step_s: … at this time.
        phase_drift_deg_min: It drifts so far in a minute.
        growth_percent_h: The amplitude grows by this part of its first value in an hour.
        growth_percent_mrev: The same in a million revolutions of the motor.
        load_percent_nm: Change of the amplitude with the load.
        load_deg_nm: Change of the phase with the load.
        direction_percent: Half of the difference of the amplitude between both directions.
        direction_deg: Half of the difference of the phase.
        temperature_percent_k: Change of the amplitude with the temperature.
        temperature_deg_k: Change of the phase with the temperature.
    """

    order: Annotated[float, Field(gt=0.0, le=HIGHEST_ORDER)] | None = None
    phase_step_deg: Degrees = 0.0
    phase_step_s: NotNegative | None = None
    phase_drift_deg_min: float = 0.0
    growth_percent_h: NotNegative = 0.0
    growth_percent_mrev: NotNegative = 0.0
    load_percent_nm: Percent = 0.0
    load_deg_nm: Degrees = 0.0
    direction_percent: Percent = 0.0
    direction_deg: Degrees = 0.0
    temperature_percent_k: Percent = 0.0
    temperature_deg_k: Degrees = 0.0

    @model_validator(mode="after")
    def _step_is_whole(self) -> "ErrorChange":
        if (self.phase_step_s is None) != (self.phase_step_deg == 0.0):
            raise ValueError("phase_step_deg or phase_step_s is missing; give both or neither")
        return self


class GearTemperature(Table):
    """Temperature of a gear: initial value and effect of losses.

    Attributes:
        start_c: Temperature when the robot is switched on.
        reference_c: Temperature at which the transmission error has its values of `ate`.
        ambient_c: Temperature of the surroundings.
        resistance_k_w: Rise above that for each watt that friction loses; 0: none.
        time_constant_s: Time constant of the rise.
    """

    start_c: Celsius = 20.0
    reference_c: Celsius = 20.0
    ambient_c: Celsius = 20.0
    resistance_k_w: NotNegative = 0.0
    time_constant_s: Positive = 1800.0


def check_changes(changes: Sequence[ErrorChange], error: TransmissionErrorTable, most_load_nm: float) -> None:
    """Refuse changes of missing orders, and amplitudes that turn negative.

    `most_load_nm` is the torque of the gear at the motor's torque limit.

    Raises:
        ValueError: The message names the order.
    """
    present, named = error.amplitudes_arcsec(), [line.order for line in changes]
    for line in changes:
        words = "the line without order" if line.order is None else f"order {line.order:g}"
        if named.count(line.order) > 1:
            raise ValueError(f"ate_change: {words} is given twice")
        if line.order is not None and line.order not in present:
            there = ", ".join(f"{order:g}" for order in present) or "none"
            raise ValueError(f"ate_change: {words} changes, but ate has no such order; it has {there}")
        most = abs(line.load_percent_nm) * most_load_nm + abs(line.direction_percent)
        if most > 100.0:
            raise ValueError(
                f"ate_change: {words}: load_percent_nm {line.load_percent_nm:g} at the gear's {most_load_nm:.0f} N·m and "
                f"direction_percent {line.direction_percent:g} make {most:.0f} %: an amplitude would become negative"
            )


def write_change(changes: Sequence[ErrorChange], error: TransmissionErrorTable, heat: GearTemperature, row: Any) -> None:
    """Write the ATE's changes and state at switch-on into an `AXIS` record.

    Args:
        error: Its transmission error when the gear is new.
        heat: Its temperature, and what that follows from.
        row: The record, changed in place; the axis' plant is in it already.
    """
    row["past"]["temperature_c"] = heat.start_c
    if not changes:
        return
    change, plant = row["change"], row["plant"]
    change["is_changing"] = 1.0
    change["reference_c"], change["ambient_c"] = heat.reference_c, heat.ambient_c
    change["resistance_k_w"], change["thermal_constant_s"] = heat.resistance_k_w, heat.time_constant_s
    change["step_s"] = math.inf
    named = (plant["a1_rad"], plant["a2_rad"], plant["a4_rad"]), (plant["phi1_rad"], plant["phi2_rad"], plant["phi4_rad"])
    change["a_rad"], change["phi_rad"] = (*named[0], *plant["more_rad"]), (*named[1], *plant["more_phi_rad"])
    lines = {line.order: line for line in changes}
    for i, order in enumerate((*ORDERS, *(line.order for line in error.more))):
        line = lines.get(order, lines.get(None))
        if line is not None:
            _write_line(line, change, i)
    put_error(change, row["past"], plant)


def _write_line(line: ErrorChange, change: Any, i: int) -> None:
    change["step_rad"][i] = math.radians(line.phase_step_deg)
    change["step_s"][i] = math.inf if line.phase_step_s is None else line.phase_step_s
    change["drift_rad_s"][i] = math.radians(line.phase_drift_deg_min) / 60.0
    change["growth_per_s"][i] = line.growth_percent_h / 100.0 / 3600.0
    change["growth_per_rad"][i] = line.growth_percent_mrev / 100.0 / (2.0 * math.pi * 1e6)
    change["load_per_nm"][i], change["load_rad_nm"][i] = line.load_percent_nm / 100.0, math.radians(line.load_deg_nm)
    change["direction_part"][i], change["direction_rad"][i] = line.direction_percent / 100.0, math.radians(line.direction_deg)
    change["warmth_per_k"][i] = line.temperature_percent_k / 100.0
    change["warmth_rad_k"][i] = math.radians(line.temperature_deg_k)
