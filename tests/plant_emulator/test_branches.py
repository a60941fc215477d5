"""Every branch of the slave engine and of the CiA 402 state machine is taken by their tests and the image's.

It plays those tests a second time, under coverage: so it is for the whole run alone, and neither for every day nor for CI.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_every_branch_of_the_slave_engine_and_the_state_machine_is_taken(tmp_path):
    command = [
        *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"),
        *("tests/plant_emulator/slave", "tests/plant_emulator/image", "tests/plant_emulator/drive/test_state_machine.py"),
        *("--cov=plant_emulator.slave", "--cov=plant_emulator.drive.state_machine", "--cov-branch"),
        *("--cov-report=term-missing", "--cov-fail-under=100"),
    ]
    environment = os.environ | {"COVERAGE_FILE": str(tmp_path / "coverage")}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
