"""Orders in either direction alone, from results that have them."""

import cmath
import math
import re
from collections.abc import Sequence

import numpy as np

from hil.design.ate.identification import Agreement
from hil.passport.store import OrderSides
from hil.results.recorded_ate import OrderEntry, RecordedStretch

_AMPLITUDE = re.compile(r"a(\d+(?:\.\d+)?)_arcsec")


def sides_of_passes(agreement: Sequence[Agreement]) -> tuple[OrderSides, ...]:
    """Orders of an identification by direction, from its ramps."""
    by_name = {each.name: each for each in agreement}
    made = []
    for name, amplitude in by_name.items():
        found = _AMPLITUDE.fullmatch(name)
        phase = by_name.get(f"phi{found[1]}_deg") if found else None
        if found and phase is not None:
            turn = math.remainder(phase.forward - phase.backward, 360.0)
            made.append(OrderSides(float(found[1]), amplitude.forward, amplitude.backward, amplitude.sigma, turn, phase.sigma))
    return tuple(made)


def sides_of_stretches(stretches: Sequence[RecordedStretch]) -> tuple[OrderSides, ...]:
    """Return the orders of recordings in either direction.

    From stretches in both directions; the error includes the scatter of stretches in one direction.
    """
    values: dict[float, dict[int, list[OrderEntry]]] = {}
    for stretch in stretches:
        for entry in stretch.values:
            values.setdefault(entry.order, {}).setdefault(stretch.direction, []).append(entry)
    made = []
    for order, ways in sorted(values.items()):
        if set(ways) == {-1, 1}:
            (one, one_error), (other, other_error) = (_mean(ways[way]) for way in (1, -1))
            error = math.hypot(one_error, other_error)
            least = min(abs(one), abs(other))
            turn = math.degrees(cmath.phase(one / other)) if least > 0.0 else 0.0
            if error > 0.0 and least > 0.0:
                sigmas = abs(math.radians(turn)) * least / error
                made.append(OrderSides(order, abs(one), abs(other), abs(abs(one) - abs(other)) / error, turn, sigmas))
    return tuple(made)


def _mean(entries: Sequence[OrderEntry]) -> tuple[complex, float]:
    """Return the mean of A e^{jφ} and its standard error.

    The error is that of its real or imaginary part.
    """
    points = np.array([each.a_arcsec * cmath.exp(1j * math.radians(each.phi_deg)) for each in entries])
    own = float(np.mean([each.a_error_arcsec**2 for each in entries]))
    scatter = float(np.var(points, ddof=1)) / 2.0 if len(points) > 1 else 0.0
    return complex(np.mean(points)), math.sqrt(max(own, scatter) / len(points))
