"""The goals of a rehearsal, in one place."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from plant_emulator.rehearsal.many.causes import main_refusal
from plant_emulator.rehearsal.many.reading import KIND_NAMES, QUANTITY_NAMES, accepted, is_quiet, of_kind
from plant_emulator.rehearsal.many.rows import WALKED
from plant_emulator.rehearsal.many.summary import FAR_Z, quantities
from plant_emulator.rehearsal.record import PROBES, STEPS
from plant_emulator.trials.rows import Row, numbers, text
from plant_emulator.trials.statistics import fraction_text

QUIET_FRACTION = {"linear": 0.97, "real": 0.90}
"""Smallest part of a kind's robots that end with a true tip within the goal."""
TRUE_CAUSE_FRACTION = 0.90
"""Smallest part of the others that are refused, with the cause that is the true one."""
RMS_Z = (0.8, 1.25)
"""Range of the root mean square of the deviations in standard errors, of every stated quantity."""
FAR_FRACTION = 0.005
"""Fraction of the deviations beyond `FAR_Z` standard errors stays below this."""
FEWEST_Z, FEWEST_FAR = 10, 100
"""Values of a quantity from which its root mean square, and its fraction beyond, are judged."""
CPU_S = 10.0
"""Longest processor time of one robot's whole path in one process."""


@dataclass(frozen=True)
class RehearsalClaim:
    """One number with its goal.

    Attributes:
        holds: True if it holds; None if nothing was measured.
    """

    key: str
    name: str
    words: str
    asked: str
    measured: str
    holds: bool | None


def claims_of(rows: Sequence[Row]) -> list[RehearsalClaim]:
    """Return all claims, judged on these rows."""
    judges: tuple[Callable[[Sequence[Row]], RehearsalClaim], ...] = (
        _never_worse,
        _wrong_refused,
        lambda rows: _quiet(rows, "linear"),
        lambda rows: _quiet(rows, "real"),
        _true_causes,
        _rms_z,
        _far_together,
        _far_each,
        _cpu,
        _whole,
    )
    return [judge(rows) for judge in judges]


def document(rows: Sequence[Row], found: Sequence[RehearsalClaim]) -> dict[str, object]:
    """Return number of robots and claims as values for JSON."""
    return {"robots": len(rows), "claims": [asdict(each) for each in found]}


def part_claim(key: str, name: str, words: str, count: int, whole: int, least: float) -> RehearsalClaim:
    """Return the claim that at least a part of some robots is so; open without robots."""
    holds = count >= least * whole if whole else None
    return RehearsalClaim(key, name, words, f"{100.0 * least:g} %", fraction_text(count, whole), holds)


def _never_worse(rows: Sequence[Row]) -> RehearsalClaim:
    treated = [row for row in rows if accepted(row)]
    worse = [row for row in treated if text(row, "worse")]
    count = sum(len(accepted(row)) for row in treated)
    floor = sum(bool(row.get("raised_to_floor")) for row in treated)
    words = (
        "Never worse: no accepted treatment raises the true tip of any order by more than 5 % or 0.002 mm (whichever is more) "
        "above its value without it and above the floor"
    )
    measured = f"{len(worse)} of {len(treated)} robots, with {count} accepted treatments"
    measured += f"; in {floor} more the tip rises, but only to the floor" if floor else ""
    return RehearsalClaim("never_worse", "never worse", words, "0", measured, not worse if treated else None)


def _wrong_refused(rows: Sequence[Row]) -> RehearsalClaim:
    tried = [row.get(f"probe_{name}_accepted") for row in rows for name in PROBES]
    count, wrong = sum(each is not None for each in tried), sum(each is True for each in tried)
    words = "Wrong corrections accepted: φ_k off by 60°, 90°, 180°, A_k × 3, another robot's"
    return RehearsalClaim(
        "wrong_refused", "wrong corrections accepted", words, "0", f"{wrong} of {count}", wrong == 0 if count else None
    )


def _quiet(rows: Sequence[Row], kind: str) -> RehearsalClaim:
    own = of_kind(rows, kind)
    robots = {"linear": "Linear gears", "real": "Hysteresis to 2 N·m, softness to 30 %, current lag to 0.5 ms"}[kind]
    words = f"{robots}: the path ends with a true tip of at most 0.010 mm or 1.3 × the floor, whichever is more"
    name = f"{KIND_NAMES[kind]}: quiet"
    return part_claim(f"quiet_{kind}", name, words, sum(map(is_quiet, own)), len(own), QUIET_FRACTION[kind])


def _true_causes(rows: Sequence[Row]) -> RehearsalClaim:
    others = [row for row in rows if not is_quiet(row)]
    count = sum((refusal := main_refusal(row)) is not None and refusal.is_true for row in others)
    words = "The other robots are refused, with the true cause"
    return part_claim("true_cause", "others refused correctly", words, count, len(others), TRUE_CAUSE_FRACTION)


def _rms_z(rows: Sequence[Row]) -> RehearsalClaim:
    judged = [each for each in quantities(rows) if each.count >= FEWEST_Z]
    outside = [each for each in judged if not RMS_Z[0] <= each.rms_z <= RMS_Z[1]]
    words = f"Standard errors: rms of z of each quantity ({FEWEST_Z} values or more)"
    worst = max(judged, key=lambda each: abs(math.log(max(each.rms_z, 1e-9))), default=None)
    measured = (
        "no quantity"
        if worst is None
        else f"{len(outside)} of {len(judged)} outside; worst {QUANTITY_NAMES[worst.name]} {worst.rms_z:.2f}"
    )
    return RehearsalClaim("rms_z", "rms of z", words, f"{RMS_Z[0]:g} to {RMS_Z[1]:g}", measured, not outside if judged else None)


def _far_together(rows: Sequence[Row]) -> RehearsalClaim:
    found = quantities(rows)
    count, far = sum(each.count for each in found), sum(each.far for each in found)
    words = f"Standard errors: |z| > {FAR_Z:g}, all quantities together"
    holds = far < FAR_FRACTION * count if count else None
    return RehearsalClaim(
        "far_together", "|z| > 4, together", words, f"below {100.0 * FAR_FRACTION:g} %", fraction_text(far, count), holds
    )


def _far_each(rows: Sequence[Row]) -> RehearsalClaim:
    judged = [each for each in quantities(rows) if each.count >= FEWEST_FAR]
    outside = [each for each in judged if each.far >= FAR_FRACTION * each.count]
    words = f"Standard errors: |z| > {FAR_Z:g}, each quantity ({FEWEST_FAR} values or more)"
    worst = max(judged, key=lambda each: each.far / each.count, default=None)
    named = "" if worst is None else f"; worst {QUANTITY_NAMES[worst.name]} {fraction_text(worst.far, worst.count)}"
    measured = f"{len(outside)} of {len(judged)} outside{named}"
    holds = not outside if judged else None
    return RehearsalClaim("far_each", "|z| > 4, each quantity", words, f"below {100.0 * FAR_FRACTION:g} %", measured, holds)


def _cpu(rows: Sequence[Row]) -> RehearsalClaim:
    spent = sorted(numbers([row for row in rows if row.get("over_bus") is False], "cpu_s"))
    words = "Processor time of one robot's whole path in one process"
    over = sum(each > CPU_S for each in spent)
    measured = (
        f"{over} of {len(spent)} longer; median {spent[len(spent) // 2]:.1f} s, longest {spent[-1]:.1f} s"
        if spent
        else "no robot"
    )
    return RehearsalClaim("cpu", "processor time of a robot", words, f"{CPU_S:g} s", measured, over == 0 if spent else None)


def _whole(rows: Sequence[Row]) -> RehearsalClaim:
    broken = [row for row in rows if row.get("walk") != WALKED or any(text(row, f"{step}_ended") == "crashed" for step in STEPS)]
    words = "Every robot's path runs to its end, without an internal error"
    return RehearsalClaim("whole", "internal errors", words, "0", f"{len(broken)} of {len(rows)}", not broken if rows else None)
