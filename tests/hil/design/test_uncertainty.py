"""The set of plants: what is at its corners, by percent or by standard errors."""

import pytest

from hil.bench.bench import load_bench
from hil.design.transmission_error import TransmissionError
from hil.design.uncertainty import around, plants_words, spread_words

PLANT = load_bench("reference").axis[2].plant()
ERROR = TransmissionError({2: 5.0, 4: 3.0}, {2: 222.0, 4: 126.0})


def test_by_default_stiffness_and_inertia_by_5_percent_each():
    nominal, *corners = around(PLANT, ERROR)
    assert (nominal.label, nominal.plant, nominal.error) == ("nominal", PLANT, ERROR)
    seen = {(round(c.plant.gear_stiffness_nm_rad / 48950.0, 6), round(c.plant.arm_inertia_kg_m2 / 8.0, 6)) for c in corners}
    assert seen == {(a, b) for a in (0.95, 1.05) for b in (0.95, 1.05)}
    assert {c.label for c in corners} >= {"K_g −5 %, J_l +5 %"}


def test_with_standard_errors_the_frequency_is_as_sure_as_it_was_measured():
    known = {"gear_stiffness_nm_rad": 0.03 * 48950.0, "arm_inertia_kg_m2": 0.03 * 8.0, "antiresonance_hz": 0.02 * 12.45,
             "gear_damping_nm_s_rad": 4.2}  # fmt: skip
    _, *corners = around(PLANT, ERROR, standard_error=known, amplitude_error_arcsec={2: 0.1})
    for corner in corners:
        assert abs(corner.plant.antiresonance_hz / PLANT.antiresonance_hz - 1.0) == pytest.approx(0.04, rel=0.02)
        assert abs(corner.plant.gear_stiffness_nm_rad / 48950.0 - 1.0) == pytest.approx(0.06, rel=1e-6)
        assert corner.plant.gear_damping_nm_s_rad == pytest.approx(42.0 - 8.4)
        assert corner.error.amplitude_arcsec == {2: 5.2, 4: 3.0}


@pytest.mark.parametrize("times", [1e-3, 0.1, 1.0])
def test_however_good_an_identification_is_the_plants_are_3_percent_apart_at_least(times):
    known = {"gear_stiffness_nm_rad": times * 0.01 * 48950.0, "antiresonance_hz": times * 0.001 * 12.45}
    members = around(PLANT, ERROR, standard_error=known)
    for corner in members[1:]:
        assert abs(corner.plant.antiresonance_hz / PLANT.antiresonance_hz - 1.0) == pytest.approx(0.03, rel=0.02)
        assert abs(corner.plant.gear_stiffness_nm_rad / 48950.0 - 1.0) == pytest.approx(0.03, rel=0.02)
    assert spread_words(members) == "f_a ±3 %, K_g ±3 %"


def test_the_spread_in_words_is_that_of_the_corners():
    assert spread_words(around(PLANT, ERROR)) == "K_g ±5 %, J_l ±5 %"
    known = {"gear_stiffness_nm_rad": 0.04 * 48950.0, "antiresonance_hz": 0.001 * 12.45}
    assert spread_words(around(PLANT, ERROR, standard_error=known)) == "f_a ±3 %, K_g ±8 %"
    assert spread_words(around(PLANT, ERROR, percent=0.0)) == ""
    assert plants_words(around(PLANT, ERROR)) == "5 plants: K_g ±5 %, J_l ±5 %"
    assert plants_words(around(PLANT, ERROR, percent=0.0)) == "the nominal plant only"


def test_a_percentage_wins_and_none_at_all_leaves_the_believed_plant():
    known = {"gear_stiffness_nm_rad": 5000.0}
    assert "J_l" in around(PLANT, ERROR, percent=4.0, standard_error=known)[1].label
    assert len(around(PLANT, ERROR, percent=0.0, standard_error=known)) == 1
    for wrong in (-1.0, 51.0):
        with pytest.raises(ValueError, match="is not within 0"):
            around(PLANT, ERROR, percent=wrong)
