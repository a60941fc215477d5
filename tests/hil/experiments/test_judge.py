"""The scale by which a bench's runs are judged."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.analysis import PAPER_BAND_HZ, PAPER_WINDOWS_RPS, Metrics, joint_scale, tip_scale
from hil.bench.bench import AxisTable, Bench, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedError
from hil.design.ringing import NoResonanceError, Ringing
from hil.errors import NotPossibleError
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest
from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus
from hil.experiments.judge import (
    FoundScale,
    RunJudge,
    axis_scale,
    check_axis_shown,
    line_scale,
    missing_words,
    peak_hz,
    unreached,
    vibration_scale,
)
from hil.experiments.window import JudgedWindow, _verdict, noise_variance
from hil.recording import Recording
from hil.robot_tables import TransmissionErrorTable

PAPER = load_bench("reference")
OWN = PAPER.model_copy(update={"reference": None})


def with_axis(bench: Bench, number: int, axis: AxisTable) -> Bench:
    return bench.model_copy(update={"axis": {**bench.axis, number: axis}})


def stiffened(bench: Bench, number: int, factor: float) -> Bench:
    """A bench with a stiffer gear, whose arm rings at a higher frequency."""
    axis = bench.axis[number]
    assert axis.model is not None
    model = axis.model.model_copy(update={"gear_stiffness_nm_rad": factor * axis.model.gear_stiffness_nm_rad})
    return with_axis(bench, number, axis.model_copy(update={"model": model}))


def without_models(bench: Bench) -> Bench:
    return bench.model_copy(update={"axis": {n: a.model_copy(update={"model": None}) for n, a in bench.axis.items()}})


@pytest.mark.parametrize("axis", [2, 3])
def test_the_papers_robot_is_judged_where_the_paper_judges_it(axis: int) -> None:
    scale = axis_scale(PAPER, axis)
    assert scale is not None
    assert scale.windows_rps == PAPER_WINDOWS_RPS == {2: (4.5, 7.5), 4: (2.2, 3.6)}
    assert (scale.band_hz, scale.peak_band_hz) == (PAPER_BAND_HZ, (8.0, 16.0)) == ((6.0, 25.0), (8.0, 16.0))
    assert scale.f_al_hz == pytest.approx({2: 11.84, 3: 11.45}[axis], abs=0.005)
    assert line_scale(PAPER) == axis_scale(PAPER, 2)


@pytest.mark.parametrize("axis", [2, 3])
def test_the_same_robot_by_another_name_is_judged_by_its_own_f_al(axis: int) -> None:
    f_al = peak_hz(OWN, axis)
    assert f_al is not None
    assert axis_scale(OWN, axis) == tip_scale(f_al)
    low, high = tip_scale(f_al).windows_rps[2]
    assert low == pytest.approx(4.5, abs=0.2), "near the paper's own window"
    assert high == pytest.approx(7.5, abs=0.3)


def test_the_line_of_another_robot_is_reckoned_with_the_lowest_f_al_of_its_axes() -> None:
    scale = line_scale(OWN)
    assert scale is not None
    assert scale.f_al_hz == peak_hz(OWN, 3)
    assert scale.f_al_hz < (peak_hz(OWN, 2) or 0.0)


def test_an_axis_that_rings_elsewhere_is_not_the_papers_whatever_the_file_says() -> None:
    changed = stiffened(PAPER, 2, 2.2)
    f_al = peak_hz(changed, 2)
    assert f_al is not None
    assert f_al > 15.0
    assert axis_scale(changed, 2) == tip_scale(f_al)


def at_period(bench: Bench, period_s: float) -> Bench:
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"sync_period_s": period_s})})


BEFORE_A_RUN: dict[str, Callable[[Bench, Path], object]] = {
    "identify ate": lambda bench, folder: identify_ate(bench, AteRequest(2), folder / "out"),
    "learn": lambda bench, folder: learn_on_bus(bench, LearnRequest((2,)), folder / "out", folder / "model.toml"),
}


@pytest.mark.parametrize("step", BEFORE_A_RUN)
def test_no_step_before_a_run_takes_a_cycle_that_the_run_refuses(step: str, tmp_path: Path) -> None:
    """With samples of 8 ms a fit of an arm of 39 Hz called a whole sensor dead, or was wrong in A_1 by 4 standard errors."""
    bench = at_period(stiffened(OWN, 2, 12.0), 0.008)
    f_al = peak_hz(bench, 2)
    assert f_al is not None
    assert f_al > 0.45 / 0.008 / 1.5
    with pytest.raises(NotPossibleError, match=r"axis 2 at a SYNC period of 8 ms: .*shorten sync_period_s") as refused:
        BEFORE_A_RUN[step](bench, tmp_path)
    assert refused.value.causes == ("cycle",)
    assert not (tmp_path / "out").exists(), "nothing has moved"


@pytest.mark.parametrize(("factor", "period_s"), [(1.0, 0.008), (12.0, 0.004)])
def test_a_cycle_that_shows_the_arm_is_taken(factor: float, period_s: float) -> None:
    check_axis_shown("a pass", at_period(stiffened(OWN, 2, factor), period_s), 2, None)


def test_a_very_stiff_arm_is_found_beyond_30_hz() -> None:
    axis = OWN.axis[2]
    assert axis.model is not None
    model = axis.model.model_copy(update={"gear_stiffness_nm_rad": 49e4, "gear_damping_nm_s_rad": 60.0})
    stiff = with_axis(OWN, 2, axis.model_copy(update={"model": model}))
    plant = stiff.axis[2].plant()
    assert plant is not None
    assert plant.antiresonance_hz > 35.0
    found, loop = peak_hz(stiff, 2), stiff.axis[2].loop(250e-6, with_notch=False)
    assert found is not None
    assert loop is not None
    below, at, above = abs(loop.acceleration_per_transmission_error(np.array([found - 1.0, found, found + 1.0])))
    assert plant.antiresonance_hz < found < plant.resonance_hz
    assert below < at > above


def test_without_a_model_there_is_no_scale_and_the_sentence_says_how_to_get_one() -> None:
    bare = without_models(PAPER)
    assert axis_scale(bare, 2) is None
    assert line_scale(bare) is None
    assert "axis 2 has no model" in missing_words([2])
    assert "hil identify plant" in missing_words([2])
    assert missing_words([2, 3]).startswith("none of the axes 2, 3 has a model")
    with pytest.raises(NotPossibleError, match="axis 2 has no model"):
        vibration_scale(bare, (2,))


def test_vibrations_that_are_only_compared_need_no_more_than_the_arm_that_was_identified() -> None:
    error = IdentifiedError(values=TransmissionErrorTable(a2_arcsec=5.0, phi2_deg=0.0), arm_hz=16.0)
    identified = Identified(robot="reference", axis={2: IdentifiedAxis(ate=error)})
    assert vibration_scale(without_models(OWN), (2, 3), identified) == tip_scale(16.0)


def looked(monkeypatch: pytest.MonkeyPatch, bench: Bench, own: Ringing | str, axis: int = 2) -> RunJudge:
    """A judge whose look at a ramp of an axis has ended so."""

    def answer(*_: object) -> Ringing:
        if isinstance(own, str):
            raise NoResonanceError(own)
        return own

    monkeypatch.setattr("hil.experiments.judge.ringing", answer)
    names = ("axis2_position_rad", "axis2_reference_rad", "axis2_torque_nm", "tip_z_m_s2", "time_s")
    recording = Recording({name.replace("axis2", f"axis{axis}"): np.arange(4.0) for name in names})
    judge = RunJudge(bench)
    judge.look(recording, axis)
    return judge


def ring(peak_hz: float, error_hz: float = 0.1) -> Ringing:
    return Ringing(peak_hz, error_hz, 0.05, (2, 4))


def test_the_ramps_own_resonance_judges_where_there_is_no_model(monkeypatch: pytest.MonkeyPatch) -> None:
    found = looked(monkeypatch, without_models(OWN), ring(4.6)).found(2)
    assert found.scale == tip_scale(4.6)
    assert found.words == "f_al 4.60 ± 0.10 Hz, from the run's own orders 2 and 4"
    assert (found.source, found.error_hz, found.doubt) == ("own", 0.1, None)
    assert found.most_factor == pytest.approx((4.6 / 4.4) ** 2)


def test_where_the_ramp_shows_none_the_reason_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found = looked(monkeypatch, without_models(OWN), "the torque does not tell which").found(2)
    assert found.scale is None
    assert "axis 2 has no model" in found.words
    assert found.words.endswith("in the bench file. The ramp by itself does not show f_al: the torque does not tell which")


@pytest.mark.parametrize(
    ("factor", "is_said", "is_doubted"), [(1.01, False, False), (1.08, True, False), (0.7, True, True), (1.5, True, True)]
)
def test_a_model_comes_first_and_is_held_against_what_the_ramp_shows(
    monkeypatch: pytest.MonkeyPatch, factor: float, is_said: bool, is_doubted: bool
) -> None:
    f_al = peak_hz(OWN, 2)
    assert f_al is not None
    found = looked(monkeypatch, OWN, ring(factor * f_al)).found(2)
    assert (found.scale, found.source) == (tip_scale(f_al), "model")
    assert (found.remark is not None, found.doubt is not None) == (is_said, is_doubted)
    assert found.most_factor == pytest.approx(max(1.0, factor**-2) if is_said else 1.0)


def test_the_line_is_reckoned_with_the_lowest_resonance_of_the_ramps(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = looked(monkeypatch, without_models(OWN), ring(9.0))
    assert judge.found(None).scale == joint_scale([tip_scale(9.0)])
    assert "from the ramps of axis 2" in judge.found(None).words
    assert RunJudge(without_models(OWN)).found(None).scale is None


def test_a_ramp_that_shows_nothing_gives_no_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    found = looked(monkeypatch, without_models(OWN), "noise").found(2)
    assert found.scale is None
    assert "noise" in found.words


@pytest.mark.parametrize(
    ("f_al_hz", "speed_rps", "within", "beyond"),
    [(8.0, 12.0, [], []), (10.5, 12.0, [1], []), (11.84, 12.0, [], [1]), (22.0, 12.0, [2], [1]), (22.0, 11.0, [], [1, 2])],
)
def test_an_order_that_the_ramp_does_not_reach_is_named(
    f_al_hz: float, speed_rps: float, within: list[int], beyond: list[int]
) -> None:
    axis = OWN.axis[2]
    bench = with_axis(OWN, 2, axis.model_copy(update={"limits": axis.limits.model_copy(update={"speed_rps": speed_rps})}))
    found = unreached(bench, 2, tip_scale(f_al_hz))
    assert [text.split("order ")[1][0] for text in found[0]] == [str(order) for order in within]
    assert [text.split("order ")[1][0] for text in found[1]] == [str(order) for order in beyond]
    assert all("raise end_rps" in text for text in found[0])


@pytest.mark.parametrize(("low_rev", "high_rev"), [(-50.0, 50.0), (-99.0, 1.0), (0.0, 100.0), (20.0, 120.0)])
def test_the_travel_counts_wherever_its_zero_is(low_rev: float, high_rev: float) -> None:
    axis = OWN.axis[2]
    update = {"speed_rps": 40.0, "position_min_rev": low_rev, "position_max_rev": high_rev}
    bench = with_axis(OWN, 2, axis.model_copy(update={"limits": axis.limits.model_copy(update=update)}))
    within, beyond = unreached(bench, 2, tip_scale(22.0))
    assert ([text.split("order ")[1][0] for text in within], [text.split("order ")[1][0] for text in beyond]) == (["2"], ["1"])
    assert "From the middle of the travel the limits allow no more than 18.3" in beyond[0]


def judged(peak_mm: float, found: FoundScale, noise_mm: float | None = None) -> JudgedWindow:
    return _verdict(Metrics(peak_mm, 0.0, 0.0, 12.0, 0.0, noise_mm=noise_mm), peak_mm, 0.05, found)


def test_a_verdict_that_hangs_on_the_error_of_f_al_is_not_given() -> None:
    found = FoundScale(tip_scale(10.0), "own", 0.5, "f_al 10.00 ± 0.50 Hz, from the run's own order 2", None, None, 1.23)
    assert judged(0.03, found).is_within is True
    assert judged(0.06, found).is_within is False
    window = judged(0.045, found)
    assert window.is_within is None
    assert window.invalid is not None
    assert "0.0553 mm" in window.invalid


def test_a_tip_that_is_not_told_apart_from_noise_is_not_outside() -> None:
    found = FoundScale(tip_scale(10.0), "model")
    assert judged(0.06, found, noise_mm=0.05).invalid is not None
    assert judged(0.06, found, noise_mm=0.01).is_within is False
    assert judged(0.04, found, noise_mm=0.05).is_within is True


def shaken(period_s: float, rest_s: float, sigma: float, highest_hz: float) -> tuple[Recording, np.ndarray]:
    """A motor that rests, then turns ever faster, and a sensor that feels a vibration up to a frequency with it."""
    time = np.arange(0.0, rest_s + 4.0, period_s)
    since = np.maximum(time - rest_s, 0.0)
    felt = np.where(since > 0.0, 2.0 * np.sin(np.pi * highest_hz / 4.0 * since**2), 0.0) + 9.81
    felt += sigma * np.random.default_rng(20261122).standard_normal(len(time))
    return Recording({"time_s": time, "axis2_position_rad": 10.0 * since**2}), felt


@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_the_noise_of_a_sensor_is_found_beside_what_the_motor_drives(sigma: float) -> None:
    recording, felt = shaken(0.0005, 0.0, sigma, 40.0)
    assert noise_variance(felt, recording) == pytest.approx(sigma**2, rel=0.15)


def test_where_the_motor_drives_the_whole_spectrum_the_rest_shows_the_noise() -> None:
    """Else the vibration at 31 to 62 Hz of a run with 8 ms was taken for noise, 28 times the sensor's own on a drawn robot."""
    recording, felt = shaken(0.008, 0.5, 0.02, 120.0)
    assert noise_variance(felt, recording) == pytest.approx(0.02**2, rel=0.5)
    coarse = np.round(felt / 0.2) * 0.2
    assert noise_variance(coarse, recording) > 0.1**2, "a rest in which a sensor shows nothing is not silence"
