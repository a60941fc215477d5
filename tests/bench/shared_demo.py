"""`hil demo`, run once for all tests and all workers of a test run."""

import fcntl
import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

TIMEOUT_S = 580.0


@dataclass(frozen=True)
class DemoRun:
    """What came of it.

    Attributes:
        folder: Its directory.
        status: Exit status.
    """

    folder: str
    status: int
    stdout: str
    stderr: str

    @property
    def out(self) -> Path:
        """The directory, of a run that ended with 0."""
        assert self.status == 0, self.stderr
        return Path(self.folder)


def shared_demo(root: Path, *, is_whole: bool) -> DemoRun:
    """The run of this root: whoever comes first makes it, and the others wait for it.

    Args:
        root: Folder that all workers have in common.
        is_whole: True where somebody asks for the tour and the arm too.
    """
    name = "whole-demo" if is_whole else "demo"
    kept = root / f"{name}.json"
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # goes with its process
        if not kept.exists():
            out = root / name
            command = [sys.executable, "-m", "hil", "demo", *(() if is_whole else ("--no-tour",)), "--out", str(out), "--json"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
            made = DemoRun(str(out), done.returncode, done.stdout, done.stderr)
            kept.write_text(json.dumps(asdict(made)), encoding="utf-8")
    return DemoRun(**json.loads(kept.read_text(encoding="utf-8")))


def common_root(factory: pytest.TempPathFactory) -> Path:
    """The folder above those of the workers, or that of the only process."""
    base = factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
