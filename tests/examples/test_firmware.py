"""The law as firmware: it fits a microcontroller, and single precision moves the tip by less than a micrometre."""

import importlib.util
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import ServoConfig
from hil.core.build import ROOT

FOLDER = ROOT / "examples" / "firmware"
ARM, QEMU = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")


def made(target, out):
    done = subprocess.run(["make", "-s", target, f"OUT={out}"], cwd=FOLDER, capture_output=True, text=True, check=False)  # noqa: S607
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def precision():
    spec = importlib.util.spec_from_file_location("precision", FOLDER / "precision.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def library(precision, tmp_path_factory):
    if not shutil.which("cc"):
        pytest.skip("no C compiler")
    return precision.single(Path(tmp_path_factory.mktemp("single")))


@pytest.mark.ci
@pytest.mark.skipif(ARM is None, reason="no arm-none-eabi-gcc (Debian: gcc-arm-none-eabi libnewlib-arm-none-eabi)")
def test_the_law_fits_a_cortex_m4f_and_an_m7(tmp_path):
    said = made("sizes", tmp_path / "build")
    sizes = dict(re.findall(r"cortex-(m\d): law (\d+) bytes of flash, 0 bytes of RAM", said))
    assert sizes.keys() == {"m4", "m7"}
    assert all(500 < int(size) < 4000 for size in sizes.values())
    assert "one axis with two notches: 208 bytes of RAM" in said


@pytest.mark.skipif(ARM is None or QEMU is None, reason="no arm-none-eabi-gcc or no qemu-system-arm")
def test_a_step_with_two_notches_takes_a_few_hundred_instructions(tmp_path):
    said = made("count", tmp_path / "build")
    without, both = (int(number) for number in re.findall(r"(\d+) instructions a step", said))
    assert "both notches acted" in said
    assert 100 < without < both < 800


def test_the_page_shows_the_figures_of_the_example():
    page = (ROOT / "docs" / "firmware.md").read_text(encoding="utf-8")
    assert "| RAM of an axis with two notches | 208 bytes | 208 bytes |" in page


@pytest.mark.ci
def test_single_precision_moves_the_tip_by_less_than_a_micrometre(precision, library):
    exact = precision.displacement_mm(precision.tip(3, precision.double_law, with_notch=True))
    near = precision.tip(3, lambda config, period: precision.single_law(library, config, period, 2.0 * math.pi), with_notch=True)
    apart = float(np.max(np.abs(precision.displacement_mm(near) - exact)))
    assert 0.0 < apart < 1e-3
    assert np.max(np.abs(exact)) > 0.05


def test_a_motor_far_from_home_has_the_same_law_once_its_origin_has_moved(precision, library):
    config = ServoConfig(Cascade(25.0, 0.196, 3.92), 7.0, (Notch(),))
    period_s, far = 250e-6, 2.0 * math.pi * 20_000.0
    home, moved = (precision.single_law(library, config, period_s, 2.0 * math.pi) for _ in range(2))
    fixed = precision.single_law(library, config, period_s, math.inf)
    moved(far, far)
    fixed(far, far)
    home(0.0, 0.0)
    speed, torques = 12.0 * math.pi, []
    for i in range(1, 3000):
        angle = speed * period_s * i
        position = angle + speed / 25.0 + 0.01  # the position loop of a moving axis runs v/K_pp behind
        torques.append([home(position, angle), moved(far + position, far + angle), fixed(far + position, far + angle)])
    expected, near, away = np.array(torques)[1500:].T
    assert np.max(np.abs(expected)) < 7.0, "within its limit"
    assert np.max(np.abs(near - expected)) < 2e-3
    assert np.max(np.abs(away - expected)) > 0.1
