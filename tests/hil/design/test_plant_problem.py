"""What a plant's fit knows of the drive: how set-points become references, and what a loop that is sampled does with them."""

import math
from typing import Literal

import numpy as np
import pytest
import scipy

from hil.control.cascade import Cascade
from hil.design.frequency import TwoInertia
from hil.design.modes.problem import ArmMode, ModalProblem
from hil.design.plant_problem import (
    AGE,
    ARM_PART,
    DAMPING,
    J_L,
    J_M,
    K_G,
    LAG,
    LEVER,
    VISCOUS,
    PlantProblem,
    SamplingTiming,
    straight_line,
)
from hil.design.plant_spectra import Spectra


@pytest.mark.parametrize("periods", [4, 8, 16])
def test_a_reference_in_steps_of_the_control_period_has_the_images_of_its_samples(periods: int) -> None:
    """Against the sum over the samples of the line up to a set-point and down from it."""
    control_s = 250e-6
    sync_s = periods * control_s
    frequency = np.array([3.0, 37.0, 463.0, 537.0, 963.0, 1537.0])
    weights = np.concatenate([np.arange(1, periods + 1), np.arange(periods - 1, 0, -1)]) / periods**2
    instants = control_s * np.arange(len(weights))
    summed = np.exp(-2j * np.pi * frequency[:, np.newaxis] * instants) @ weights
    np.testing.assert_allclose(straight_line(frequency, sync_s, control_s), summed, atol=1e-12)


def simulated_spectra(plant: TwoInertia, law: Cascade, sync_s: float, control_s: float, lag_s: float) -> Spectra:
    """The last of some periods of a loop that is sampled, with a torque that is held over a SYNC, through a lag."""
    n, k, d = plant.reduction_ratio, plant.gear_stiffness_nm_rad, plant.gear_damping_nm_s_rad
    motor, arm = plant.motor_inertia_kg_m2, plant.arm_inertia_kg_m2
    slopes = np.zeros((6, 6))  # θ_m, its speed, θ_l, its speed, the torque that is felt, and the one that is demanded
    slopes[0, 1] = slopes[2, 3] = 1.0
    slopes[1, :5] = (
        -k / n**2 / motor,
        -(plant.motor_damping_nm_s_rad + d / n**2) / motor,
        k / n / motor,
        d / n / motor,
        1.0 / motor,
    )
    slopes[3, :4] = k / n / arm, d / n / arm, -k / arm, -(d + plant.arm_damping_nm_s_rad) / arm
    slopes[4, 4:] = -1.0 / lag_s, 1.0 / lag_s
    step = scipy.linalg.expm(slopes * control_s)
    period_s, frequency = 2.0, np.arange(3.0, 0.8 * 0.5 / sync_s if sync_s > 5e-3 else 50.0, 0.5)
    times = np.arange(round(period_s / sync_s)) * sync_s
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * math.pi, len(frequency))
    excitation = np.sum(np.cos(2.0 * math.pi * np.outer(times, frequency) + phases), axis=1)
    corner = 2.0 * math.pi * law.lowpass_hz
    pole, gain = (1.0 - 0.5 * corner * control_s) / (1.0 + 0.5 * corner * control_s), corner / (1.0 + 0.5 * corner * control_s)
    state, speed, before, total, error = np.zeros(6), 0.0, 0.0, 0.0, 0.0
    angle, torque = [], []
    for offset in np.tile(excitation, 4).tolist():
        angle.append(state[0])
        torque.append(state[5])
        for _ in range(round(sync_s / control_s)):
            speed, before = pole * speed + gain * (state[0] - before), state[0]
            last, error = error, -law.position_gain_per_s * state[0] - speed
            total += 0.5 * law.velocity_integral_gain_nm_rad * control_s * (error + last)
            state[5] = law.velocity_gain_nm_s_rad * error + total + offset
            state = step @ state
    bins = np.round(frequency * period_s).astype(int)
    rows = [np.fft.rfft(np.array(each)[-len(times) :])[bins] for each in (excitation, angle, torque)]
    return Spectra(frequency, *(np.stack([row] * 3) for row in rows), None)


@pytest.mark.parametrize(("sync_ms", "control_ms"), [(8.0, 0.25), (4.0, 0.25), (1.0, 0.25), (8.0, 1.0)])
@pytest.mark.parametrize("lag_ms", [1e-3, 0.3])
def test_the_images_are_those_of_a_loop_that_is_sampled(sync_ms: float, control_ms: float, lag_ms: float) -> None:
    """What the motor felt comes out to 5e-4 though a SYNC of 8 ms has images six times as large, and what it did to 5e-5."""
    plant = TwoInertia(100.0, 2e-4, 8e-4, 2.0, 0.5, 2.0 * (2.0 * math.pi * 21.0) ** 2, 20.0)
    law = Cascade(16.0, 0.06, 0.6, lowpass_hz=300.0)
    sync_s, control_s, lag_s = 1e-3 * sync_ms, 1e-3 * control_ms, 1e-3 * lag_ms
    data = simulated_spectra(plant, law, sync_s, control_s, lag_s)
    problem = PlantProblem(data, SamplingTiming(sync_s, control_s, "torque", law), plant.reduction_ratio, 1.0, 0.0)
    damping = plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad
    x = np.zeros(LEVER)
    x[[J_M, J_L, K_G, DAMPING]] = np.log(
        [plant.motor_inertia_kg_m2, plant.arm_inertia_kg_m2, plant.gear_stiffness_nm_rad, damping]
    )
    x[VISCOUS] = plant.motor_damping_nm_s_rad + plant.arm_damping_nm_s_rad / plant.reduction_ratio**2
    x[AGE], x[ARM_PART], x[LAG] = 0.5 * control_s, plant.arm_damping_nm_s_rad / damping, lag_s
    of_torque, of_angle, _, foretold = problem.images(x)
    angle, felt = data.angle[0] - of_angle, problem.torque(x, data.torque[0], of_torque) * problem.felt(x)
    response = problem.angle_per_torque(x, data.frequency_hz, 0.0)
    assert np.max(np.abs(angle / foretold - 1.0)) < 5e-5
    assert np.max(np.abs(angle / (response * felt) - 1.0)) < 5e-4


@pytest.mark.parametrize("kind", ["torque", "reference"])
@pytest.mark.parametrize("has_tip", [True, False])
@pytest.mark.parametrize("law", [Cascade(16.0, 0.06, 0.6, lowpass_hz=300.0), None])
def test_slopes_are_those_of_the_residual(kind: Literal["torque", "reference"], has_tip: bool, law: Cascade | None) -> None:
    """Against central differences at a point at which nothing is zero, with one mode and with three."""
    draw = np.random.default_rng(3)
    frequency = np.arange(3.0, 40.0, 0.5)
    rows = draw.normal(size=(2, 4, 5, len(frequency)))
    angle, torque, tip, excitation = (rows[0] + 1j * rows[1]) * np.array([1e-3, 0.1, 0.5, 0.1])[:, None, None]
    data = Spectra(frequency, excitation, angle, torque, tip if has_tip else None)
    problem = ModalProblem(data, SamplingTiming(4e-3, 250e-6, kind, law), 100.0, 0.5, 20.0)
    part = [0.7, 0.2, 0.1] if has_tip else [None] * 3
    modes = [ArmMode(j, f, z, p) for j, f, z, p in zip((5.0, 2.0, 1.0), (8.0, 13.0, 25.0), (0.05, 0.03, 0.04), part, strict=True)]
    for count in (1, 3):
        x = problem.start_with(np.array([4e-4, 1e-3]), modes[:count])
        x[LAG] = 3e-4
        x += 0.3 * problem.scale(x) * draw.normal(size=len(x))
        steps = 1e-4 * problem.scale(x)
        sides = [(problem.residual(x + step) - problem.residual(x - step)) / 2.0 for step in np.diag(steps)]
        np.testing.assert_allclose(problem.slopes(x) * steps, np.stack(sides, axis=1), rtol=1e-5, atol=1e-7)
