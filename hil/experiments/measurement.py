"""Measurement on a bench, shared by all commands."""

import contextlib
import datetime
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Literal, Self, TypeVar

from drive_profiles.address import Address, parse_address
from drive_profiles.files.safefile import check_writable, naming
from hil.bench.bench import Bench
from hil.can.channel import Channel
from hil.can.opening import open_channel
from hil.errors import NotPossibleError, SafetyStopError
from hil.experiments.bus_demand import BusDemand, check_load
from hil.master.drive.needs import ProfileGapsError, run_gaps, run_remarks
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog, Recording
from hil.reporter import SILENT, Reporter
from hil.results.base import LOG_FILE, RESULT_FILE, MeasuredBench, MeasuredResult

MAX_MISSED = 0.005
"""Fraction of a motion's cycles that may lack an answer, a set-point in time, or what tells the tip."""

ClockName = Literal["lock-step", "wall"]

R = TypeVar("R", bound=MeasuredResult)


@dataclass(frozen=True)
class MeasurementOutcome(Generic[R]):
    """End of a measurement.

    Attributes:
        result: Content of `result.json`.
        failure: Error that ended it early, or None.
    """

    result: R
    failure: Exception | None

    @property
    def not_restored(self) -> tuple[str, ...]:
        """Objects that could not be restored in the nodes, or empty."""
        return self.result.not_restored or ()


class Measurement(Generic[R]):
    """Bench under measurement, and the directory of its files.

    Within its context the bus is open; within that of `session` the nodes are brought up. Once a recording has been saved or a
    run was stopped, the result is written at the end. An error that ends the measurement is then noted in the result and in
    `failure`, and not raised. Before that nothing is written, and errors pass.

    Attributes:
        result: Content of `result.json` to be.
        failure: Error that ended the measurement early, or None.
        started: Instant of its beginning (UTC).
        shows_filter: For each demand of `session`, True if there is room for the state of the drives' filters as well.
    """

    result: R

    def __init__(
        self,
        bench: Bench,
        out: Path,
        make_result: Callable[[MeasuredBench], R],
        *,
        channel: Channel | None = None,
        reporter: Reporter = SILENT,
        file_name: str = RESULT_FILE,
    ) -> None:
        """Keep the bench and the directory; nothing is opened yet.

        Args:
            make_result: Maker of the result as it is before anything has been measured.
            channel: The bus; opened from the bench file's address, and closed, unless it is given.
        """
        self._bench, self._out, self._make_result, self._file_name = bench, out, make_result, file_name
        self._given, self._reporter = channel, reporter
        self._has_saved = False
        self._made: list[Path] = []
        self.failure: Exception | None = None
        self.shows_filter: list[bool] = []
        self.started = datetime.datetime.now(datetime.UTC)

    def __enter__(self) -> Self:
        """Make the directory, check write access, and open the bus.

        Raises:
            OSError: The directory cannot be made.
            FileError: Nothing can be written in it.
            ChannelError: The bus cannot be opened.
        """
        runs = self._out / "runs"
        self._made = [folder for folder in (runs, self._out) if not folder.exists()]
        runs.mkdir(parents=True, exist_ok=True)  # before anything moves: a recording needs a directory
        check_writable(self._out / self._file_name)
        check_writable(runs / "recording.csv")
        try:
            self._channel = open_channel(parse_address(self._bench.bus.address)) if self._given is None else self._given
        except BaseException:
            self._remove_empty()
            raise
        self.result = self._make_result(MeasuredBench.of(self._bench, self.started, is_lock_step=self._channel.is_lock_step))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> bool:
        """Close the bus and write the result."""
        if self._given is None:
            self._channel.close()
        if error is not None:
            if not self._has_saved and not isinstance(error, SafetyStopError):
                self._remove_empty()
                return False
            self.result.note_failure(error)
        self.result.write(self._out / self._file_name)
        if isinstance(error, Exception):
            self.failure = error
        return self.failure is not None

    def _remove_empty(self) -> None:
        """Remove the directories that it has made, if nothing is in them."""
        with contextlib.suppress(OSError):
            for folder in self._made:
                folder.rmdir()

    def check_clock(self, wanted: ClockName | None) -> None:
        """Refuse a bus whose clock is not the wanted one.

        None accepts either clock.

        Raises:
            NotPossibleError: The bus has the other clock; nothing has been sent.
        """
        address, is_lock_step = self._channel.address, self._channel.is_lock_step
        if wanted == "wall" and is_lock_step:
            raise NotPossibleError(
                f"time on {address} is counted in SYNCs, so --clock wall is not possible; start its emulator with the wall "
                f"clock (plant-emulator serve --wall)"
            )
        if wanted == "lock-step" and not is_lock_step:
            raise NotPossibleError(
                f"time on {address} is the wall clock's, so --clock lock-step is not possible: its nodes do not wait for SYNC"
            )

    @contextmanager
    def session(
        self,
        demands: Sequence[BusDemand],
        *,
        overload: bool = False,
        reset_faults: bool = False,
    ) -> Iterator[Session]:
        """Bring up a session that logs every frame.

        Raises:
            ProfileGapsError: Profiles lack what the motions need; nothing has been sent.
            NotPossibleError: The bus does not carry a motion; nothing has been sent.
            HilError: Nodes or limits do not allow it.
        """
        self.shows_filter = check_demands(self._bench, self._channel, demands, overload=overload)
        kinds = dict.fromkeys((demand.axes, demand.loop) for demand in demands)
        remarks = dict.fromkeys(words for axes, loop in kinds for words in run_remarks(self._bench, axes, loop))
        self.result.drive_remarks = tuple(remarks) or None
        for words in remarks:
            self._reporter.step(words)
        moving = None if self._bench.arm is not None else {number for axes, _ in kinds for number in axes}
        with self._new_session() as session:
            try:
                session.bring_up(reset_faults=reset_faults, moving=moving)
                self.result.note_emulation(session.emulated)
                yield session
            finally:
                self.result.not_restored = tuple(session.not_restored) or None

    def _new_session(self) -> Session:
        channel, progress = self._channel, self._reporter.progress
        path = self._out / LOG_FILE if getattr(channel, "is_logged", True) else None
        return Session(self._bench, channel, BusLog(path, log_label(channel.address)), progress)

    def keep(self, recording: Recording, name: str) -> str:
        """Save a recording as `runs/name.csv`.

        From now on the result is written, whatever happens.

        Returns:
            Its path, relative to the directory.
        """
        path = self._out / "runs" / f"{name}.csv"
        with naming(path):
            recording.save(path)
        self._has_saved = True
        return path.relative_to(self._out).as_posix()

    def made(self, result: RunResult, name: str) -> dict[str, Any]:
        """Save the recording of a run as `keep` does, and return the fields of its `MadeRun`."""
        return {
            "cycles": result.cycles, "missed_cycles": result.missed_cycles, "wall_s": round(result.wall_s, 4),
            "recording": self.keep(result.recording, name),
            "stopped": None if result.stopped is None else result.stopped.reason,
        }  # fmt: skip


def check_demands(bench: Bench, channel: Channel, demands: Sequence[BusDemand], *, overload: bool = False) -> list[bool]:
    """Refuse motions that the profiles or the bus do not allow.

    Nothing is sent.

    Returns:
        For each demand True if there is room for the state of the drives' filters as well.

    Raises:
        ProfileGapsError: Profiles lack what the motions need.
        NotPossibleError: The bus does not carry a motion.
    """
    kinds = dict.fromkeys((demand.axes, demand.loop, demand.with_notch) for demand in demands)
    gaps = [gap for axes, loop, with_notch in kinds for gap in run_gaps(bench, axes, loop, with_notch=with_notch)]
    if gaps:
        raise ProfileGapsError(dict.fromkeys(gaps))
    return [overload or check_load(bench, channel, demand) for demand in demands]


def log_label(address: Address) -> str:
    """Name of a bus in a candump log, by which it can be replayed."""
    return address.channel if address.interface == "socketcan" else address.interface
