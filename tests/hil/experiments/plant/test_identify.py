"""What an identification gives on the emulated axis, and what it says where the data do not do."""

import json
import re
from dataclasses import asdict
from typing import Any

import pytest

from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.plant.checks import PlantNotIdentifiedError
from hil.experiments.plant.evaluation import PlantEvaluation
from hil.experiments.plant.identify import PlantIdentification
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import enter
from hil.master.motion import Motion, RunResult
from hil.results.plant import PlantRequestEntry, PlantResult
from tests.hil.experiments.plant.plant_rig import FakeSession, true_values, unknown_bench
from tests.hil.results.made import measured_bench

SHORT = {"position_min_rev": -6.0, "position_max_rev": 6.0}
"""Little room: short runs."""


def identify(request: PlantRequest, **options: Any) -> tuple[PlantIdentification, PlantEvaluation]:
    session = FakeSession(unknown_bench(request.axis, **SHORT), request.axis, **options)
    identification = PlantIdentification(session, request)  # type: ignore[arg-type]
    return identification, identification.perform()


def brief(axis: int = 3, **changes: Any) -> PlantRequest:
    return PlantRequest(**{"axis": axis, "amplitude_nm": 0.5, "periods": 6, **changes})


@pytest.fixture(scope="module")
def found() -> PlantEvaluation:
    return identify(PlantRequest(3, periods=6))[1]


@pytest.mark.slow
def test_from_nothing_to_a_plant(found: PlantEvaluation) -> None:
    truth = true_values(3)
    for name, within in (("antiresonance_hz", 5e-3), ("gear_stiffness_nm_rad", 0.03), ("resonance_hz", 0.01)):
        parameter = found.estimate.parameters[name]
        assert parameter.value == pytest.approx(truth[name], rel=within)
        assert 0.0 < parameter.relative < within
    assert found.friction.coulomb_nm.value == pytest.approx(0.05, rel=0.05)
    assert all(check.holds for check in found.checks)


@pytest.mark.ci
def test_the_entry_of_the_model_file_has_its_errors_and_what_it_cannot_tell(found: PlantEvaluation) -> None:
    entry = found.identified("a note")
    assert set(entry.standard_error) >= {"gear_stiffness_nm_rad", "antiresonance_hz", "damping", "coulomb_friction_nm"}
    assert any("D_m cannot be separated" in line for line in entry.cannot_tell)
    assert entry.torsion_arcsec == pytest.approx(found.estimate.torsion_rad / ARCSEC)
    assert any("extrapolated" in line for line in entry.cannot_tell)  # the arm turned through a few degrees only
    assert entry.accelerometer_delay_s == found.estimate.parameters["accelerometer_delay_s"].value
    assert 0.0 < entry.standard_error["accelerometer_delay_s"] < 1e-3
    assert entry.note == "a note"


@pytest.mark.ci
def test_the_pilot_chooses_an_amplitude_and_says_so(found: PlantEvaluation) -> None:
    assert any("a pilot run chose the amplitude" in remark for remark in found.remarks)
    assert 0.2 < found.amplitude_nm < 0.6 * 3.8


def test_the_result_is_plain_data(found: PlantEvaluation) -> None:
    result = PlantResult(bench=measured_bench(), axis=3, request=PlantRequestEntry(**asdict(found.request)))
    enter(result, found)
    kept = json.loads(result.dumps())
    assert len(kept["response"]["coherence"]) == len(kept["response"]["frequency_hz"])
    assert kept["parameters"]["gear_stiffness_nm_rad"]["standard_error"] > 0.0


@pytest.mark.ci
def test_a_chirp_on_the_reference_does_as_well() -> None:
    identification, evaluated = identify(brief(shape="chirp", excitation="reference"))
    assert evaluated.excited == "reference"
    assert all(motion.torque_offset_nm is None for motion in identification.session.motions)  # type: ignore[attr-defined]
    assert evaluated.estimate.plant.antiresonance_hz == pytest.approx(true_values(3)["antiresonance_hz"], rel=5e-3)
    assert evaluated.estimate.plant.gear_stiffness_nm_rad == pytest.approx(true_values(3)["gear_stiffness_nm_rad"], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (0.0, r"coherence of the tip with the motor: .*at least 0.5.*right orientation"),
        (3.0, r"lever of 1\.\d+ m; the bench file says 0.36 m"),
    ],
)
def test_a_tip_that_is_not_this_axis_is_said_and_left_out(gain: float, words: str) -> None:
    _, evaluated = identify(brief(), tip_gain=gain)
    assert evaluated.estimate.tip is None
    assert any(re.search(words, remark) for remark in evaluated.remarks)
    assert evaluated.estimate.plant.antiresonance_hz == pytest.approx(true_values(3)["antiresonance_hz"], rel=0.01)


class Loosened(FakeSession):
    """A sensor that comes loose once probe, pilot and slow turns are made."""

    def run(self, motion: Motion, compensation: str, loop: str) -> RunResult:
        if len(self.motions) == 3:
            self._tip_gain = 3.0
        return super().run(motion, compensation, loop)


@pytest.mark.slow
def test_a_tip_that_goes_wrong_after_the_pilot_is_left_out_of_what_is_fitted() -> None:
    session = Loosened(unknown_bench(3, **SHORT), 3)
    evaluated = PlantIdentification(session, brief()).perform()  # type: ignore[arg-type]
    assert any(re.search(r"lever of 1\.\d+ m; .*from the motor alone", remark) for remark in evaluated.remarks)
    assert evaluated.estimate.tip is None
    assert "lever_ratio" not in evaluated.estimate.parameters
    assert evaluated.estimate.plant.antiresonance_hz == pytest.approx(true_values(3)["antiresonance_hz"], rel=0.01)


@pytest.mark.ci
def test_a_saturated_accelerometer_is_left_out_and_said() -> None:
    _, evaluated = identify(brief(), sensor_range=1.0)
    assert evaluated.estimate.tip is None
    assert any("end of its range, 1 m/s², in" in remark for remark in evaluated.remarks)
    assert any("tip lever" in line for line in evaluated.cannot_tell)


@pytest.mark.slow
def test_a_missing_accelerometer_is_left_out_and_said() -> None:
    _, evaluated = identify(brief(), sensor_missed=900)
    assert any("missing in 900 of" in remark for remark in evaluated.remarks)


@pytest.mark.slow
def test_periods_with_missing_answers_are_left_out() -> None:
    identification = PlantIdentification(
        FakeSession(unknown_bench(3, **SHORT), 3),  # type: ignore[arg-type]
        brief(),
    )
    row = identification._excited(identification.travel, 0.5).stretches[-1].stop - 5
    identification.session._missing = (row,)  # type: ignore[attr-defined]
    evaluated = identification.perform()
    assert evaluated.estimate.periods == 5
    assert any("1 of 6 periods were left out" in remark for remark in evaluated.remarks)


@pytest.mark.slow
def test_a_motor_that_turns_back_is_said_with_the_amplitude_that_would_do() -> None:
    with pytest.raises(
        PlantNotIdentifiedError, match=r"motor turned back: .*at most 0.005\); raise --bias-rps .* lower --amplitude-nm"
    ):
        identify(brief(amplitude_nm=2.5))


@pytest.mark.ci
def test_too_little_excitation_is_said_with_the_amplitude_that_the_limits_allow() -> None:
    with pytest.raises(PlantNotIdentifiedError, match=r"the limits allow .* N·m: leave out --amplitude-nm"):
        identify(brief(amplitude_nm=0.0005, with_accelerometer=False))


def test_a_band_without_the_resonance_is_said() -> None:
    with pytest.raises(PlantNotIdentifiedError, match=r"(one inertia|does not show the resonances) .*--high-hz"):
        identify(brief(low_hz=40.0, high_hz=60.0, with_accelerometer=False))


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"amplitude_nm": 3.5}, UnsafeRequestError, r"3.5 N·m; the limit is 3.04 N·m"),
        ({"bias_rps": 8.0}, UnsafeRequestError, r"16 rev/s; the limit is 12 rev/s"),
        ({"bias_rps": 0.1}, NotPossibleError, r"0.1 rev/s is too slow .* at least 0.2 rev/s"),
        ({"periods": 3}, NotPossibleError, r"3 periods .* at least 6"),
        ({"high_hz": 130.0}, NotPossibleError, r"130 Hz is not below half the sampling rate, 125 Hz"),
        ({"axis": 4}, NotPossibleError, r"no axis 4"),
        ({"bias_rps": 5.0}, UnsafeRequestError, r"the travel of axis 3 at 5 rev/s would be .* rev; the limit is 11 rev"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_moves(changes: dict[str, Any], error: type[Exception], words: str) -> None:
    session = FakeSession(unknown_bench(3, **SHORT), 3)
    with pytest.raises(error, match=words):
        PlantIdentification(session, brief(**changes))  # type: ignore[arg-type]
    assert session.motions == []


def test_the_reference_bench_has_room_for_two_stretches() -> None:
    bench = load_bench("reference")
    session = FakeSession(unknown_bench(2), 2)
    travel = PlantIdentification(session, PlantRequest(2)).travel  # type: ignore[arg-type]
    limits = bench.axis[2].limits
    assert limits.position_min_rev < travel.low_rev < travel.high_rev < limits.position_max_rev
    assert travel.stretches == 2
    assert travel.per_stretch == 5


SIDES = [(axis, sync_s) for axis in (2, 3) for sync_s in (0.001, 0.002)]
"""Axes and SYNC periods that twenty seeds take in turn."""


@pytest.mark.slow
def test_the_figures_asked_for_over_twenty_seeds() -> None:
    within = {"antiresonance_hz": 5e-3, "gear_stiffness_nm_rad": 0.03, "resonance_hz": 5e-3, "damping": 0.05}
    scores: list[float] = []
    for seed in range(1, 21):
        axis, sync_s = SIDES[seed % len(SIDES)]
        truth, session = true_values(axis), FakeSession(unknown_bench(axis, sync_s), axis, seed=seed)
        evaluated = PlantIdentification(session, PlantRequest(axis)).perform()  # type: ignore[arg-type]
        for name, allowed in within.items():
            parameter = evaluated.estimate.parameters[name]
            assert parameter.value == pytest.approx(truth[name], rel=allowed), (seed, name)
        stiffness = evaluated.estimate.parameters["gear_stiffness_nm_rad"]
        scores.append((stiffness.value - truth["gear_stiffness_nm_rad"]) / stiffness.standard_error)
        assert evaluated.friction.coulomb_nm.value == pytest.approx(session.robot.axis[axis].coulomb_friction_nm, rel=0.02)
        assert evaluated.friction.gravity_moment_nm.value == pytest.approx(session.robot.axis[axis].gravity_moment_nm, rel=0.02)
    assert sum(score**2 for score in scores) / len(scores) < 3.0**2
