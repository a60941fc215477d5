"""Reading of all runs below a folder, each once.

A result that cannot be read is listed by name; the others are read all the same.
"""

import hashlib
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from hil.bench.bench import AxisTable
from hil.control.treatments import treatment
from hil.design.frequency import Margins, margins
from hil.errors import NotPossibleError
from hil.passport.gather import MOST_BYTES, found_files, utc_of
from hil.report.material import MARGIN_SPEEDS_RPS, run_name, worst_of
from hil.results.acted import notches_of
from hil.results.files import ResultFileError, load_any
from hil.results.runs import ExperimentsResult, RunEntry


@dataclass(frozen=True)
class TrendRun:
    """A window of a run, with its date.

    Attributes:
        robot: Name of the bench, and whether it was emulated.
        date_utc: Beginning of its measurement, ISO 8601 in UTC.
        folder: Directory of its result, relative to the given folder.
        margins: Worst margins of the axis' loop by the model, with the filters that acted; None if plant, gains or filters are
            not known, for a line motion, and for a host-closed loop.
    """

    robot: str
    date_utc: str
    folder: str
    entry: RunEntry
    margins: Margins | None

    @property
    def case(self) -> str:
        """Motion, treatment, loop and window in words."""
        return run_name(self.entry)


@dataclass(frozen=True)
class GatheredRuns:
    """All runs below a folder.

    Attributes:
        others: Number of results of other commands, by command.
        copies: Number of results that are a copy of another.
    """

    runs: tuple[TrendRun, ...]
    results: int
    left_out: tuple[str, ...]
    others: dict[str, int]
    copies: int


def gather_runs(folder: Path) -> GatheredRuns:
    """All runs below a folder; symbolic links are not followed.

    Raises:
        NotPossibleError: There are no runs, or too many files.
    """
    runs: list[TrendRun] = []
    left_out: list[str] = []
    others: Counter[str] = Counter()
    seen: set[str] = set()
    found = copies = 0
    for path in found_files([folder]):
        try:
            if path.stat().st_size > MOST_BYTES:
                raise ValueError(f"larger than {MOST_BYTES // 1_000_000} MB")
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            result = load_any(path)
            if isinstance(result, ExperimentsResult):
                windows = _windows(result, path.parent.relative_to(folder).as_posix())
        except (ResultFileError, OSError, ValueError) as error:
            left_out.append(f"{path}: {str(error).removeprefix(f'{path}: ')}")
            continue
        if content in seen:
            copies += 1
            continue
        seen.add(content)
        if isinstance(result, ExperimentsResult):
            runs += windows
            found += 1
        else:
            others[result.kind.replace("-", " ")] += 1
    if not runs:
        more = f": {len(left_out)} cannot be read, of which the first is {left_out[0]}" if left_out else ""
        raise NotPossibleError(f"no runs below {folder}{more}")
    ordered = sorted(runs, key=lambda run: (run.date_utc, run.folder))
    return GatheredRuns(tuple(ordered), found, tuple(left_out), dict(sorted(others.items())), copies)


def _windows(result: ExperimentsResult, folder: str) -> list[TrendRun]:
    """Windows of a result.

    Raises:
        ValueError: Its date cannot be.
    """
    date = utc_of(result.bench.started_utc)
    robot = f"{result.bench.name}, emulated" if result.emulated else result.bench.name
    return [TrendRun(robot, date, folder, run, _margins(result, run)) for run in result.runs]


def _margins(result: ExperimentsResult, run: RunEntry) -> Margins | None:
    table = result.bench.file.axis.get(run.axis) if run.axis is not None else None
    if table is None or not table.has_loop or run.loop != "drive":
        return None
    own = notches_of(run.filters).get(run.axis or 0, ()) if treatment(run.treatment).filters == "variable" else ()
    acted = table.model_copy(update={"notch": own})
    return _worst(acted.model_dump_json(), run.control_period_s)


@lru_cache(maxsize=1024)
def _worst(table_json: str, period_s: float) -> Margins | None:
    loop = AxisTable.model_validate_json(table_json).loop(period_s)
    if loop is None:
        return None
    return worst_of(margins(loop, float(speed), points=1000) for speed in MARGIN_SPEEDS_RPS)
