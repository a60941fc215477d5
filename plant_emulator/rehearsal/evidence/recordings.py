"""Recordings of drawn robots from their identifications, kept with their truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drive_profiles.files.safefile import write_atomically
from drive_profiles.files.toml import load, loads
from hil.bench.bench import Bench
from hil.errors import HilError
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.path import SMALL_EFFORT
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.robots.writing import file_text
from plant_emulator.world import World

HELD_OUT_FROM = 50_001
"""Seeds from here on are for the final statement: no evidence is made of them."""


@dataclass(frozen=True)
class RecordedRobot:
    """Folder of one robot.

    It has the truth, the bench file, and the files of the identifications.
    """

    folder: Path

    @property
    def kind(self) -> str:
        """Kind of the robot that was drawn."""
        return self.folder.name.partition("-")[0]

    @property
    def files(self) -> PathFiles:
        """Files of the identifications."""
        return PathFiles(self.folder)

    @property
    def robot(self) -> Robot:
        """The robot, all its truth in it."""
        return load_robot(self._robot_file)

    @property
    def bench(self) -> Bench:
        """The bench file that it was identified with."""
        return load(self._bench_file, Bench)

    @property
    def _robot_file(self) -> Path:
        return self.folder / "robot.toml"

    @property
    def _bench_file(self) -> Path:
        return self.folder / "bench.toml"

    @property
    def is_complete(self) -> bool:
        """True if its identifications have ended; the truth is written last."""
        return self._robot_file.exists()

    def record(self, robot: Robot, bench_text: str) -> tuple[str, ...]:
        """Identify plant and transmission error, and keep all recordings.

        Returns the words of each refusal.
        """
        bench = loads(bench_text, Bench, "blank bench")
        channel = InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False)
        steps = StepsInProcess(bench, min(bench.axis), self.files, channel, SMALL_EFFORT)
        refused = []
        for step in (steps.plant, steps.ate):
            try:
                step()
            except HilError as error:
                refused.append(str(error))
        write_atomically(self._bench_file, bench_text.encode(), force=True)
        write_atomically(self._robot_file, file_text(robot).encode(), force=True)
        return tuple(refused)


def record(seeds: Sequence[int], kind: str, folder: Path) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Record the robots of some seeds that are not in a folder yet.

    Yields each seed with the words of its refusals.

    Args:
        seeds: Seeds below `HELD_OUT_FROM`.
        kind: One of `many.one.KINDS` but `both`.
        folder: Folder of all robots.

    Raises:
        ValueError: A seed is held out.
    """
    if held_out := [seed for seed in seeds if seed >= HELD_OUT_FROM]:
        raise ValueError(f"seed {held_out[0]} is held out; expected seeds below {HELD_OUT_FROM}")
    for seed in seeds:
        recorded = RecordedRobot(folder / f"{kind}-{seed}")
        if not recorded.is_complete:
            yield seed, recorded.record(*drawn(seed, kind))


def recorded_robots(folder: Path) -> list[RecordedRobot]:
    """Return the complete robots of a folder, by name."""
    found = [RecordedRobot(path) for path in sorted(folder.iterdir()) if path.is_dir()]
    return [each for each in found if each.is_complete]
