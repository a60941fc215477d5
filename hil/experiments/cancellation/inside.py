"""Cancellation by the drives themselves, in their own loops.

The drive family must support it; the bus carries no additions in a cycle.
"""

import math
import re
from collections.abc import Collection, Sequence

from drive_profiles.family.profile import Profile
from hil.bench.bench import Bench, Model
from hil.bench.model import Identified
from hil.control.angles import ARCSEC
from hil.errors import NotPossibleError
from hil.experiments.cancellation.cancellation import amplitudes_rad, phases_deg, treated_model
from hil.experiments.cancellation.effect import Part
from hil.experiments.motor_inertia import nothing_known
from hil.master.session import Session
from hil.results.acted import CancelledOrder


def cancel_inside(
    session: Session, identified: Identified | None, axes: Sequence[int], gain: float = 1.0, without: Collection[Part] = ()
) -> tuple[CancelledOrder, ...]:
    """Let the drives cancel the error in the next run.

    A fraction `gain` of it acts, 0 to 1, without some orders of axes.

    Returns:
        The orders that the drives cancel, as they hold them.

    Raises:
        NotPossibleError: A drive cannot cancel, its limits do not hold the values, or no transmission error is known of any axis.
        HilError: A drive does not answer, or refuses.
    """
    models = inside_models(session.bench, identified, axes)
    cancelled = []
    for number, model in models.items():
        axis = session.axes[number]
        amplitudes = {order: size for order, size in amplitudes_rad(model.ate).items() if Part(number, order) not in without}
        motor = {f"a{order:g}_rad": gain * axis.table.reduction_ratio * size for order, size in amplitudes.items()}
        turns = {f"phi{order:g}_rad": math.radians(degrees) for order, degrees in phases_deg(model.ate).items()}
        values = {f"a{order:g}_rad": 0.0 for order in _orders_inside(Profile.load(axis.table.profile))} | motor | turns
        values |= {"motor_inertia_kg_m2": model.motor_inertia_kg_m2, "motor_damping_nm_s_rad": model.motor_damping_nm_s_rad}
        held = {name: axis.write_parameter(f"cancellation.{name}", value) for name, value in values.items()}
        axis.write_parameter("cancellation.mode", 1)
        for order in amplitudes:
            size = held[f"a{order:g}_rad"] / (axis.table.reduction_ratio * ARCSEC)
            phase = math.degrees(held[f"phi{order:g}_rad"])
            cancelled.append(CancelledOrder(axis=number, order=order, amplitude_arcsec=size, phase_deg=phase, held_by="drive"))
    return tuple(cancelled)


def inside_models(bench: Bench, identified: Identified | None, axes: Sequence[int]) -> dict[int, Model]:
    """Models of the axes whose drives cancel, by axis number.

    Raises:
        NotPossibleError: A drive family cannot cancel, or no transmission error is known of any axis.
    """
    models = {number: model for number in axes if (model := treated_model(bench, identified, number)) is not None}
    for number, model in models.items():
        profile = Profile.load(bench.axis[number].profile)
        if "cancellation.mode" not in profile.parameters:
            raise NotPossibleError(
                f"axis {number}: drive family {profile.label} has no cancellation of its own; choose --treatment cancellation"
            )
        able, known = _orders_inside(profile), model.ate.amplitudes_arcsec()
        if not able >= known.keys():
            own, others = (", ".join(f"{order:g}" for order in sorted(each)) for each in (able, known.keys() - able))
            raise NotPossibleError(
                f"axis {number}: the drive cancels orders {own} only; the model has order {others}; choose "
                "--treatment cancellation"
            )
    if not models:
        raise NotPossibleError(nothing_known(bench, identified, axes))
    return models


def _orders_inside(profile: Profile) -> set[float]:
    """Orders that the drives of a family can cancel by themselves."""
    found = (re.fullmatch(r"cancellation\.a([0-9.]+)_rad", name) for name in profile.parameters)
    return {float(each[1]) for each in found if each is not None}
