"""Band and bias speed of an excitation."""

import math
from collections.abc import Sequence

from hil.design.estimation import ROUNDING
from hil.design.frequency import CONTROL_PERIOD_S, OF_SAMPLING, RESONANCE_BAND, TwoInertia
from hil.experiments.plant.motion import FAST_RPS, SLOWER, Band, PlantRequest
from hil.master.drive.axis import DriveAxis
from hil.robot_tables import ORDERS

PILOT_HZ = (1.5, 90.0)
"""Bound: band of the pilot: an anti-resonance from 2 Hz on, a resonance up to 70 Hz."""
LEAST_HZ, LEAST_HIGH_HZ = 1.0, 30.0
"""Bound: ends of the main run's band: gravity along the way lies below, and J_m alone shows above every resonance."""
LARGEST_LOW_HZ = 3.0
"""Bound: lower end of the band: from there down the inertia of the whole axis shows, whatever the arm."""
BIAS_RPS = 2.0
"""Bound: usual bias speed: beyond most gears' Stribeck range (`STRIBECK_RAD_S`), and a turn shows every order in half a
second."""
AWAY = 1.3
"""Measured: factor between the frequency of an order and f_a that is far enough: with 1.35, τ_C of two of sixty drawn robots had
15 times the error, since slow turns were slower."""
FASTEST_BIAS_RPS = BIAS_RPS * AWAY


def loop_period_s(drive: DriveAxis) -> tuple[float, list[str]]:
    """Period of a drive's loop."""
    stated_s = drive.control_period_s()
    if stated_s > 0.0:
        return stated_s, []
    words = f"profile {drive.profile.label} does not state the period of the loop: {1e6 * CONTROL_PERIOD_S:g} µs is assumed"
    return CONTROL_PERIOD_S, [words]


def highest_hz(sync_s: float) -> float:
    """Highest frequency that set-points of a SYNC period carry."""
    return OF_SAMPLING / sync_s


def pilot_band(request: PlantRequest, sync_s: float) -> Band:
    """Band of the pilot; values of the request take precedence."""
    low, high = PILOT_HZ
    return _band(request, low, min(high, highest_hz(sync_s)), BIAS_RPS)


def main_band(request: PlantRequest, sync_s: float, plant: TwoInertia, speed_limit_rps: float, *, is_wide: bool = False) -> Band:
    """Band around the resonances of a roughly known plant.

    At its bias speed no order rings; values of the request take precedence.

    Args:
        plant: The plant, roughly.
        speed_limit_rps: Limit of the motor speed, of which the bias takes half.
        is_wide: True on an arm: up to where the pilot looked, since other modes may ring anywhere.
    """
    f_a, f_r = plant.antiresonance_hz, plant.resonance_hz
    low = min(LARGEST_LOW_HZ, max(LEAST_HZ, RESONANCE_BAND[0] * f_a))
    high = max(LEAST_HIGH_HZ, RESONANCE_BAND[1] * f_r, PILOT_HZ[1] if is_wide else 0.0)
    high = min(highest_hz(sync_s), high)
    return _band(request, low, high, quiet_speed(f_a, 0.5 * speed_limit_rps))


def quiet_speed(f_a: float, limit_rps: float) -> float:
    """Bias speed nearest to the usual one without a ringing order.

    Where an order of the transmission error falls on f_a, it is a speed at which the order is just far enough away.

    >>> quiet_speed(11.0, 10.0), round(quiet_speed(8.5, 10.0), 3)
    (2.0, 1.635)
    """
    edges = (f_a / order * far for order in ORDERS for far in ((1.0 + ROUNDING) * AWAY, (1.0 - ROUNDING) / AWAY))
    speeds = [min(BIAS_RPS, limit_rps), *(speed for speed in edges if speed <= limit_rps)]
    return _quiet(f_a, sorted(speeds, key=lambda speed: abs(math.log(speed / BIAS_RPS))))


def fast_speed(f_a: float, limit_rps: float) -> float:
    """Fastest of the slow turns for friction without a ringing order.

    >>> fast_speed(9.9, 10.0), round(fast_speed(7.0, 10.0), 3)
    (3.5, 2.45)

    Args:
        f_a: Anti-resonance, Hz.
    """
    return _quiet(f_a, [factor * min(FAST_RPS, limit_rps) for factor in SLOWER[:3]])


def _quiet(f_a: float, speeds: Sequence[float]) -> float:
    """First of some speeds at which no order falls on f_a."""
    away = [min(math.exp(abs(math.log(order * speed / f_a))) for order in ORDERS) for speed in speeds]
    first = next((speed for speed, far in zip(speeds, away, strict=True) if far >= AWAY), None)
    return speeds[away.index(max(away))] if first is None else first


def _band(request: PlantRequest, low_hz: float, high_hz: float, bias_rps: float) -> Band:
    return Band(
        low_hz if request.low_hz is None else request.low_hz,
        high_hz if request.high_hz is None else request.high_hz,
        bias_rps if request.bias_rps is None else request.bias_rps,
    )
