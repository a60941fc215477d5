"""A real robot: NEURA LARA 8 with encoders on both sides of its gears (BSD-3-Clause; its README holds an independent fit).

The folder is named by the environment variable HIL_LARA8, else it is ``shared/data/lara8`` beside the repository.
"""

import os
from pathlib import Path

import pytest

from hil.experiments.ate.recorded.identify import identify_recorded
from hil.experiments.ate.recorded.request import RecordedAteError, RecordedRequest
from hil.recordings import Said

LARA = Path(os.environ.get("HIL_LARA8", Path(__file__).parents[5] / "shared" / "data" / "lara8"))
pytestmark = pytest.mark.skipif(not LARA.is_dir(), reason=f"the recordings of the real robot are not there: {LARA}")

README = {  # joint: file, ratio, A_2, its standard error there
    1: ("jogging_linear_mass.csv", 121, 7.2, 0.2),
    2: ("jogging_joint_mass.csv", 121, 12.9, 0.3),
    3: ("validate.csv", 101, 4.8, 0.4),
    6: ("jogging_linear_mass.csv", 101, 8.7, 0.4),
}
ORDERS = (1, 2, 3, 4, 6, 8)
MARGIN = {1: 2.0, 2: 2.0, 3: 2.5, 6: 1.25}
"""Height of order 2, by the next peak: the least that docs/recordings.md states."""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return {
        joint: identify_recorded(RecordedRequest((LARA / file,), joint, Said(), ORDERS), tmp_path_factory.mktemp(f"joint{joint}"))
        for joint, (file, *_) in README.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("joint", README)
def test_order_2_is_the_highest_of_a_blind_scan(results, joint):
    highest = results[joint].scan.highest
    others = [peak for peak in results[joint].scan.peaks if abs(peak.order - 2.0) > 0.5]
    assert abs(highest.order - 2.0) < 0.04
    assert highest.amplitude > MARGIN[joint] * max((peak.amplitude for peak in others), default=highest.level)


@pytest.mark.ci
@pytest.mark.parametrize("joint", README)
def test_a_2_is_that_of_an_independent_fit(results, joint):
    _, _, amplitude, error = README[joint]
    found = results[joint].ate
    assert abs(found.values.amplitudes_arcsec()[2] - amplitude) < 2.0 * min(error, found.standard_error["a2_arcsec"])
    assert abs(found.values.amplitudes_arcsec()[2] / amplitude - 1.0) < 0.1


@pytest.mark.parametrize("joint", README)
@pytest.mark.parametrize("order", [3, 8])
def test_orders_that_a_gear_need_not_have_are_nothing(results, joint, order):
    found = results[joint].ate
    size = found.values.amplitudes_arcsec()[order]
    assert size < 1.0 or size < 3.0 * found.standard_error[f"a{order}_arcsec"]


@pytest.mark.parametrize("joint", README)
def test_the_ratio_is_found_where_nobody_gave_it(results, joint):
    assert results[joint].reduction_ratio == README[joint][1]


def test_a_phase_that_turns_within_a_motion_is_said(results):
    [change] = [each for each in results[2].changes if each.order == 2]
    assert change.is_seen
    assert change.phi_span_deg > 20.0
    assert any("order 2 changes: φ_2" in note for note in results[2].notes)


def test_lines_of_a_fixed_frequency_are_told_from_orders(results):
    found = [line.hz for line in results[3].scan.lines]
    assert any(abs(hz - 72.9) < 0.5 for hz in found)


def test_two_recordings_of_a_joint_are_one_result_and_one_that_stands_still_is_left_out(tmp_path):
    files = (LARA / "jogging_joint_mass.csv", LARA / "jogging_linear_mass.csv")
    result = identify_recorded(RecordedRequest(files, 1, Said()), tmp_path)
    assert {each.file for each in result.stretches} == {1}
    assert any("jogging_joint_mass.csv" in note and "left out" in note for note in result.notes)


def test_a_joint_that_does_not_move_is_refused_with_its_revolutions(tmp_path):
    with pytest.raises(RecordedAteError, match="orders 1, 2, 4 need 2"):
        identify_recorded(RecordedRequest((LARA / "validate.csv",), 1, Said()), tmp_path)
