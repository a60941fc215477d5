"""Numbers of the paper's Tables 1 to 3, for comparison.

Source: `CITATION`, Tables 1 to 3.
"""

from typing import NamedTuple

from hil.design.transmission_error import TransmissionError

CITATION = (
    "M. Iwasaki and H. Nakamura, “Vibration Suppression for Angular Transmission Errors in Harmonic Drive Gearings and "
    "Application to Industrial Robots”, 19th IFAC World Congress, Cape Town, 2014 (IFAC Proceedings Volumes 47)"
)
"""The paper whose control this bench runs, as every report cites it."""


class ResonanceColumn(NamedTuple):
    """A column of Table 1."""

    f_al_hz: float
    f_m2_rps: float
    f_m4_rps: float


class ErrorColumn(NamedTuple):
    """A column of Table 2: the transmission error."""

    a2_arcsec: float
    phi2_deg: float
    a4_arcsec: float
    phi4_deg: float

    def of(self, order: float) -> tuple[float | None, float | None]:
        """Return amplitude in arcsec and phase in degrees of one order."""
        return {2: (self.a2_arcsec, self.phi2_deg), 4: (self.a4_arcsec, self.phi4_deg)}.get(int(order), (None, None))

    def error(self) -> TransmissionError:
        """θ_sync of the paper."""
        return TransmissionError({2: self.a2_arcsec, 4: self.a4_arcsec}, {2: self.phi2_deg, 4: self.phi4_deg})


class NotchColumn(NamedTuple):
    """A column of Table 3: the variable notch."""

    offset_hz: float
    zeta_rn: float
    zeta_rdth: float
    order: int
    start_rps: float
    end_rps: float


TABLE_1 = {2: ResonanceColumn(11.84, 5.92, 2.96), 3: ResonanceColumn(11.45, 5.72, 2.86)}
TABLE_2 = {2: ErrorColumn(5.0, 222.0, 3.0, 126.0), 3: ErrorColumn(10.0, 262.0, 5.0, 306.0)}
TABLE_3 = {2: NotchColumn(0.5, 0.028, 0.1, 2, 4.0, 9.0), 3: NotchColumn(0.7, 0.036, 0.1, 2, 4.0, 9.0)}
