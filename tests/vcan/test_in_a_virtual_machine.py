"""The tests on vcan, on a kernel that has it: in a virtual machine where this one has none."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vcan.conftest import is_up
from tests.vcan.vm import machine

MACHINE = Path(machine.__file__)
LIMIT_S = 1500.0


def reason_to_skip() -> str:
    if sys.platform != "linux":
        return "SocketCAN is Linux'"
    if is_up():
        return "this kernel has vcan0: the tests run directly"
    return machine.missing()


@pytest.mark.slow
@pytest.mark.timeout(LIMIT_S + 60.0)
@pytest.mark.skipif(bool(reason_to_skip()), reason=reason_to_skip())
def test_all_tests_on_vcan_pass_in_a_virtual_machine(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    results = tmp_path / "results.xml"
    done = subprocess.run(
        [sys.executable, str(MACHINE), "--limit-s", str(LIMIT_S), "--",
         sys.executable, "-m", "pytest", "-m", "vcan", "-p", "no:cacheprovider", "-p", "no:xdist", "-rs", "--durations=8",
         "-o", "timeout=300", f"--junit-xml={results}", "tests/vcan"],
        cwd=root, capture_output=True, text=True, check=False,
    )  # fmt: skip
    with capfd.disabled():  # the result of the session inside
        print(  # noqa: T201
            f"\n{done.stdout.splitlines()[-1] if done.stdout else 'no output'} (in a virtual machine)"
        )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert results.exists()


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda program, path=None: None)
    assert "user-mode-linux" in machine.missing()
