"""Filters, cancelled orders and source files of a run."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, Self

from hil.bench.bench import Bench, source_of
from hil.bench.design import notch_table
from hil.control.notch import FixedFilter, Notch
from hil.results.base import ResultPart
from hil.robot_tables import NotchTable

FileRole = Literal["bench", "model", "design", "learnt", "drive profile", "arm"]


class ActedFilter(ResultPart):
    """A filter that acted in a run.

    Attributes:
        held_by: `drive`: the parameters are those that the drive held, read back; `host`: those of the master's own loop.
        notch: The filter, if it follows the speed.
        fixed: The filter, if it does not.
    """

    axis: int
    held_by: Literal["drive", "host"]
    notch: NotchTable | None = None
    fixed: FixedFilter | None = None


class CancelledOrder(ResultPart):
    """An order of the transmission error that was cancelled in a run.

    Attributes:
        held_by: `drive`: the drive cancelled it, and the values are those that it held, read back; `host`: by set-points.
    """

    axis: int
    order: float
    amplitude_arcsec: float
    phase_deg: float
    held_by: Literal["drive", "host"]


class SourceFile(ResultPart):
    """A file from which a run took something.

    Attributes:
        role: Part that it has: bench, model, design or learnt, or a file that the bench file names.
    """

    role: FileRole
    path: str
    sha256: str

    @classmethod
    def of(cls, role: FileRole, path: str | Path) -> Self:
        """Describe a file as it is now.

        A bench of the package may be given by its name.

        Raises:
            OSError: The file cannot be read.
        """
        return cls(role=role, path=str(path), sha256=hashlib.sha256(source_of(path).read_bytes()).hexdigest())


def bench_files(path: str | Path, bench: Bench) -> tuple[SourceFile, ...]:
    """Return the files of a bench: its own, and those it names.

    Raises:
        OSError: One of them cannot be read.
    """
    profiles = dict.fromkeys([*(table.profile for table in bench.axis.values()), bench.accelerometer.profile])
    own = [SourceFile.of("drive profile", each) for each in profiles if Path(each).is_absolute()]
    urdf = None if bench.arm is None else bench.arm.urdf
    arm = [] if urdf is None else [SourceFile.of("arm", source_of(path).absolute().parent / urdf)]
    return (SourceFile.of("bench", path), *own, *arm)


def acted_filters(
    held_by: Literal["drive", "host"], filters: Mapping[int, Sequence[Notch | FixedFilter]]
) -> tuple[ActedFilter, ...]:
    """Entries of the filters that acted."""
    return tuple(
        ActedFilter(axis=axis, held_by=held_by, notch=notch_table(each))
        if isinstance(each, Notch)
        else ActedFilter(axis=axis, held_by=held_by, fixed=each)
        for axis, own in filters.items()
        for each in own
    )


class FilterSet(NamedTuple):
    """Filters that acted together.

    Attributes:
        notches: The filters that follow the speed, by axis.
    """

    treatments: tuple[str, ...]
    loop: Literal["drive", "host"]
    notches: Mapping[int, tuple[NotchTable, ...]]


def notches_of(filters: Iterable[ActedFilter]) -> dict[int, tuple[NotchTable, ...]]:
    """Filters that follow the speed, by axis."""
    found: dict[int, tuple[NotchTable, ...]] = {}
    for each in filters:
        if each.notch is not None:
            found[each.axis] = (*found.get(each.axis, ()), each.notch)
    return found
