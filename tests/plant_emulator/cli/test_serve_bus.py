"""The bus that `plant-emulator serve` serves: its option, then HIL_BUS, then its default."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SERVE = [sys.executable, "-m", "plant_emulator", "serve", "--until-stdin-closes"]


def served(*options: str, **environment: str) -> tuple[str, str]:
    """The first line of what it prints, and all that it says on standard error, of a server that ends at once."""
    done = subprocess.run(
        [*SERVE, *options], input="", capture_output=True, text=True, timeout=300, check=False, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[0], done.stderr


@pytest.mark.timeout(600)
def test_the_environment_names_the_bus_and_the_option_comes_before_it(tmp_path: Path) -> None:
    one, other = f"local:{tmp_path}/one.sock", f"local:{tmp_path}/other.sock"
    line, said = served(HIL_BUS=one)
    assert line.startswith(f"serving reference on {one}: ")
    assert said == f"bus {one}, from HIL_BUS\n"
    line, said = served("--bus", other, HIL_BUS=one)
    assert line.startswith(f"serving reference on {other}: ")
    assert said.startswith(f"bus {other}, from --bus; not {one}, as HIL_BUS says")
