"""Units of angle."""

import math

ARCSEC = math.pi / 180.0 / 3600.0
"""One second of arc in rad."""
