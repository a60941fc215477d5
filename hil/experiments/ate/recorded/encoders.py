"""Joint angle against motor angle, from two encoders."""

import functools
from collections.abc import Sequence

import numpy as np

from hil.design.recorded.fit import AngleSection
from hil.design.recorded.stretches import MotionStretch, speed_of
from hil.design.recorded.swing import JointSwing, swing_of, swung_waves
from hil.experiments.ate.recorded.request import MOST_SAMPLES, ContradictedError
from hil.recordings.reading import Recorded

RATIO_OFF, RATIO_OFF_FRACTION = 0.5, 0.004
"""Bound: difference of the given and the found ratio that no eccentricity makes: absolute, and by the ratio."""
SWUNG_ACROSS = 25
"""Accuracy: samples to either side between which the speed of a swing is taken, whose square must not be that of the stamps'
jitter: a factor of 2 changes 0.004 in four recordings."""
WHOLE_WITHIN = 0.25
"""Measured: distance from a whole number within which a ratio that nobody gave is taken to be that number: 0.01 to 0.11 in four
recordings of a real robot's joints."""


def found_ratio(recorded: Recorded, stretches: Sequence[MotionStretch]) -> float:
    """Motor revolutions per joint revolution in some stretches, with sign.

    Raises:
        ContradictedError: The joint's encoder does not move.
    """
    load, motor, weight = 0.0, 0.0, 0.0
    for stretch in stretches:
        x = recorded.motor_rad[stretch.rows]
        y = recorded.value["load"][stretch.rows]
        x, y = x - np.mean(x), y - np.mean(y)
        load, motor, weight = load + float(x @ y), motor + float(x @ x), weight + float(y @ y)
    if motor <= 0.0 or abs(load) < 1e-9 * motor or weight == 0.0:
        raise ContradictedError(
            f"{recorded.path}: {recorded.column['load'].name!r} does not move while the motor turns; check that it "
            "belongs to this axis"
        )
    return motor / load


def agreed_ratio(given: float | None, found: float, recorded: Recorded) -> tuple[float, str | None]:
    """Reduction ratio, with a sentence if it was found, not given.

    Raises:
        ContradictedError: The encoders count against each other, the data contradict the ratio, or show none that is whole.
    """
    load = recorded.column["load"]
    if found < 0.0:
        unit = load.unit.text.removeprefix("-")
        turn = f"reverse it with --column load={load.name},-{unit}" if "/rev" in unit else "change the sign of one of them"
        raise ContradictedError(
            f"{recorded.path}: the encoders count in opposite directions: a revolution of the motor turns {load.name!r} by "
            f"{1.0 / found:.5f}; {turn}"
        )
    whole = round(found)
    if given is None:
        if abs(found - whole) > WHOLE_WITHIN or whole < 10:
            raise ContradictedError(
                f"{recorded.path}: the encoders show a reduction ratio of {found:.3f}, which is not a whole "
                "number of at least 10; give the ratio with --ratio, and the increments of each encoder with --column"
            )
        return float(whole), f"the reduction ratio is assumed to be {whole}: the encoders show {found:.2f}"
    if abs(found - given) > max(RATIO_OFF, RATIO_OFF_FRACTION * given):
        raise ContradictedError(
            f"{recorded.path}: a reduction ratio of {given:g} was given; the encoders show {found:.2f}"
            + (
                f"; check whether it is {whole}"
                if abs(found - whole) <= WHOLE_WITHIN
                else "; check the increments of both encoders"
            )
        )
    return given, None


def encoder_section(recorded: Recorded, stretch: MotionStretch, ratio: float, per_hz2: float) -> AngleSection:
    """Section of the joint's angle less the motor's through the gear, in rad."""
    motor, speed = recorded.motor_rad[stretch.rows], _speed(recorded, stretch)
    waves = swung_waves(motor, speed, per_hz2)
    return AngleSection(motor, recorded.value["load"][stretch.rows] - motor / ratio, waves).averaged(MOST_SAMPLES)


def joint_swing(stretches: Sequence[tuple[Recorded, MotionStretch]], ratio: float, orders: Sequence[float]) -> JointSwing | None:
    """Swing of the joint; None if a larger error hides it."""
    quickest = max(float(np.max(np.abs(_speed(recorded, stretch)))) for recorded, stretch in stretches)
    sections_at = [functools.partial(encoder_section, recorded, stretch, ratio) for recorded, stretch in stretches]
    swing = swing_of(sections_at, orders, max(orders) * quickest)
    return swing if swing is not None and swing.is_told else None


def _speed(recorded: Recorded, stretch: MotionStretch) -> np.ndarray:
    return speed_of(recorded.motor_rad, recorded.time_s, SWUNG_ACROSS)[stretch.rows]
