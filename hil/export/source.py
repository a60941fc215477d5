"""Sources of an export: directory of a run, recording, or log.

Modules that read a log, or a result for its bench file, load slowly, so they are imported only where they are needed.
"""

# ruff: noqa: PLC0415 - as the docstring says

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import ExportError, HilError
from hil.export.series import Series, of_recording

if TYPE_CHECKING:
    from drive_profiles.eds.description import Description
    from hil.bench.bench import Bench
    from hil.export.decoded import Decoded

LOG_FILE, RUNS = "bus.log", "runs"
RECORDING_SUFFIX = ".csv"


@dataclass(frozen=True)
class Known:
    """Additional statements on a source.

    Attributes:
        bench: Bench file; None: that of the result in the log's folder.
        interface: Interface of a log of several; None: that of the first frame.
        run: Name of the recording in a directory of several; None if there is one.
    """

    bench: "Bench | None"
    descriptions: "Mapping[int, Description]"
    interface: str | None = None
    run: str | None = None


def mapping_of(path: Path, known: Known) -> "Decoded":
    """The process data of a source's log.

    Raises:
        ExportError: There is no log.
        LogError: The log cannot be read.
        NodeError: The log contradicts the bench file.
    """
    from hil.export.decoded import decoded
    from hil.logs.opening import open_log
    from hil.logs.trace import Trace

    log = path / LOG_FILE if path.is_dir() else path
    if log.suffix == RECORDING_SUFFIX:
        raise ExportError(path, f"a recording has no frames; give {LOG_FILE} of its run")
    if not log.exists():
        raise ExportError(log, f"no such file; hil run writes {LOG_FILE} beside its result")
    trace = Trace(open_log(log, interface=known.interface), known.descriptions)
    return decoded(trace, known.bench or bench_beside(log))


def bench_beside(log: Path) -> "Bench | None":
    """Return the bench file of the result beside a log.

    None if there is no result.

    Raises:
        HilError: There is a result, and it cannot be read.
    """
    from hil.bench.bench import Bench
    from hil.results.base import RESULT_FILE

    path = log.with_name(RESULT_FILE)
    if not path.is_file():
        return None
    from hil.results.files import load_any

    measured = getattr(load_any(path), "bench", None)
    found = getattr(measured, "file", None)
    return found if isinstance(found, Bench) else None


def series_in(path: Path, known: Known) -> "tuple[list[Series], Decoded | None]":
    """Return the numbers of a source over time, and its frames' meaning.

    Raises:
        HilError: There are no numbers, or several recordings and none is named.
    """
    if not path.exists():
        raise ExportError(path, "no such file or directory")
    if not path.is_dir() and path.suffix != RECORDING_SUFFIX:
        from hil.export.decoded import series_of

        what = mapping_of(path, known)
        found = list(series_of(what))
        if not found:
            raise ExportError(path, "no frame of it can be decoded; give --description FILE:NODE for the mapping of a node")
        return found, what
    try:
        return [of_recording(_recording_of(path, known.run))], None
    except HilError:
        raise
    except ValueError as error:
        raise ExportError(path, str(error)) from error


def _recording_of(path: Path, run: str | None) -> Path:
    if not path.is_dir():
        return path
    there = sorted((path / RUNS).glob(f"*{RECORDING_SUFFIX}"))
    names = ", ".join(each.stem for each in there)
    if run is not None:
        chosen = [each for each in there if each.stem == run]
        if not chosen:
            raise ExportError(path, f"no recording {run!r}; there are {names or 'none'}")
        return chosen[0]
    if len(there) != 1:
        raise ExportError(
            path, f"it has {len(there)} recordings; give --run with one of {names}" if there else "it has no recording"
        )
    return there[0]
