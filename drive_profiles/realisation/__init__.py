"""What a drive makes of a notch and of gains: quantised as it holds them, and recomputed from that."""

from drive_profiles.realisation.realise import (
    PAPER,
    Biquad,
    Deviations,
    NotRealisableError,
    PidGains,
    Realisation,
    Shape,
    Target,
    Tolerance,
    gains_for,
    held_filter,
    pid_gains,
    realise,
    shape_of,
)

__all__ = [
    "PAPER",
    "Biquad",
    "Deviations",
    "NotRealisableError",
    "PidGains",
    "Realisation",
    "Shape",
    "Target",
    "Tolerance",
    "gains_for",
    "held_filter",
    "pid_gains",
    "realise",
    "shape_of",
]
