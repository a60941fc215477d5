"""A cycle of a run in plain Python: the specification of `hil/master/run.c`.

Axes and guards are objects with the fields of `struct axis_data`, and those of `tests.oracles.guard`.
"""

from collections.abc import Sequence
from typing import Any

from drive_profiles.standard.units import Scaling
from tests.oracles.guard import IN_ORDER, Guard


class RefusedError(Exception):
    """A torque offset is beyond its limit."""


def targets(
    scalings: Sequence[Scaling],
    references: Sequence[float],
    torques_nm: Sequence[float],
    limits_nm: Sequence[float],
    before: Sequence[int],
) -> tuple[list[int], list[int]]:
    """Set-points in counts, and torque offsets in per mille; `before` has the offsets of the last cycle.

    Raises:
        OutOfRangeError: A value does not fit its object.
        RefusedError: A torque offset is beyond its limit.
    """
    counts, offsets = [], list(before)
    for i, (scaling, reference, torque) in enumerate(zip(scalings, references, torques_nm, strict=True)):
        counts.append(scaling.position_counts(reference))
        if torque or offsets[i]:
            if not abs(torque) <= limits_nm[i]:
                raise RefusedError
            offsets[i] = scaling.torque_per_mille(torque)
    return counts, offsets


def within_speed(wanted: Sequence[float], sent: Sequence[float], steps: Sequence[float]) -> list[float]:
    """Set-points that are at most a step from those of the last cycle."""
    return [min(max(each, last - step), last + step) for each, last, step in zip(wanted, sent, steps, strict=True)]


def discard_wild(axes: Sequence[Any], guards: Sequence[Guard], scalings: Sequence[Scaling], trusted: list[int]) -> None:
    """Replace impossible positions by the last possible ones."""
    for i, (axis, guard, scaling) in enumerate(zip(axes, guards, scalings, strict=True)):
        if guard.accepts(scaling.position_rad(axis.position_counts), axis.missing):
            trusted[i] = axis.position_counts
        else:
            axis.position_counts = trusted[i]


def row(
    axes: Sequence[Any], scalings: Sequence[Scaling], references: Sequence[float], tip: Sequence[float], missing_answers: int
) -> list[float]:
    """A row of the recording behind its time."""
    values = [*tip, float(missing_answers)]
    for axis, scaling, reference in zip(axes, scalings, references, strict=True):
        position, torque = scaling.position_rad(axis.position_counts), scaling.torque_nm(axis.torque_per_mille)
        values += [reference, position, torque, axis.notch_hz]
    return values


def check(
    axes: Sequence[Any], guards: Sequence[Guard], scalings: Sequence[Scaling], references: Sequence[float]
) -> tuple[int, int | None]:
    """What is wrong with the first axis that is not in order, and its index."""
    for i, (axis, guard, scaling, reference) in enumerate(zip(axes, guards, scalings, references, strict=True)):
        position, torque = scaling.position_rad(axis.position_counts), scaling.torque_nm(axis.torque_per_mille)
        found = guard.check(axis.status_word, position, reference, torque, axis.missing)
        if found:
            return found, i
    return IN_ORDER, None
