"""The contenders of the closed loop without a bus: they find the same, and one that does not ends the benchmark."""

import sys

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import plant, plant_python
from benchmarks.measure import DisagreementError, agreed
from hil.core import build as hil_build
from plant_emulator.core import build
from plant_emulator.motion.axes import Axes

WRONG = {"#define FRICTION_WIDTH_RAD_S 0.05\n": "#define FRICTION_WIDTH_RAD_S 0.05000005\n"}
"""A friction that is wrong in its seventh digit."""


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """Builds the core from sources in which some lines are others."""

    def built(lines):
        for folder in build.PLANT.folders:
            (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        for path in build.PLANT.files(".c", ".h"):
            text = path.read_text(encoding="utf-8")
            for old, new in lines.items():
                text = text.replace(old, new)
            (tmp_path / path.relative_to(hil_build.ROOT)).write_text(text, encoding="utf-8")
        with monkeypatch.context() as patch:
            patch.setattr(hil_build, "ROOT", tmp_path)
            return plant.compiled(plant.LOOSE)

    return built


@pytest.mark.usefixtures("compiler")
class TestLoose:
    @pytest.mark.slow
    def test_loose_arithmetic_is_within_its_bound(self):
        agreed("loose", plant.agreement(plant.compiled(plant.LOOSE)), plant.SAME_STEPS)

    @pytest.mark.ci
    def test_a_constant_wrong_in_its_seventh_digit_breaks_the_bound(self, changed):
        with pytest.raises(DisagreementError, match=r"^loose: its result differs by .*, the bound is 1e-09$"):
            agreed("loose", plant.agreement(changed(WRONG), duration_s=1.0), plant.SAME_STEPS)

    @pytest.mark.ci
    def test_a_field_that_moves_nothing_is_compared_too(self, changed):
        slow = changed({"#define START_LOWPASS_HZ 20.0\n": "#define START_LOWPASS_HZ 20.0001\n"})
        assert plant.agreement(slow, duration_s=0.2) > plant.SAME_STEPS

    @pytest.mark.slow
    def test_a_wrong_contender_ends_the_program_without_a_page(self, changed, monkeypatch, tmp_path, capsys):
        wrong, page = changed(WRONG), tmp_path / "page.md"
        monkeypatch.setattr(plant, "compiled", lambda *_: wrong)
        monkeypatch.setattr(sys, "argv", ["benchmarks", "plant", "--out", str(page)])
        with pytest.raises(SystemExit) as caught:
            program.main()
        assert str(caught.value.code).startswith(f"The closed loop without a bus: {plant.LOOSELY}: its result differs by ")
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
