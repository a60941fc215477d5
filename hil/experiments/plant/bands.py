"""The band and the bias speed of an excitation: wide for the pilot, and around the resonances once they are roughly known."""

import math

from hil.design.frequency import TwoInertia
from hil.experiments.plant.motion import Band, PlantRequest
from hil.robot_tables import ORDERS

PILOT_HZ = (1.5, 90.0)
"""Band of the pilot: an anti-resonance from 2 Hz on, a resonance up to 70 Hz."""
PER_SYNC = 0.4
"""Highest frequency times the SYNC period: a held torque loses a quarter of it there, and its first image is half as large."""
BELOW_F_A, ABOVE_F_R, ABOVE_F_A = 0.4, 1.8, 2.5
"""Ends of the main run's band: low ones over f_a, high ones over f_r and f_a."""
LEAST_HZ, LEAST_HIGH_HZ = 1.0, 30.0
LARGEST_LOW_HZ = 3.0
BIAS_RPS = 2.0
AWAY = 1.3
"""Factor between the frequency of an order and f_a that is far enough."""
BIASES = (1.0, 1.25, 0.8, 1.5, 1.75, 0.65, 2.0, 0.5)
"""Bias speeds that are tried, as factors of the usual one."""
FASTEST_BIAS_RPS = BIAS_RPS * max(BIASES)


def highest_hz(sync_s: float) -> float:
    """Highest frequency that set-points of a SYNC period carry."""
    return PER_SYNC / sync_s


def pilot_band(request: PlantRequest, sync_s: float) -> Band:
    """Band of the pilot; what the request states, holds."""
    low, high = PILOT_HZ
    return _band(request, low, min(high, highest_hz(sync_s)), BIAS_RPS)


def main_band(request: PlantRequest, sync_s: float, plant: TwoInertia, speed_limit_rps: float) -> Band:
    """Band around the resonances of a plant that is roughly known, at a speed at which no order rings; what is requested, holds.

    Args:
        request: The request.
        sync_s: The SYNC period.
        plant: The plant, roughly.
        speed_limit_rps: Limit of the motor speed, of which the bias takes half.
    """
    f_a, f_r = plant.antiresonance_hz, plant.resonance_hz
    low = min(LARGEST_LOW_HZ, max(LEAST_HZ, BELOW_F_A * f_a))
    high = min(highest_hz(sync_s), max(LEAST_HIGH_HZ, ABOVE_F_R * f_r, ABOVE_F_A * f_a))
    return _band(request, low, high, quiet_speed(f_a, 0.5 * speed_limit_rps))


def quiet_speed(f_a: float, limit_rps: float) -> float:
    """The bias speed nearest to the usual one at which no order of the transmission error falls on f_a; else the quietest."""
    best, farthest = BIAS_RPS, 0.0
    for factor in BIASES:
        speed = factor * BIAS_RPS
        if speed > limit_rps:
            continue
        away = min(math.exp(abs(math.log(order * speed / f_a))) for order in ORDERS)
        if away >= AWAY:
            return speed
        if away > farthest:
            best, farthest = speed, away
    return best


def _band(request: PlantRequest, low_hz: float, high_hz: float, bias_rps: float) -> Band:
    return Band(
        low_hz if request.low_hz is None else request.low_hz,
        high_hz if request.high_hz is None else request.high_hz,
        bias_rps if request.bias_rps is None else request.bias_rps,
    )
