"""The suite against a node that it cannot look into: a served bus, python-can, the clock on the wall."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conformance.emulated import AXIS, emulated_device, robot_of

EVERYTHING = ("--alone", "--allow-manufacturer", "--allow-store", "--allow-motion")
"""But for LSS, which the accelerometer would answer too, and the defaults, since the robot file has no gains."""


def suite(bus, eds, *options):
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "tests/conformance", "--bus", bus,
         "--node", str(robot_of("drive").node_ids[AXIS]), "--eds", str(eds), *options],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip


@pytest.fixture
def eds(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(emulated_device("drive").eds_text, encoding="latin-1")
    return path


@pytest.mark.wall
@pytest.mark.slow
@pytest.mark.parametrize("options", [(), EVERYTHING], ids=["nothing allowed", "everything allowed"])
def test_the_whole_suite_passes_on_a_served_bus(hil_serve_local_bus, eds, options):
    done = suite(hil_serve_local_bus("--wall").address, eds, "--answer-timeout", "6", *options)
    assert done.returncode == 0, done.stdout[-4000:]
    assert " passed" in done.stdout
    assert "not restored" not in done.stdout


@pytest.mark.slow
def test_a_bus_without_a_node_or_an_eds_is_a_mistake_of_the_caller(eds):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist",
         "tests/conformance/test_nmt.py", "--bus", "virtual:nowhere", "--node", "0"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 4
    assert "--node" in done.stdout + done.stderr


@pytest.mark.ci
def test_the_suite_takes_every_option_of_its_page(eds):
    page = (Path(__file__).parents[2] / "docs" / "conformance.md").read_text()
    options = re.findall(r"`(--[a-z-]+)(?: S)?`(?=[,` |])", page.partition("| option |")[2].partition("### Safety")[0])
    assert "--allow-motion" in options
    given = [f"{name}=1" if name.endswith("timeout") else name for name in options]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--collect-only",
         "tests/conformance/test_nmt.py", "--bus", "virtual:nowhere", "--node", "2", "--eds", str(eds), *given],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
