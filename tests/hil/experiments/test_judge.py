"""The scale by which a bench's runs are judged."""

import numpy as np
import pytest

from hil.analysis import PAPER_BAND_HZ, PAPER_WINDOWS_RPS, tip_scale
from hil.bench.bench import AxisTable, Bench, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedError
from hil.errors import NotPossibleError
from hil.experiments.judge import axis_scale, line_scale, missing_words, peak_hz, vibration_scale
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
