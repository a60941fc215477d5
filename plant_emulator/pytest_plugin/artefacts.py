"""Artefacts of a test that fails."""

import hashlib
import json
import re
import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.can.frame import Frame
from hil.master.motion import RunResult
from hil.recording import BusLog, Logged, LoggedFrame, Recording, frames_in

MAX_FRAMES = 100_000
"""Frames that are kept of a test, the latest; some 4 MB of text."""
MAX_RUNS = 20
MAX_TESTS = 100
"""Directories that one pytest process leaves."""
MAX_NAME = 80

RunReader = Callable[[], tuple[dict[str, Any], Recording]]
"""Function that gives the summary of a run, and its recording."""

_written: set[Path] = set()


class FrameLog(BusLog):
    """The latest frames of a bus, with the bench's time."""

    def __init__(self) -> None:
        super().__init__(None)
        self.is_on = True  # the master always writes its frames to this log
        self.frames: deque[tuple[int, Frame]] = deque(maxlen=MAX_FRAMES)
        self.heard_frames = 0

    def add(self, logged: Logged) -> None:
        """Keep frames that the master has sent or received."""
        for time_s, can_id, data, _ in frames_in([logged]):
            self.hear(Frame(can_id, data), round(1e9 * time_s))

    def hear(self, frame: Frame, end_ns: int) -> None:
        """Keep a frame of the bus and the time of its end."""
        self.heard_frames += 1
        self.frames.append((end_ns, frame))

    def write(self) -> None:
        """Write nothing: a log is saved only when its test fails."""

    def save(self, path: Path) -> None:
        """Write a candump log, in order of time."""
        path.touch()  # also of a test without frames
        log = BusLog(path, "can0")
        for end_ns, frame in sorted(self.frames, key=lambda heard: heard[0]):
            log.add(LoggedFrame(1e-9 * end_ns, *frame, is_received=True))
        log.write()


class Artefacts:
    """Frame log and runs of one test, in memory until it fails.

    Attributes:
        is_saved: True once they are on disk.
    """

    def __init__(self, directory: Path) -> None:
        self.trace = FrameLog()
        self.is_saved = False
        self._directory = directory
        self._runs: deque[tuple[str, RunReader]] = deque(maxlen=MAX_RUNS)
        self._count = 0

    def add_run(self, name: str, result: RunResult) -> None:
        """Add a run that has ended."""
        summary = {
            "cycles": result.cycles,
            "missed_cycles": result.missed_cycles,
            "sensor_missed": result.sensor_missed,
            "motion_s": result.motion_s,
            "stopped": None if result.stopped is None else str(result.stopped),
        }
        self.add_live(name, lambda: (summary, result.recording))

    def add_live(self, name: str, tell: RunReader) -> None:
        """Add a run that is still going."""
        self._count += 1
        self._runs.append((f"{self._count:02d}-{name}", tell))

    def keep(self) -> str:
        """Write all artefacts; return the files in words.

        They replace those of an earlier failure of this test.
        """
        if self._directory not in _written and len(_written) >= MAX_TESTS:
            return f"trace and runs are not kept: {MAX_TESTS} failed tests have left theirs below {self._directory.parent}"
        try:
            return self._write()
        except OSError as error:
            return f"trace and runs cannot be kept: {error}"

    def _write(self) -> str:
        root = self._directory.parent
        root.mkdir(parents=True, exist_ok=True)
        if not (root / ".gitignore").exists():
            (root / ".gitignore").write_text("*\n", encoding="ascii")
        shutil.rmtree(self._directory, ignore_errors=True)
        self._directory.mkdir()
        _written.add(self._directory)
        self.is_saved = True
        self.trace.save(self._directory / "bus.log")
        runs = []
        for name, tell in self._runs:
            summary, recording = tell()
            runs.append({"name": name, **summary})
            if len(recording.time_s):
                recording.save(self._directory / f"{name}.csv")
                runs[-1]["recording"] = f"{name}.csv"
        (self._directory / "runs.json").write_text(json.dumps(runs, indent=2) + "\n", encoding="utf-8")
        forgotten = self.trace.heard_frames - len(self.trace.frames)
        older = f", {forgotten} older ones dropped" if forgotten else ""
        lines = [f"kept in {self._directory}", f"  bus.log: {len(self.trace.frames)} frames{older}"]
        lines += [f"  {run.get('recording', run['name'])}: {run['stopped'] or 'not stopped'}" for run in runs]
        return "\n".join(lines)


def directory_of(config: pytest.Config, node_id: str) -> Path:
    """Return the directory that is named after a test."""
    given: str | None = config.getoption("hil_keep_traces")
    root = config.invocation_params.dir / (".hil-traces" if given is None else given)
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", node_id).strip("-.")
    if len(name) > MAX_NAME or name != node_id:  # names that differ stay different
        name = f"{name[-MAX_NAME:].lstrip('-.')}-{hashlib.sha256(node_id.encode()).hexdigest()[:6]}"
    return root / name
