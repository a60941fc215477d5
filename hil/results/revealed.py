"""True numbers of an emulated robot beside the identified ones.

Their comparison shows the quality of the identification, after all runs.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from hil.bench.model import IdentifiedAxis
from hil.results.comparison import TourFact
from hil.robot_tables import ORDERS, amplitude_key, phase_key

PLANT = (
    ("J_m", "motor inertia", "kg·cm²", "motor_inertia_kg_m2", 1e4),
    ("J_l", "arm inertia", "kg·m²", "arm_inertia_kg_m2", 1.0),
    ("K_g", "gear stiffness", "kN·m/rad", "gear_stiffness_nm_rad", 1e-3),
)
"""Symbol, name, unit, key and factor of the plant's numbers."""
UNSEEN = (
    ("F", "hysteresis of the gear", "N·m", "hysteresis_torque_nm", 1.0, 0.0),
    ("", "soft wind-up", "%", "wind_up_softness", 100.0, 0.0),
    ("", "lag of the current loop", "ms", "current_time_constant_s", 1e3, 0.0),
)
"""The same, and the default, of numbers that nothing looks for."""


def facts_of(number: int, truth: Mapping[str, Any], known: IdentifiedAxis) -> Iterator[TourFact]:
    """Facts of one axis.

    Args:
        number: Axis number.
        truth: The axis' table of the robot file.
        known: Identified parts of the axis.
    """
    yield _antiresonance(number, truth, known)
    plant = known.plant
    for symbol, name, unit, key, factor in PLANT:
        estimate = None if plant is None else factor * getattr(plant.values, key)
        error = None if plant is None or key not in plant.standard_error else factor * plant.standard_error[key]
        yield TourFact(
            axis=number, symbol=symbol, name=name, unit=unit, truth=factor * truth[key], estimate=estimate, standard_error=error
        )
    coulomb = None if plant is None else plant.coulomb_friction_nm
    error = None if plant is None else plant.standard_error.get("coulomb_friction_nm")
    yield TourFact(
        axis=number, symbol="τ_C", name="Coulomb friction", unit="N·m", truth=truth.get("coulomb_friction_nm", 0.0),
        estimate=coulomb, standard_error=error,
    )  # fmt: skip
    yield from _orders(number, truth["ate"], known)
    for symbol, name, unit, key, factor, default in UNSEEN:
        yield TourFact(axis=number, symbol=symbol, name=name, unit=unit, truth=factor * truth.get(key, default))


def _antiresonance(number: int, truth: Mapping[str, Any], known: IdentifiedAxis) -> TourFact:
    """f_a, of the gear at its nominal stiffness."""
    plant = known.plant
    return TourFact(
        axis=number, symbol="f_a", name="antiresonance", unit="Hz",
        truth=math.sqrt(truth["gear_stiffness_nm_rad"] / truth["arm_inertia_kg_m2"]) / (2.0 * math.pi),
        estimate=None if plant is None else plant.antiresonance_hz,
        standard_error=None if plant is None else plant.standard_error.get("antiresonance_hz"),
    )  # fmt: skip


def _orders(number: int, truth: Mapping[str, float], known: IdentifiedAxis) -> Iterator[TourFact]:
    """Yield amplitude and phase of each order.

    The true phase is within half a turn of its estimate.
    """
    error = known.ate
    amplitudes = {} if error is None else error.values.amplitudes_arcsec()
    phases = {} if error is None else error.values.phases_deg()
    errors = {} if error is None else error.standard_error
    for order in ORDERS:
        amplitude, phase = amplitude_key(order), phase_key(order)
        if not truth.get(amplitude, 0.0) > 0.0:
            continue
        yield TourFact(
            axis=number, symbol=f"A_{order}", name=f"error of order {order}", unit="arcsec", truth=truth[amplitude],
            estimate=amplitudes.get(order), standard_error=errors.get(amplitude) if order in amplitudes else None,
        )  # fmt: skip
        found = phases.get(order)
        true = truth.get(phase, 0.0)
        nearest = true if found is None else found + (true - found + 180.0) % 360.0 - 180.0
        yield TourFact(
            axis=number, symbol=f"φ_{order}", name="its phase", unit="°", truth=nearest, estimate=found,
            standard_error=errors.get(phase) if order in phases else None,
        )  # fmt: skip
