"""The contenders of the closed loop without a bus: they find the same, and one that does not ends the benchmark."""

import sys

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import plant, plant_python
from benchmarks.measure import DisagreementError, agreed
from benchmarks.records import CONSTANTS, RECORDS, header
from hil.control.notch import Notch
from plant_emulator.motion.axes import Axes

WRONG = header(constants=CONSTANTS | {"FRICTION_WIDTH_RAD_S": CONSTANTS["FRICTION_WIDTH_RAD_S"] * (1.0 + 1e-6)})
"""A friction that is wrong in its seventh digit."""


@pytest.mark.usefixtures("compiler")
class TestC:
    @pytest.mark.slow
    @pytest.mark.parametrize("count", [1, 3])
    def test_strict_c_gives_our_bits_in_every_field(self, count):
        # to the last bit where the C library's functions are those that our compiled parts call
        assert plant.agreement(plant.compiled_c(plant.STRICT), count) <= 1e-11

    @pytest.mark.slow
    def test_fast_c_is_within_its_bound(self):
        agreed("C", plant.agreement(plant.compiled_c()), plant.SAME_STEPS)

    @pytest.mark.ci
    def test_a_constant_wrong_in_its_seventh_digit_breaks_the_bound(self):
        with pytest.raises(DisagreementError, match=r"^C: its result differs by .*, the bound is 1e-09$"):
            agreed("C", plant.agreement(plant.compiled_c(declarations=WRONG), duration_s=1.0), plant.SAME_STEPS)

    def test_a_field_that_moves_nothing_is_compared_too(self):
        slow = header(constants=CONSTANTS | {"START_LOWPASS_HZ": 20.0001})
        assert plant.agreement(plant.compiled_c(declarations=slow), duration_s=0.2) > plant.SAME_STEPS

    def test_records_that_have_grown_since_do_not_pass(self):
        before = [(name, RECORDS["Motion"][name]) for name in RECORDS["Motion"].names if name != "counts_per_rev"]
        records = RECORDS | {"Motion": np.dtype(before)}
        axis = [(name, records["Motion"] if name == "motion" else RECORDS["Axis"][name]) for name in RECORDS["Axis"].names]
        stale = header(records | {"Axis": np.dtype(axis)})
        with pytest.raises((DisagreementError, RuntimeError)):
            agreed("C", plant.agreement(plant.compiled_c(declarations=stale), duration_s=0.1), plant.SAME_STEPS)

    def test_c_refuses_what_it_does_not_do(self):
        axes, in_c = plant.energised(3), plant.compiled_c()
        Notch().write(axes.notch_config[1, 0])
        with pytest.raises(RuntimeError, match="row 1"):
            in_c(axes, 1)

    @pytest.mark.slow
    def test_a_wrong_contender_ends_the_program_without_a_page(self, monkeypatch, tmp_path, capsys):
        wrong, page = plant.compiled_c(declarations=WRONG), tmp_path / "page.md"
        monkeypatch.setattr(plant, "compiled_c", lambda *_: wrong)
        monkeypatch.setattr(sys, "argv", ["benchmarks", "plant", "--out", str(page)])
        with pytest.raises(SystemExit) as caught:
            program.main()
        assert str(caught.value.code).startswith("The closed loop without a bus: C, gcc -O3: its result differs by ")
        assert str(caught.value.code).endswith(", the bound is 1e-09")
        assert not page.exists()
        assert not capsys.readouterr().out


def test_a_contender_that_gives_no_numbers_breaks_every_bound():
    def broken(axes: Axes, periods: int) -> None:
        axes.advance(periods)
        axes.plant_state["arm_speed_rad_s"][0] = np.nan

    with pytest.raises(DisagreementError, match="differs by nan"):
        agreed("broken", plant.agreement(broken, duration_s=0.01), 1e300)


def test_plain_python_is_within_its_bound():
    wanted = plant.targets(plant.energised(3), 0.05)
    agreed("Python", plant_python.agreement(plant.energised(3), plant.energised(3), wanted), plant.SAME_STEPS)


def test_the_error_of_our_steps_is_what_parts_us_from_a_general_solver(monkeypatch):
    four = plant._general(plant.solver_step, 0.01)[1]
    right = plant.robot_of
    monkeypatch.setattr(plant, "robot_of", lambda count: right(count).model_copy(update={"plant_substeps": 16}))
    assert plant._general(plant.solver_step, 0.01)[1] < 0.1 * agreed("scipy", four, plant.TRUNCATION)
