"""Set-up of a treatment in a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hil.bench.bench import Bench
from hil.bench.design import Designs, load_designs, with_designs
from hil.bench.model import Identified, load_identified, with_identified
from hil.control.notch import FixedFilter, notch_coefficients
from hil.control.treatments import TABLE, Treatment, TreatmentName, treatment
from hil.errors import NotPossibleError
from hil.master.motion import FilterUse
from hil.results.acted import FileRole, SourceFile, bench_files

TREATMENTS: tuple[TreatmentName, ...] = tuple(each.name for each in TABLE)

TITLES: dict[str, str] = {each.name: each.title for each in TABLE}

FILTERING: frozenset[TreatmentName] = frozenset(each.name for each in TABLE if each.filters == "variable")
"""Treatments in which the drives' variable filters act."""

REMEDIES: frozenset[TreatmentName] = frozenset(each.name for each in TABLE if each.is_remedy)
"""Treatments that are meant to keep the specification; the others serve the comparison."""

HOST_CLOSED: frozenset[TreatmentName] = frozenset(each.name for each in TABLE if each.loops == ("host",))
"""Treatments of the host's own loop; they are compared with a host-closed run without treatment."""


NO_FOLLOWING_ON_ARM = (
    "cancellation-following reads one direction of the tip with a lever for each axis, but on a bench with an "
    "arm the tip is a vector; choose --treatment cancellation, or learn again on the line (hil learn --motion "
    "line-motion)"
)

NO_FOLLOWING_BY_ENCODERS = (
    "cancellation-following can replace the accelerometer by a joint's encoder only if that axis moves alone; "
    "choose --treatment cancellation, or use an accelerometer for a motion of several axes"
)


def arm_remark(bench: Bench, name: str) -> str | None:
    """Remark on a treatment that is worse than cancellation on an arm.

    It is None if there is no arm, or if the treatment does not combine filters with a cancellation.

    The reference arm's line is left at 0.012 mm by both, at 0.009 mm by the cancellation alone.
    """
    if bench.arm is None or not (treatment(name).filters and treatment(name).cancels):
        return None
    return (
        f"{name}: on an arm, filters with a cancellation leave more vibration than the cancellation alone. The loops then "
        f"reject the torques of the other axes less; choose --treatment cancellation"
    )


@dataclass(frozen=True)
class Knowledge:
    """Knowledge of a robot beside its bench file.

    Attributes:
        identified: Model file of `hil identify`; None: the bench file's model holds.
        designs: Design file of `hil design`.
        learnt: Model file of `hil learn`.
        files: All files that the bench and this were read from.
    """

    identified: Identified | None = None
    designs: Designs | None = None
    learnt: Identified | None = None
    files: tuple[SourceFile, ...] = ()


def known_from(
    bench_file: str | Path,
    bench: Bench,
    *,
    model: Path | None = None,
    design: Path | None = None,
    learnt: Path | None = None,
) -> Knowledge:
    """Knowledge of a robot from its files, with their SHA-256.

    Args:
        bench_file: File of the bench, or a name of the package.
        bench: The bench that it has given.

    Raises:
        FileError: A file is not valid; every problem is listed by line.
        OSError: A file cannot be read.
    """
    roles: tuple[tuple[FileRole, Path | None], ...] = (("model", model), ("design", design), ("learnt", learnt))
    return Knowledge(
        identified=None if model is None else load_identified(model),
        designs=None if design is None else load_designs(design),
        learnt=None if learnt is None else load_identified(learnt),
        files=(*bench_files(bench_file, bench), *(SourceFile.of(role, path) for role, path in roles if path is not None)),
    )


@dataclass(frozen=True)
class TreatmentSetup:
    """Set-up of a run with a treatment.

    Attributes:
        bench: The bench file, with the gains and filters of this treatment.
        filters: Filters of the drives that act.
        is_designed: True if the filters are those of a design file, which are tried on the robot first.
        is_inside: True if the drives cancel the error in their own loops.
        cancel_with: Model of the cancellation; None for the bench file's.
        fixed: Filters that do not follow the speed, by axis; host-closed only.
        shows_filter: True if the drives report their filters' state; it takes room on the bus.
        follows: True if the cancellation follows the remaining vibration.
    """

    bench: Bench
    filters: FilterUse = "none"
    is_designed: bool = False
    is_cancelled: bool = False
    is_inside: bool = False
    cancel_with: Identified | None = None
    fixed: Mapping[int, FixedFilter] = field(default_factory=dict)
    shows_filter: bool = True
    follows: bool = False


def treatment_setup(bench: Bench, name: TreatmentName, knowledge: Knowledge, period_s: float, loop: str) -> TreatmentSetup:
    """Set-up of a treatment: the bench file and the switches.

    Args:
        period_s: Sampling time of the loop, for filters that are computed here.

    Raises:
        NotPossibleError: A file that it needs is missing or another robot's, or it is not possible in this loop.
    """
    row = treatment(name)
    _check_loop(row, loop)
    if row.follows and bench.arm is not None:
        raise NotPossibleError(NO_FOLLOWING_ON_ARM)
    if row.gain_factor != 1.0:
        bench = with_scaled_gains(bench, row.gain_factor)
    if row.needs == "design":
        if knowledge.designs is None:
            raise NotPossibleError(f"{name} needs a design file: --design design.toml, from hil design notch")
        bench = with_designs(bench, knowledge.designs)
    return TreatmentSetup(
        bench,
        filters="notch" if row.filters == "variable" else "none",
        is_designed=row.needs == "design",
        is_cancelled=row.cancels == "set-points",
        is_inside=row.cancels == "inside",
        cancel_with=_cancelled_with(row, knowledge),
        fixed=fixed_filters(bench, knowledge, period_s) if row.filters == "fixed" else {},
        follows=row.follows,
    )


def _check_loop(row: Treatment, loop: str) -> None:
    """Refuse a loop in which a treatment cannot act."""
    if loop in row.loops:
        return
    if row.shaper is not None:
        raise NotPossibleError(f"{row.name} is fitted to a loop that the drive closes; choose --loop drive")
    if row.cancels:
        raise NotPossibleError(f"{row.name}: a cancellation needs loops that the drives close; choose --loop drive")
    raise NotPossibleError(f"{row.name} acts in the loop that the host closes; choose --loop host")


def _cancelled_with(row: Treatment, knowledge: Knowledge) -> Identified | None:
    """Model of a cancellation, or None for the bench file's.

    It is None without a cancellation too.
    """
    if row.needs == "learnt" and knowledge.learnt is None:
        raise NotPossibleError(f"{row.name} needs a learnt cancellation; give --learnt learnt.toml, from hil learn")
    if not row.cancels:
        return None
    return knowledge.learnt if row.needs == "learnt" else knowledge.identified


def with_scaled_gains(bench: Bench, factor: float) -> Bench:
    """Multiply all gains of a bench by a factor."""
    axes = {}
    for number, table in bench.axis.items():
        control = table.gains(f"axis {number} with lower gains")
        gains = {name: factor * getattr(control, name) for name in type(control).model_fields if name != "lowpass_hz"}
        axes[number] = table.model_copy(update={"control": control.model_copy(update=gains)})
    return bench.model_copy(update={"axis": axes})


def fixed_filters(bench: Bench, knowledge: Knowledge, period_s: float) -> dict[int, FixedFilter]:
    """Fixed filters by axis.

    The notch of each axis with a model is held at the peak of |G_al|, at every speed.

    Raises:
        NotPossibleError: No axis has a notch and a model.
    """
    identified_bench = bench if knowledge.identified is None else with_identified(bench, knowledge.identified)
    filters = {}
    for number, table in identified_bench.axis.items():
        loop = table.loop(period_s, 1, with_notch=False)
        if loop is None or not table.notch:
            continue
        notch, peak = table.notch[0], loop.peak_hz()
        filters[number] = FixedFilter(*notch_coefficients(peak, peak + notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, period_s))
    if not filters:
        raise NotPossibleError("fixed-notch needs an axis with a notch and a model; identify it with hil identify plant")
    return filters
