"""Access to rows by their columns' names, and these in words."""

from collections.abc import Sequence

from hil.counting import counted
from hil.robot_tables import ORDERS
from plant_emulator.rehearsal.record import IS_DONE, TREATED
from plant_emulator.trials.rows import Row, number, text


def is_done(row: Row, step: str) -> bool:
    """Return True if the step has its result."""
    return text(row, f"{step}_ended") in IS_DONE


def tips_mm(row: Row, treatment: str) -> dict[int, float]:
    """Return the true tip by order under a treatment or `floor`."""
    found = {order: number(row, f"tip_{treatment}_k{order}_mm") for order in ORDERS}
    return {order: value for order, value in found.items() if value is not None}


def worst_tip_mm(row: Row, treatment: str) -> float | None:
    """Return the true tip of the worst order."""
    return max(tips_mm(row, treatment).values(), default=None)


def is_quiet(row: Row) -> bool:
    """Return True if the path's true tip meets the goal."""
    return row.get("is_quiet") is True


def accepted(row: Row) -> list[str]:
    """Return the accepted treatments whose true tip is known."""
    return [name for name in TREATED if is_done(row, name) and tips_mm(row, name)]


def of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return the rows of a kind's robots."""
    return [row for row in rows if row.get("kind") == kind]


KIND_NAMES = {"linear": "Linear gears", "real": "Hysteresis, softness, lag", "any": "Any gears"}

STEP_NAMES = {
    "plant": "identify plant",
    "ate": "identify ate",
    "design": "design notch",
    "none": "run: none",
    "notch": "run: Table 3",
    "notch_designed": "run: designed",
    "cancellation": "run: cancellation",
    "learn": "learn",
    "cancellation_learnt": "run: learnt",
}

TREATMENT_NAMES = {
    "none": "nothing",
    "notch": "Table 3",
    "notch_designed": "designed",
    "cancellation": "cancelled",
    "cancellation_learnt": "learnt",
    "floor": "floor",
}

_ERRORS = {
    name: symbol
    for order, index in ((1, "₁"), (2, "₂"), (4, "₄"))
    for name, symbol in ((f"a{order}_arcsec", f"A{index}"), (f"phi{order}_deg", f"φ{index}"))
}

QUANTITY_NAMES = {
    "motor_inertia_kg_m2": "motor inertia",
    "arm_inertia_kg_m2": "arm inertia",
    "gear_stiffness_nm_rad": "gear stiffness",
    "antiresonance_hz": "antiresonance",
    "resonance_hz": "resonance",
    "damping": "damping",
    "motor_damping_nm_s_rad": "motor damping",
    "arm_damping_nm_s_rad": "arm damping",
    "coulomb_friction_nm": "Coulomb friction",
    "gravity_moment_nm": "gravity's moment",
    "accelerometer_delay_s": "accelerometer delay",
    **_ERRORS,
    **{f"learnt_{name}": f"{symbol}, learnt" for name, symbol in _ERRORS.items()},
}

FACT_NAMES = {
    "antiresonance_hz": ("Antiresonance $f_a$ (Hz)", 1.0),
    "a1_arcsec": ("A₁ (arcsec)", 1.0),
    "a2_arcsec": ("A₂ (arcsec)", 1.0),
    "encoder_bits": ("Encoder (bits)", 1.0),
    "sync_period_s": ("SYNC period (ms)", 1e3),
    "noise_m_s2": ("Sensor noise (m/s²)", 1.0),
    "hysteresis_nm": ("Hysteresis (N·m)", 1.0),
    "softness": ("Softness (%)", 100.0),
    "current_lag_s": ("Current lag (ms)", 1e3),
}
"""Name and factor of a fact, for the axis of a figure."""


def by_kind(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Return the kinds that there are, each with its robots."""
    return [(kind, own) for kind in KIND_NAMES if (own := of_kind(rows, kind))]


def robots_of(kind: str, count: int) -> str:
    """Return the number of robots of a kind, in words.

    >>> robots_of("linear", 1), robots_of("any", 40)
    ('Linear gears: 1 robot', 'Any gears: 40 robots')
    """
    return f"{KIND_NAMES[kind]}: {counted(count, 'robot')}"
