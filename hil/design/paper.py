"""Numbers of the paper's Tables 1 to 3, for comparison.

Source: `CITATION`, Tables 1 to 3.
"""

from hil.control.notch import Notch
from hil.design.transmission_error import TransmissionError

CITATION = (
    "M. Iwasaki and H. Nakamura, “Vibration Suppression for Angular Transmission Errors in Harmonic Drive Gearings and "
    "Application to Industrial Robots”, 19th IFAC World Congress, Cape Town, 2014 (IFAC Proceedings Volumes 47)"
)
"""The paper whose control this bench runs, as every report cites it."""

TABLE_1 = {2: (11.84, 5.92, 2.96), 3: (11.45, 5.72, 2.86)}
"""f_al, Hz, and the motor speeds at which orders 2 and 4 meet it, rev/s, by axis."""
TABLE_2 = {
    2: TransmissionError({2: 5.0, 4: 3.0}, {2: 222.0, 4: 126.0}),
    3: TransmissionError({2: 10.0, 4: 5.0}, {2: 262.0, 4: 306.0}),
}
TABLE_3 = {2: Notch(offset_hz=0.5, zeta_rn=0.028, zeta_rdth=0.1), 3: Notch(offset_hz=0.7, zeta_rn=0.036, zeta_rdth=0.1)}
"""Both have order 2, and act from 4 to 9 rev/s, as a `Notch` does by default."""
