"""Words of the columns, as people read them."""

from hil.counting import counted

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


def robots_of(kind: str, count: int) -> str:
    """Return the number of robots of a kind, in words.

    >>> robots_of("linear", 1), robots_of("any", 40)
    ('Linear gears: 1 robot', 'Any gears: 40 robots')
    """
    return f"{KIND_NAMES[kind]}: {counted(count, 'robot')}"
