"""Numbers of the paper's Tables 2 and 3, for comparison; those of Table 1 are in `hil.experiments.plan`.

Source: `CITATION`, Tables 2 and 3.
"""

from typing import NamedTuple

from hil.design.transmission_error import TransmissionError

CITATION = (
    "M. Iwasaki and H. Nakamura, “Vibration Suppression for Angular Transmission Errors in Harmonic Drive Gearings and "
    "Application to Industrial Robots”, 19th IFAC World Congress, Cape Town, 2014 (IFAC Proceedings Volumes 47)"
)
"""The paper whose control this bench runs, as every report cites it."""


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


TABLE_2 = {2: ErrorColumn(5.0, 222.0, 3.0, 126.0), 3: ErrorColumn(10.0, 262.0, 5.0, 306.0)}
TABLE_3 = {2: NotchColumn(0.5, 0.028, 0.1, 2, 4.0, 9.0), 3: NotchColumn(0.7, 0.036, 0.1, 2, 4.0, 9.0)}
