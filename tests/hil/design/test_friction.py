import math

import numpy as np
import pytest

from hil.design.estimation import UnidentifiableError
from hil.design.friction import SlowStretch, fit_friction

SYNC = 0.002


def slow(speed_rps: float, turns: float, seed: int) -> SlowStretch:
    rng = np.random.default_rng(seed)
    angle = np.cumsum(np.full(round(turns / abs(speed_rps) / SYNC), 2.0 * math.pi * speed_rps * SYNC)) - (speed_rps > 0) * 60.0
    friction = math.copysign(0.1, speed_rps) + 1.2e-3 * 2.0 * math.pi * speed_rps
    gravity = 52.0 * np.cos(angle / 120.0 + 0.4) / 120.0
    ripple = 0.05 * np.cos(2.0 * angle) + 0.03 * np.cos(4.0 * angle)
    return SlowStretch(angle, friction + gravity + ripple + 0.01 * rng.standard_normal(len(angle)))


def test_friction_and_gravity_of_slow_turns() -> None:
    stretches = [slow(sign * speed, 20.0, seed) for seed, speed in enumerate((0.5, 1.0, 2.0)) for sign in (1, -1)]
    found = fit_friction(stretches, SYNC, 120.0)
    truth = ((found.coulomb_nm, 0.1), (found.viscous_nm_s_rad, 1.2e-3), (found.gravity_moment_nm, 52.0))
    for parameter, true in (*truth, (found.gravity_phase_deg, math.degrees(0.4))):
        assert abs(parameter.value - true) < 4.0 * parameter.standard_error + 0.01 * true
        assert parameter.relative < 0.05
    assert found.arm_span_deg > 30.0


def test_one_direction_cannot_tell_friction_from_gravity() -> None:
    with pytest.raises(UnidentifiableError, match="directions"):
        fit_friction([slow(1.0, 20.0, 1)], SYNC, 120.0)


def test_too_short_a_travel_is_refused_with_the_turns_needed() -> None:
    with pytest.raises(UnidentifiableError, match=r"turns.*needed 8"):
        fit_friction([slow(1.0, 3.0, 1), slow(-1.0, 3.0, 2)], SYNC, 120.0)
