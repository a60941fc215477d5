"""True numbers of an emulated robot beside the identified ones.

Their comparison shows the quality of the identification, after all runs.
"""

import math
from collections.abc import Iterator

from pydantic import ConfigDict

from drive_profiles.files.toml import Table
from hil.bench.model import IdentifiedAxis
from hil.control.order_keys import amplitude_key, phase_key
from hil.results.comparison import TourFact
from hil.robot_tables import ORDERS, AxisNumber, NotNegative, PlantTable, TransmissionErrorTable

PLANT = (
    ("J_m", "motor inertia", "kg·cm²", "motor_inertia_kg_m2", 1e4),
    ("J_l", "arm inertia", "kg·m²", "arm_inertia_kg_m2", 1.0),
    ("K_g", "gear stiffness", "kN·m/rad", "gear_stiffness_nm_rad", 1e-3),
)
"""Symbol, name, unit, key and factor of the plant's numbers."""
UNSEEN = (
    ("F", "hysteresis of the gear", "N·m", "hysteresis_torque_nm", 1.0),
    ("", "soft wind-up", "%", "wind_up_softness", 100.0),
    ("", "lag of the current loop", "ms", "current_time_constant_s", 1e3),
)
"""The same of numbers that nothing looks for."""


class TrueAxis(PlantTable):
    """What a tour reveals of an axis of a robot file; its other keys are the emulator's own.

    Attributes:
        wind_up_softness: Fraction of the stiffness that is missing near no torsion.
    """

    model_config = ConfigDict(extra="ignore")

    ate: TransmissionErrorTable
    coulomb_friction_nm: NotNegative = 0.0
    hysteresis_torque_nm: NotNegative = 0.0
    wind_up_softness: NotNegative = 0.0
    current_time_constant_s: NotNegative = 0.0


class TrueRobot(Table):
    """What a tour reveals of a robot file."""

    model_config = ConfigDict(extra="ignore")

    axis: dict[AxisNumber, TrueAxis]


def facts_of(number: int, truth: TrueAxis, known: IdentifiedAxis) -> Iterator[TourFact]:
    """Facts of one axis."""
    yield _antiresonance(number, truth, known)
    plant = known.plant
    for symbol, name, unit, key, factor in PLANT:
        estimate = None if plant is None else factor * getattr(plant.values, key)
        error = None if plant is None or key not in plant.standard_error else factor * plant.standard_error[key]
        yield TourFact(
            axis=number,
            symbol=symbol,
            name=name,
            unit=unit,
            truth=factor * getattr(truth, key),
            estimate=estimate,
            standard_error=error,
        )
    coulomb = None if plant is None else plant.coulomb_friction_nm
    error = None if plant is None else plant.standard_error.get("coulomb_friction_nm")
    yield TourFact(
        axis=number, symbol="τ_C", name="Coulomb friction", unit="N·m", truth=truth.coulomb_friction_nm,
        estimate=coulomb, standard_error=error,
    )  # fmt: skip
    yield from _orders(number, truth.ate, known)
    for symbol, name, unit, key, factor in UNSEEN:
        yield TourFact(axis=number, symbol=symbol, name=name, unit=unit, truth=factor * getattr(truth, key))


def _antiresonance(number: int, truth: TrueAxis, known: IdentifiedAxis) -> TourFact:
    """f_a, of the gear at its nominal stiffness."""
    plant = known.plant
    return TourFact(
        axis=number, symbol="f_a", name="antiresonance", unit="Hz",
        truth=math.sqrt(truth.gear_stiffness_nm_rad / truth.arm_inertia_kg_m2) / (2.0 * math.pi),
        estimate=None if plant is None else plant.antiresonance_hz,
        standard_error=None if plant is None else plant.standard_error.get("antiresonance_hz"),
    )  # fmt: skip


def _orders(number: int, truth: TransmissionErrorTable, known: IdentifiedAxis) -> Iterator[TourFact]:
    """Yield amplitude and phase of each order."""
    error, sizes, angles = known.ate, truth.amplitudes_arcsec(), truth.phases_deg()
    amplitudes = {} if error is None else error.values.amplitudes_arcsec()
    phases = {} if error is None else error.values.phases_deg()
    errors = {} if error is None else error.standard_error
    for order in ORDERS:
        amplitude, phase = amplitude_key(order), phase_key(order)
        if not sizes.get(order, 0.0) > 0.0:
            continue
        yield TourFact(
            axis=number, symbol=f"A_{order}", name=f"error of order {order}", unit="arcsec", truth=sizes[order],
            estimate=amplitudes.get(order), standard_error=errors.get(amplitude) if order in amplitudes else None,
        )  # fmt: skip
        found = phases.get(order)
        true = angles[order]
        nearest = true if found is None else found + (true - found + 180.0) % 360.0 - 180.0
        yield TourFact(
            axis=number, symbol=f"φ_{order}", name="its phase", unit="°", truth=nearest, estimate=found,
            standard_error=errors.get(phase) if order in phases else None,
        )  # fmt: skip
