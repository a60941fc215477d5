"""Comparability of two results, and their paired runs.

Two results can be compared if they are of one kind, from one robot, and of the same motions; all others raise an error.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from hil.bench.bench import Bench
from hil.errors import NotPossibleError
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT
from hil.results.ate import AteResult
from hil.results.base import MeasuredResult
from hil.results.plant import PlantResult
from hil.results.runs import ExperimentsResult, RunEntry

Case = tuple[str, int | None]
Key = tuple[str, int | None, str, str, int | None]


@dataclass(frozen=True)
class RunPair:
    """A window of a run, and its counterpart in the old result."""

    new: RunEntry
    old: RunEntry


@dataclass(frozen=True)
class PairedRuns:
    """Runs of two results."""

    pairs: tuple[RunPair, ...]
    only_new: tuple[RunEntry, ...]
    only_old: tuple[RunEntry, ...]


def check_robot(new: MeasuredResult, old: MeasuredResult) -> None:
    """Refuse results of different kinds, or of different robots.

    Raises:
        NotPossibleError: They are.
    """
    if new.kind != old.kind:
        raise _unlike(f"one is of hil {_command(new)}, the other of hil {_command(old)}")
    own, other = new.bench.file, old.bench.file
    if own.name != other.name:
        raise _unlike(f"one is of the robot “{own.name}”, the other of “{other.name}”")
    if None not in {new.emulated, old.emulated} and new.emulated != old.emulated:
        which = "new" if new.emulated else "old"
        raise _unlike(f"the {which} one is of an emulated robot, the other was measured on a real one")
    if set(own.axis) != set(other.axis):
        raise _unlike(f"one robot has axes {_names(own.axis)}, the other {_names(other.axis)}")
    for number, axis in own.axis.items():
        ratio = other.axis[number].reduction_ratio
        if axis.reduction_ratio != ratio:
            raise _unlike(f"axis {number} has a gear of {axis.reduction_ratio:g} in one, of {ratio:g} in the other")
    if isinstance(new, AteResult | PlantResult) and isinstance(old, AteResult | PlantResult) and new.axis != old.axis:
        raise _unlike(f"one is of axis {new.axis}, the other of axis {old.axis}")


def paired_runs(new: ExperimentsResult, old: ExperimentsResult) -> PairedRuns:
    """Windows of the runs that can be compared.

    A window is paired with that of the same motion, axis, treatment, loop and order. If a motion has one window without a pair in
    each result, these two are a pair as well; treatment or loop then differs.

    Raises:
        NotPossibleError: They have no motion in common, or a common motion differs.
    """
    shared = _cases(new.runs) & _cases(old.runs)
    if not shared:
        raise _unlike(f"one moved {_motions(new.runs)}, the other {_motions(old.runs)}")
    for experiment in sorted({experiment for experiment, _ in shared}):
        _check_motion(experiment, new.bench.file, old.bench.file)
    left = {_key(run): run for run in old.runs}
    pairs, only_new = [], []
    for run in new.runs:
        found = left.pop(_key(run), None)
        if found is None:
            only_new.append(run)
        else:
            pairs.append(RunPair(run, found))
    only_old = list(left.values())
    for run in tuple(only_new):
        mine, others = ([each for each in runs if _window(each) == _window(run)] for runs in (only_new, only_old))
        if len(mine) == len(others) == 1:
            pairs.append(RunPair(run, others[0]))
            only_new.remove(run)
            only_old.remove(others[0])
    if not pairs:
        raise _unlike("no run of one has the same motion, window and treatment as a run of the other")
    return PairedRuns(tuple(pairs), tuple(only_new), tuple(only_old))


def _check_motion(experiment: str, new: Bench, old: Bench) -> None:
    if experiment not in {CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT}:
        return
    name = experiment.replace("-", "_")  # its table in the bench file
    own, other = (None if table is None else table.model_dump() for table in (getattr(new, name), getattr(old, name)))
    if own == other:
        return
    if own is None or other is None:
        raise _unlike(f"{name} is in one bench file only")
    differing = [f"{key} = {other[key]} became {own[key]}" for key in own if own[key] != other.get(key)]
    raise _unlike(f"the motion differs: in {name} {'; '.join(differing)}")


def _unlike(why: str) -> NotPossibleError:
    return NotPossibleError(f"the results are too different to compare: {why}")


def _command(result: MeasuredResult) -> str:
    return result.kind.replace("-", " ")


def _names(axes: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(axes)))


def _cases(runs: Iterable[RunEntry]) -> set[Case]:
    return {(run.experiment, run.axis) for run in runs}


def _key(run: RunEntry) -> Key:
    return run.experiment, run.axis, run.treatment, run.loop, run.order


def _window(run: RunEntry) -> tuple[str, int | None, int | None]:
    return run.experiment, run.axis, run.order


def _motions(runs: Iterable[RunEntry]) -> str:
    names = (
        experiment.replace("-", " ") + ("" if axis is None else f" of axis {axis}")
        for experiment, axis in sorted(_cases(runs), key=str)
    )
    return ", ".join(names) or "nothing"
