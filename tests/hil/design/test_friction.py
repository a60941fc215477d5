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
        assert parameter.relative < 0.08
    assert found.arm_span_deg > 30.0


def test_one_direction_cannot_tell_friction_from_gravity() -> None:
    with pytest.raises(UnidentifiableError, match="directions"):
        fit_friction([slow(1.0, 20.0, 1)], SYNC, 120.0)


def test_too_short_a_travel_is_refused_with_the_turns_needed() -> None:
    with pytest.raises(UnidentifiableError, match=r"turns.*needed 8"):
        fit_friction([slow(1.0, 3.0, 1), slow(-1.0, 3.0, 2)], SYNC, 120.0)


def sagging(speed_rps: float, stiffness_nm_rad: float, law: float = 0.0) -> SlowStretch:
    """A stretch of an arm that hangs below its gear by the gravity moment over K_g; `law` is added to friction at this speed."""
    angle = (
        np.cumsum(np.full(round(30.0 / abs(speed_rps) / SYNC), 2.0 * math.pi * speed_rps * SYNC))
        + (speed_rps < 0) * 190.0
        + 100.0
    )
    arm = angle / 120.0
    for _ in range(50):
        arm = angle / 120.0 - 52.0 * np.cos(arm + 0.4) / stiffness_nm_rad
    noise = 1e-4 * np.random.default_rng(3).standard_normal(len(angle))
    torque = math.copysign(0.1 + law, speed_rps) + 1.2e-3 * 2.0 * math.pi * speed_rps + 52.0 * np.cos(arm + 0.4) / 120.0
    return SlowStretch(angle, torque + noise)


def test_an_arm_that_hangs_on_a_soft_gear_has_its_gravity_moment() -> None:
    """Fitted to θ_m/N alone it was 1 % off, seven standard errors."""
    stretches = [sagging(sign * speed, 5000.0) for speed in (0.5, 1.0, 2.0) for sign in (1, -1)]
    found = fit_friction(stretches, SYNC, 120.0, 5000.0).gravity_moment_nm
    assert abs(found.value - 52.0) < 3.0 * found.standard_error
    assert found.relative < 2e-3
    stiff = fit_friction(stretches, SYNC, 120.0).gravity_moment_nm
    assert abs(stiff.value - 52.0) > 4.0 * found.standard_error


def test_what_friction_does_beside_its_law_at_a_speed_is_in_its_error_and_not_in_that_of_gravity() -> None:
    """Turns in plenty average noise away, and not what all of them have."""

    def found(turns: int) -> tuple[float, float]:
        laws = {0.5: 2e-4, 1.0: -2e-4, 2.0: 1e-4}
        stretches = [sagging(sign * speed, 1e9, law) for speed, law in laws.items() for sign in (1, -1)] * turns
        friction = fit_friction(stretches, SYNC, 120.0)
        assert abs(friction.coulomb_nm.value - 0.1) < 3.0 * friction.coulomb_nm.standard_error
        return friction.coulomb_nm.relative, friction.gravity_moment_nm.relative

    (once, gravity_once), (often, gravity_often) = found(1), found(6)
    assert often > 0.7 * once
    assert gravity_often < gravity_once


def test_a_motor_without_friction_has_none() -> None:
    angle = np.arange(0.0, 60.0, 0.01)
    stretches = [SlowStretch(sign * speed * angle, np.zeros(len(angle))) for speed in (2.0, 5.0, 15.0) for sign in (1.0, -1.0)]
    found = fit_friction(stretches, 0.01, 100.0)
    assert found.coulomb_nm.value == pytest.approx(0.0, abs=1e-12)
    assert found.coulomb_nm.standard_error == pytest.approx(0.0, abs=1e-12)


def test_a_motor_that_its_gear_swings_to_and_fro_is_not_braked_by_that() -> None:
    """A torque of the angle alone takes no work; its mean over time is another one where the speed swings with it."""

    def swung(speed_rps: float) -> SlowStretch:
        speed = 2.0 * math.pi * speed_rps
        time = np.arange(round(8.0 / abs(speed_rps) / SYNC)) * SYNC
        swing = 2e-3 * speed
        angle = speed * time + swing * np.sin(2.0 * speed * time)
        friction = math.copysign(0.01, speed) + 5e-4 * speed * (1.0 + 2.0 * swing * np.cos(2.0 * speed * time))
        noise = 1e-5 * np.random.default_rng(round(10 * abs(speed))).standard_normal(len(angle))
        return SlowStretch(angle, friction + 0.07 * np.cos(2.0 * angle) + noise)

    found = fit_friction([swung(sign * speed) for speed in (0.4, 0.8, 1.6, 3.5) for sign in (1.0, -1.0)], SYNC, 120.0)
    assert abs(found.coulomb_nm.value - 0.01) < 3.0 * found.coulomb_nm.standard_error
    assert abs(found.viscous_nm_s_rad.value - 5e-4) < 3.0 * found.viscous_nm_s_rad.standard_error
    assert found.coulomb_nm.value == pytest.approx(0.01, rel=0.05)
