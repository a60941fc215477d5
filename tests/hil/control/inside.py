"""The cancellation inside a drive, as the core in C computes it."""

import numpy as np

from hil.core.library import CORE
from tests.oracles.law import InnerCancellation


def inner_cancellation(known: InnerCancellation, lowpass_hz: float, period_s: float, angle: float, speed_rad_s: float) -> tuple:
    """One sample: Δθ_ref, Δθ̇_ff and Δτ."""
    of, additions = CORE.new("inner_cancellation"), np.empty(3)
    for name, value in known._asdict().items():
        setattr(of, name, value)
    CORE.call.inner_cancellation(of, lowpass_hz, period_s, angle, speed_rad_s, CORE.pointer(additions))
    return tuple(additions.tolist())
