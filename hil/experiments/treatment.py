"""What can act against the transmission error in a run, by name: filters, gains, cancellation, and what each needs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from hil.control.notch import FixedFilter, notch_coefficients
from hil.errors import NotPossibleError
from hil.master.bench import Bench
from hil.master.designed import Designs, with_designs
from hil.master.identified import Identified, with_identified
from hil.master.session import Compensation

TreatmentName = Literal[
    "none", "low-gains", "fixed-notch", "notch", "notch-optimised", "ate", "ate+notch", "ate-inside", "adaptive"
]
TREATMENTS: tuple[TreatmentName, ...] = get_args(TreatmentName)

TITLES: dict[str, str] = {
    "none": "nothing",
    "low-gains": "gains halved",
    "fixed-notch": "fixed notch",
    "notch": "notch",
    "notch-optimised": "designed notch",
    "ate": "cancellation",
    "ate+notch": "cancellation and notch",
    "ate-inside": "cancellation in the drives",
    "adaptive": "learnt cancellation",
}

CANCELLING: frozenset[TreatmentName] = frozenset({"ate", "ate+notch", "adaptive"})

FILTERING: frozenset[TreatmentName] = frozenset({"notch", "notch-optimised", "ate+notch"})
"""Those in which the drives' variable filters act."""

ASKED: frozenset[TreatmentName] = frozenset({"notch", "notch-optimised", "ate", "ate+notch", "ate-inside", "adaptive"})
"""Those that are meant to keep the specification; the others are there to compare."""

LOW_GAIN = 0.5
"""Share of all three gains: about what an engineer takes back until the arm is quiet."""


@dataclass(frozen=True)
class Knowledge:
    """What has been found out about a robot, beside its bench file.

    Attributes:
        identified: By `hil identify`; None: the bench file's model holds.
        designs: By `hil design`.
        learnt: By `hil learn`.
    """

    identified: Identified | None = None
    designs: Designs | None = None
    learnt: Identified | None = None


@dataclass(frozen=True)
class Treated:
    """How a run is made.

    Attributes:
        bench: The bench file, with the gains and filters of this treatment.
        filters: Whether they act.
        is_cancelled: Whether the set-points are corrected.
        is_inside: Whether the drives cancel the error in their own loops.
        cancel_with: What the correction is computed from; None: the bench file's model.
        fixed: Filters that do not follow the speed, by axis; host-closed only.
        shows_filter: Whether the drives tell what their filters do; it takes room on the bus.
    """

    bench: Bench
    filters: Compensation = "none"
    is_cancelled: bool = False
    is_inside: bool = False
    cancel_with: Identified | None = None
    fixed: Mapping[int, FixedFilter] = field(default_factory=dict)
    shows_filter: bool = True


def treated(bench: Bench, name: TreatmentName, knowledge: Knowledge, period_s: float, loop: str) -> Treated:
    """The bench and the switches of a treatment.

    Args:
        bench: The bench file.
        name: Of the treatment.
        knowledge: What has been found out.
        period_s: Sampling time of the loop, for filters that are computed here.
        loop: Where it is closed.

    Raises:
        NotPossibleError: What it needs is not known, is another robot's, or is not possible in this loop.
    """
    if name in {*CANCELLING, "ate-inside"} and loop == "host":
        raise NotPossibleError(f"{name}: set-points are corrected where the drives close the loop (--loop drive)")
    if name == "ate-inside":
        return Treated(bench, is_inside=True, cancel_with=knowledge.identified)
    if name == "none":
        return Treated(bench)
    if name == "notch":
        return Treated(bench, "notch")
    if name == "low-gains":
        return Treated(with_low_gains(bench))
    if name == "fixed-notch":
        if loop != "host":
            raise NotPossibleError("fixed-notch: the drives' own filters follow the speed; this one acts with --loop host")
        return Treated(bench, fixed=fixed_filters(bench, knowledge, period_s))
    if name == "notch-optimised":
        if knowledge.designs is None:
            raise NotPossibleError("notch-optimised needs a design file: --design design.toml, from hil design notch")
        return Treated(with_designs(bench, knowledge.designs), "notch")
    if name == "adaptive":
        if knowledge.learnt is None:
            raise NotPossibleError("adaptive needs what has been learnt: --learnt learnt.toml, from hil learn")
        return Treated(bench, "none", is_cancelled=True, cancel_with=knowledge.learnt)
    return Treated(bench, "notch" if name == "ate+notch" else "none", is_cancelled=True, cancel_with=knowledge.identified)


def with_low_gains(bench: Bench, share: float = LOW_GAIN) -> Bench:
    """The bench with all gains at a share of what they are."""
    axes = {}
    for number, table in bench.axis.items():
        gains = {name: share * getattr(table.control, name) for name in type(table.control).model_fields if name != "lowpass_hz"}
        axes[number] = table.model_copy(update={"control": table.control.model_copy(update=gains)})
    return bench.model_copy(update={"axis": axes})


def fixed_filters(bench: Bench, knowledge: Knowledge, period_s: float) -> dict[int, FixedFilter]:
    """For each axis with a notch and a model: the same notch, held where |G_al| peaks, at every speed.

    Raises:
        NotPossibleError: No axis has both.
    """
    known = bench if knowledge.identified is None else with_identified(bench, knowledge.identified)
    found = {}
    for number, table in known.axis.items():
        loop = table.loop(period_s, 1, with_notch=False)
        if loop is None or not table.notch:
            continue
        notch, peak = table.notch[0], loop.peak_hz()
        found[number] = FixedFilter(*notch_coefficients(peak, peak + notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, period_s))
    if not found:
        raise NotPossibleError("fixed-notch needs an axis with a notch and a model (hil identify plant)")
    return found
