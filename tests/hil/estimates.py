"""Estimates of A_k and φ_k that a test states."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.control.order_keys import amplitude_key, phase_key
from hil.design.estimate import Estimate


def apart(orders: Sequence[float], mean: NDArray[np.float64], errors: NDArray[np.float64]) -> Estimate:
    """A_k in arcsec and φ_k in degrees of each order in turn, whose errors are independent."""
    names = tuple(key(order) for order in orders for key in (amplitude_key, phase_key))
    return Estimate(names, np.asarray(mean), np.diag(np.square(errors)))
