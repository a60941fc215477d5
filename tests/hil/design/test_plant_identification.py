import math

import numpy as np
import pytest

from hil.control.cascade import Cascade
from hil.control.excitation import multisine, quiet_bias_rps
from hil.design.estimation import UnidentifiableError
from hil.design.frequency import TwoInertia
from hil.design.plant_identification import (
    Descents,
    PlantEstimate,
    fit_plant,
    over_lag,
    sine_of_same_friction_rad,
    sine_of_same_spring_rad,
)
from hil.design.plant_problem import LAG as LAG_AT
from hil.design.plant_problem import LEVER as LEVER_AT
from hil.design.plant_problem import PlantProblem, SamplingTiming, Scatter, angle_response, tip_response
from hil.design.plant_spectra import Spectra, Stretch, spectra

PLANT = TwoInertia(120.0, 2.6e-4, 8e-4, 8.0, 6.0, 48950.0, 42.0)
LAW = Cascade(25.0, 0.196, 3.92, 300.0)
FREQUENCY = np.arange(3.0, 60.5, 0.5)
SYNC, AGE, LEVER = 0.002, 125e-6, 0.7
LAG = 3e-4
"""Time constant of the current loop."""


def synthetic(seed: int, periods: int = 10, noise: float = 1e-5, amplitude: float = 0.1, lag_s: float = LAG) -> Spectra:
    """Spectra of a closed loop whose torque is reported AGE late, with white noise of the motor angle.

    The law is the reference robot's: a feedback of position and speed alone cannot tell the age of the torque from J_m and D_m.
    """
    rng = np.random.default_rng(seed)
    jw = 2j * math.pi * FREQUENCY

    def white(size: float) -> np.ndarray:
        shape = (periods, len(FREQUENCY))
        return size * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    motion = PLANT.motor_angle_per_torque(FREQUENCY) / (1.0 + jw * lag_s)
    hold = (1.0 - np.exp(-jw * SYNC)) / (jw * SYNC)
    excitation = np.tile(amplitude * np.exp(2j * math.pi * rng.random(len(FREQUENCY))), (periods, 1))
    disturbance, law = white(noise), (0.196 + 3.92 / jw) * (25.0 + jw / (1.0 + jw / (2.0 * math.pi * 300.0)))
    torque = (excitation * hold - law * disturbance) / (1.0 + law * motion)
    angle = motion * torque + disturbance
    feedback = torque - excitation * hold
    reported = excitation * np.exp(-jw * SYNC) + feedback * np.exp(-jw * AGE)
    tip = tip_response(PLANT, FREQUENCY, 1.1 * LEVER, 1e-3) * (angle - disturbance) + white(0.01)
    return Spectra(FREQUENCY, excitation, angle, reported, tip)


def timing() -> SamplingTiming:
    return SamplingTiming(SYNC, 2.0 * AGE, "torque", None)


def test_the_plant_comes_back_from_a_closed_loop_with_noise() -> None:
    found = fit_plant(synthetic(1), timing(), 120.0, LEVER)
    assert found.plant.antiresonance_hz == pytest.approx(PLANT.antiresonance_hz, rel=1e-3)
    assert found.plant.resonance_hz == pytest.approx(PLANT.resonance_hz, rel=2e-3)
    assert found.plant.gear_stiffness_nm_rad == pytest.approx(PLANT.gear_stiffness_nm_rad, rel=5e-3)
    assert found.parameters["lever_ratio"].value == pytest.approx(1.1, rel=5e-3)
    assert found.misfit == pytest.approx(1.0, abs=0.25)


@pytest.mark.ci
def test_a_fit_that_ends_a_hair_s_breadth_from_the_bound_of_its_lag_is_one_at_the_bound() -> None:
    problem = PlantProblem(synthetic(1, lag_s=0.0), timing(), 120.0, LEVER, 0.0)
    fit = min(Descents(problem).of(problem.first_guesses()), key=lambda each: float(each.cost))
    low = problem.bounds(fit.x)[0][LAG_AT]
    means, covariances = [], []
    for beside in (0.0, 1e-21, 1e-13, 1e-10):
        fit.x[LAG_AT] = low + beside
        mean, covariance = over_lag(problem, fit)
        means.append(mean)
        covariances.append(covariance)
    errors = np.sqrt(np.diag(covariances[0]))
    assert np.max(np.abs(np.array(means[1:]) - means[0]) / errors) < 1e-3
    assert np.max(np.abs(np.sqrt([np.diag(each) for each in covariances[1:]]) / errors - 1.0)) < 1e-3


@pytest.mark.slow
def test_standard_errors_are_what_the_scatter_over_seeds_is() -> None:
    truth = {
        "gear_stiffness_nm_rad": PLANT.gear_stiffness_nm_rad,
        "motor_inertia_kg_m2": PLANT.motor_inertia_kg_m2,
        "arm_inertia_kg_m2": PLANT.arm_inertia_kg_m2,
        "antiresonance_hz": PLANT.antiresonance_hz,
        "resonance_hz": PLANT.resonance_hz,
        "damping": 48.0 / (2.0 * math.sqrt(48950.0 * 8.0)),
        "viscous_damping_nm_s_rad": 8e-4 + 6.0 / 120.0**2,
        "torque_age_s": AGE,
        "torque_lag_s": LAG,
    }
    away: dict[str, list[float]] = {name: [] for name in truth}
    for seed in range(14):
        found = fit_plant(synthetic(seed, noise=1e-4), timing(), 120.0, LEVER)
        for name, true in truth.items():
            parameter = found.parameters[name]
            away[name].append((parameter.value - true) / parameter.standard_error)
    for name, values in away.items():
        # the age is just what is believed of it, so that what leans on it is nearer than its error says
        assert 0.4 < math.sqrt(float(np.mean(np.square(values)))) < 1.6, name


@pytest.mark.ci
def test_without_the_accelerometer_it_says_less_but_nothing_else() -> None:
    data = synthetic(3, noise=3e-4)  # with less the motor alone shows f_a as well as both do
    with_tip = fit_plant(data, timing(), 120.0, LEVER)
    without = fit_plant(Spectra(data.frequency_hz, data.excitation, data.angle, data.torque, None), timing(), 120.0, LEVER)
    assert without.tip is None
    assert "lever_ratio" not in without.parameters
    assert without.plant.antiresonance_hz == pytest.approx(with_tip.plant.antiresonance_hz, rel=3e-3)
    assert without.parameters["antiresonance_hz"].standard_error > 1.2 * with_tip.parameters["antiresonance_hz"].standard_error


@pytest.mark.ci
def test_more_noise_means_less_coherence_and_larger_errors() -> None:
    quiet, loud = (fit_plant(synthetic(4, noise=noise), timing(), 120.0, LEVER) for noise in (2e-5, 5e-4))
    assert np.median(loud.response.coherence) < np.median(quiet.response.coherence)
    assert loud.parameters["resonance_hz"].standard_error > 3.0 * quiet.parameters["resonance_hz"].standard_error


@pytest.mark.slow
def test_the_circle_of_confidence_holds_the_true_response() -> None:
    inside = []
    for seed in range(8):
        response = fit_plant(synthetic(seed), timing(), 120.0, LEVER).response
        inside.append(np.abs(response.value - PLANT.motor_angle_per_torque(FREQUENCY)) <= response.radius)
    assert 0.9 < np.mean(inside) < 0.995


def test_gravity_is_a_spring_on_the_arm() -> None:
    assert np.allclose(angle_response(PLANT, FREQUENCY), PLANT.motor_angle_per_torque(FREQUENCY))
    stiffer = np.abs(tip_response(PLANT, FREQUENCY, LEVER, gravity_nm_rad=-2000.0))
    assert FREQUENCY[np.argmax(stiffer)] < FREQUENCY[np.argmax(np.abs(tip_response(PLANT, FREQUENCY, LEVER)))]


@pytest.mark.parametrize(("periods", "lines", "what"), [(2, 115, "periods"), (5, 8, "lines")])
def test_too_little_is_refused_with_the_number_needed(periods: int, lines: int, what: str) -> None:
    data = synthetic(1, periods)
    few = Spectra(*(getattr(data, name)[..., :lines] for name in ("frequency_hz", "excitation", "angle", "torque")), None)
    with pytest.raises(UnidentifiableError, match=rf"{what}.*needed") as caught:
        fit_plant(few, timing(), 120.0, LEVER)
    assert caught.value.value < caught.value.needed


def test_a_lever_without_end_is_left_for_the_bench_files() -> None:
    """It leaves nothing of a tip whose images are open: 51325, 30 Hz and 8 ms, had 10¹⁶ times its lever and a delay 13 ms off."""
    problem = PlantProblem(synthetic(1), timing(), 120.0, LEVER, 0.0)
    x = problem.start(np.log([PLANT.motor_inertia_kg_m2, PLANT.arm_inertia_kg_m2, PLANT.gear_stiffness_nm_rad, 10.0, 1.0]))
    x[4] = PLANT.motor_damping_nm_s_rad
    problem.focus(PLANT.antiresonance_hz)
    x[LEVER_AT] = math.log(1.9)
    assert all(each[LEVER_AT] == x[LEVER_AT] for each in problem.with_other_delay(x))
    x[LEVER_AT] = 20.0
    *_, fresh = problem.with_other_delay(x)
    assert fresh[LEVER_AT] == 0.0
    assert np.array_equal(fresh[:LEVER_AT], x[:LEVER_AT])


# -- spectra -----------------------------------------------------------------------------------------------------------


def test_a_drift_is_removed_without_touching_the_signal() -> None:
    samples, periods = 500, 5
    time = np.arange(samples * periods) * SYNC
    signal = 3.0 * np.cos(2.0 * math.pi * 3.0 * time) + 0.01 * np.sin(2.0 * math.pi * 40.0 * time)
    drift = 5.0 * time - 2.0 * time**2 + 0.3 * time**3
    stretch = Stretch(signal, signal + drift, signal - drift, None)
    found = spectra([stretch], samples, np.array([3, 40]), SYNC)
    assert np.allclose(found.angle, found.excitation, atol=1e-9)
    assert np.allclose(found.torque[:, 1], -0.01j, atol=1e-9)


@pytest.mark.parametrize("whole", [True, False])
def test_orders_of_the_transmission_error_are_neither_signal_nor_scatter(*, whole: bool) -> None:
    """Their waves were most of what the periods of many robots differed by, and none of what their means do."""
    samples, planned = 500, 5
    orders_hz = tuple(order * quiet_bias_rps(2.0, samples * SYNC, planned) for order in (1, 2, 4))
    time = np.arange(samples * (planned if whole else 3)) * SYNC
    signal = 0.01 * np.cos(2.0 * math.pi * 7.0 * time)
    waves = sum(np.cos(2.0 * math.pi * each * time + each) for each in orders_hz)
    stretch = Stretch(signal, signal + waves, signal + 2.0 * waves, signal - waves, orders_hz)
    found = spectra([stretch], samples, np.array([7]), SYNC)
    for rows in (found.angle, found.torque, found.tip):
        assert rows is not None
        assert np.allclose(rows, 0.01, atol=1e-9)


def test_what_follows_other_waves_is_turned_to_the_first() -> None:
    lines, samples, delay = np.array([3, 7, 40]), 500, 4
    waves = [(number + 1.0) * multisine(lines, np.ones(3), samples, SYNC, number).wave for number in range(3)]
    stretches = [
        Stretch(np.tile(wave, 3), np.tile(2.0 * np.roll(wave, delay), 3), np.tile(-wave, 3), np.tile(wave, 3), wave=number)
        for number, wave in enumerate(waves)
    ]
    found = spectra(stretches, samples, lines, SYNC)
    late = np.exp(-2j * math.pi * lines * delay / samples)
    assert found.waves is not None
    assert found.waves.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert np.allclose(found.excitation, found.excitation[0])
    assert np.allclose(found.angle, 2.0 * late * found.excitation[0], atol=1e-6)
    assert found.tip is not None
    assert np.allclose(found.tip, found.excitation[0], atol=1e-6)


def test_what_comes_back_with_a_wave_is_scatter_between_waves() -> None:
    """Rounding and distortion are the same in all periods of a wave: they left 40 standard errors of 40 periods of one wave."""
    rng, waves, lines = np.random.default_rng(3), np.repeat(np.arange(4), 10), 60

    def noise(count: int, size: float) -> np.ndarray:
        return size * (rng.standard_normal((count, lines)) + 1j * rng.standard_normal((count, lines))) / math.sqrt(2.0)

    stated, true = [], []
    for _ in range(50):
        output, given = noise(4, 1.0)[waves] + noise(40, 0.5), noise(40, 0.5)
        stated.append(Scatter.of(output, given, waves).output)
        true.append(np.abs(output.mean(axis=0)) ** 2)
        assert np.median(Scatter.of(output, given).output) < 0.2 * np.median(stated[-1])
    assert np.mean(stated) == pytest.approx(np.mean(true), rel=0.1)
    alike = [Scatter.of(noise(40, 0.5), given, waves).output / (0.25 / 40.0) for _ in range(50)]
    assert 1.0 < np.mean(alike) < 1.25  # the larger of two counts


def test_a_stretch_of_broken_periods_is_refused() -> None:
    rows = np.zeros(750)
    with pytest.raises(ValueError, match="not a whole number of periods"):
        spectra([Stretch(rows, rows, rows, None)], 500, np.array([3]), SYNC)


def test_an_estimate_names_every_parameter_that_the_paper_needs() -> None:
    found: PlantEstimate = fit_plant(synthetic(5), timing(), 120.0, LEVER)
    names = {"gear_stiffness_nm_rad", "gear_damping_nm_s_rad", "motor_inertia_kg_m2", "arm_inertia_kg_m2"}
    assert names | {"antiresonance_hz", "resonance_hz", "damping"} <= set(found.parameters)
    assert all(parameter.standard_error > 0.0 for parameter in found.parameters.values())


@pytest.mark.ci
def test_a_resonance_is_known_better_than_stiffness_and_inertia_which_share_their_error() -> None:
    """f_a² = K_g/J_l/(4 π²): the error of f_a follows from the covariance of both, and not from their standard errors alone."""
    found = fit_plant(synthetic(3), timing(), 120.0, LEVER)
    names = ["gear_stiffness_nm_rad", "arm_inertia_kg_m2", "antiresonance_hz"]
    both = found.values.part(names[:2])
    slope = np.array([0.5, -0.5]) / both.mean
    f_a = found.parameters["antiresonance_hz"]
    assert math.sqrt(slope @ both.covariance @ slope) == pytest.approx(f_a.relative, rel=1e-6)
    assert both.correlation[0, 1] > 0.9
    assert np.hypot(*(0.5 * found.parameters[name].relative for name in names[:2])) > 2.0 * f_a.relative


def test_a_sine_of_the_stated_torsion_meets_the_same_friction_as_the_excitation() -> None:
    """Regression of F sgn(ψ') on ψ' along the excitation, as on a gear, and along the sine."""
    angle, arm = synthetic(3).angle, PLANT.terms(2j * math.pi * FREQUENCY)
    lines = angle.mean(axis=0) / PLANT.reduction_ratio * arm[1] / (arm[1] + arm[2])
    time_s = np.arange(0.0, 2.0, 2e-5)
    rates = np.real(np.exp(2j * math.pi * np.outer(time_s, FREQUENCY)) @ (2j * math.pi * FREQUENCY * lines))
    of_excitation = float(np.sum(np.abs(rates)) / np.sum(rates**2))
    fastest = 2.0 * math.pi * PLANT.antiresonance_hz * sine_of_same_friction_rad(PLANT, FREQUENCY, angle)
    sine = fastest * np.sin(np.linspace(0.0, 2.0 * math.pi, 10000, endpoint=False))
    assert float(np.sum(np.abs(sine)) / np.sum(sine**2)) == pytest.approx(of_excitation, rel=0.05)


def test_a_sine_of_the_spring_s_torsion_meets_the_same_cubic_spring_as_the_excitation() -> None:
    """Regression of ψ³ on ψ along the excitation, as on a gear, and along the sine.

    Were all torsion at f_a, the spring's sine would be a quarter larger than friction's; f_r is twice f_a here.
    """
    angle, arm = synthetic(3).angle, PLANT.terms(2j * math.pi * FREQUENCY)
    lines = angle.mean(axis=0) / PLANT.reduction_ratio * arm[1] / (arm[1] + arm[2])
    torsion = np.real(np.exp(2j * math.pi * np.outer(np.arange(0.0, 2.0, 2e-4), FREQUENCY)) @ lines)
    amplitude = sine_of_same_spring_rad(PLANT, FREQUENCY, angle)
    sine = amplitude * np.sin(np.linspace(0.0, 2.0 * math.pi, 10000, endpoint=False))
    of_excitation = float(np.sum(torsion**4) / np.sum(torsion**2))
    assert float(np.sum(sine**4) / np.sum(sine**2)) == pytest.approx(of_excitation, rel=0.1)
    assert amplitude < sine_of_same_friction_rad(PLANT, FREQUENCY, angle)
