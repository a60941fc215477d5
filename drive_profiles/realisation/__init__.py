"""Realisation of a notch and of gains in a drive.

Values are rounded as the drive's objects hold them, and the filter is recomputed from the rounded values.

`realise` finds the parameter values for a `NotchTarget`, and tells how far the drive's filter is from it. `gains_for` converts
the gains of the paper's loop to the drive's units.

>>> from drive_profiles.family.profile import Profile
>>> from drive_profiles.realisation import NotchTarget, realise
>>> target = NotchTarget.at_speed(order=2, speed_rps=5.92, offset_hz=0.5, zeta_rn=0.028, zeta_rdth=0.1)
>>> nearest = realise(Profile.load("kollmorgen_akd"), target, allow_approximate=True)
>>> nearest.is_exact, nearest.values["filter_1.zero_q"]
(False, 5.0)
>>> print(nearest.reasons[0])
the zeros' damping cannot be 0.0257; the nearest is 0.1 (filter_1.zero_q = 5)
"""

from drive_profiles.errors import NotRealisableError
from drive_profiles.realisation.biquad import Biquad, NotchTarget, Shape, shape_of
from drive_profiles.realisation.gains import PidGains, gains_for, pid_gains
from drive_profiles.realisation.realise import PAPER, Deviations, Realisation, Tolerance, realise
from drive_profiles.realisation.sections import held_filter

__all__ = [
    "PAPER",
    "Biquad",
    "Deviations",
    "NotRealisableError",
    "NotchTarget",
    "PidGains",
    "Realisation",
    "Shape",
    "Tolerance",
    "gains_for",
    "held_filter",
    "pid_gains",
    "realise",
    "shape_of",
]
