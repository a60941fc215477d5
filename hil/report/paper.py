"""What the paper's tables say, to stand beside the bench's numbers.

Source: "Vibration Suppression for Angular Transmission Errors in Harmonic Drive Gearings and Application to Industrial Robots",
Tables 1 to 3.
"""

from typing import NamedTuple


class Resonance(NamedTuple):
    """A column of Table 1: f_al in Hz, f_m2 and f_m4 in rev/s."""

    f_al_hz: float
    f_m2_rps: float
    f_m4_rps: float


class Error(NamedTuple):
    """A column of Table 2: the transmission error."""

    a2_arcsec: float
    phi2_deg: float
    a4_arcsec: float
    phi4_deg: float


class Filter(NamedTuple):
    """A column of Table 3: the variable notch."""

    offset_hz: float
    zeta_rn: float
    zeta_rdth: float
    order: int
    start_rps: float
    end_rps: float


TABLE_1 = {2: Resonance(11.84, 5.92, 2.96), 3: Resonance(11.45, 5.72, 2.86)}
TABLE_2 = {2: Error(5.0, 222.0, 3.0, 126.0), 3: Error(10.0, 262.0, 5.0, 306.0)}
TABLE_3 = {2: Filter(0.5, 0.028, 0.1, 2, 4.0, 9.0), 3: Filter(0.7, 0.036, 0.1, 2, 4.0, 9.0)}
