"""Scale by which a bench's runs are judged: f_al of the axes that move, from the bench's models.

A run without an f_al is not judged. The paper's robot (`reference = "paper"`) is judged in the windows of the paper, but for an
axis that is another one than the paper's.
"""

from collections.abc import Iterable

from hil.analysis import TipScale, joint_scale, paper_scale, tip_scale
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.design.frequency import CONTROL_PERIOD_S
from hil.errors import NotPossibleError

PAPER_F_AL_HZ = {2: 11.84, 3: 11.45}
"""f_al of the paper's robot by axis; source: the paper, Table 1."""
PAPER_LINE_AXIS = 2
"""Axis by whose f_al the line motion of the paper's robot becomes a displacement."""
PAPER_TOLERANCE = 0.05
"""Relative difference from the paper's f_al beyond which an axis is another one."""


def peak_hz(bench: Bench, axis: int, control_period_s: float = CONTROL_PERIOD_S) -> float | None:
    """f_al of an axis in Hz: the peak of |G_al| of its model with the P-PI in the drive; None without a model."""
    loop = bench.axis[axis].loop(control_period_s, with_notch=False)
    return None if loop is None else loop.peak_hz()


def scale_at(bench: Bench, axis: int, f_al_hz: float) -> TipScale:
    """Scale of an axis with a known f_al."""
    paper = PAPER_F_AL_HZ.get(axis) if bench.is_paper else None
    if paper is not None and abs(f_al_hz - paper) <= PAPER_TOLERANCE * paper:
        return paper_scale(f_al_hz)
    return tip_scale(f_al_hz)


def axis_scale(bench: Bench, axis: int, control_period_s: float = CONTROL_PERIOD_S) -> TipScale | None:
    """Scale of an axis; None where the bench has no model of it."""
    f_al_hz = peak_hz(bench, axis, control_period_s)
    return None if f_al_hz is None else scale_at(bench, axis, f_al_hz)


def line_scale(bench: Bench, control_period_s: float = CONTROL_PERIOD_S) -> TipScale | None:
    """Scale of the line motion, from all of its axes with a model; None without any."""
    scales = {axis: axis_scale(bench, axis, control_period_s) for axis in bench.chain_axes}
    known = {axis: scale for axis, scale in scales.items() if scale is not None}
    if bench.is_paper and PAPER_LINE_AXIS in known:
        return known[PAPER_LINE_AXIS]
    return joint_scale(list(known.values())) if known else None


def missing_words(axes: Iterable[int]) -> str:
    """Sentence on why a run is not judged that has no f_al."""
    numbers = [str(axis) for axis in axes]
    who = f"axis {numbers[0]} has" if len(numbers) == 1 else f"none of the axes {', '.join(numbers)} has"
    return (
        f"{who} {'no' if len(numbers) == 1 else 'a'} model, so f_al is not known, at which the arm rings and by which an "
        "acceleration becomes mm: hil identify plant --model model.toml, then run with --model, or give it in the bench file"
    )


def vibration_scale(bench: Bench, axes: Iterable[int], identified: Identified | None = None) -> TipScale:
    """Scale for vibrations that are only compared with each other: f_al, or what was identified of the arm on its gear.

    Args:
        bench: The bench file.
        axes: Axes that move.
        identified: Model file of a cancellation; None: the bench file's model holds.

    Raises:
        NotPossibleError: Nothing is known of any axis.
    """
    scales = []
    moved = tuple(axes)
    for axis in moved:
        f_al_hz = peak_hz(bench, axis)
        known = None if identified is None else identified.axis.get(axis)
        if f_al_hz is None and known is not None:
            f_al_hz = known.plant.antiresonance_hz if known.plant is not None else known.ate.arm_hz if known.ate else None
        if f_al_hz is not None:
            scales.append(scale_at(bench, axis, f_al_hz))
    if not scales:
        raise NotPossibleError(missing_words(moved))
    return scales[0] if len(scales) == 1 else joint_scale(scales)
