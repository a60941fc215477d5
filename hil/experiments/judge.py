"""Scale by which a bench's runs are judged.

The scale needs f_al of the axes that move, from a model or from a ramp.

A model, of the bench file or identified, comes first. Without one, a ramp on which nothing acts against the vibration may show
the resonance by itself (`hil.design.ringing`); with one, what it shows has to agree. A run without an f_al is not judged. The
paper's robot (`reference = "paper"`) is judged in the windows of the paper, but for an
axis that is another one than the paper's.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from hil.analysis import BRAKING_S, TipScale, band_scale, joint_scale, last_rps, paper_scale, ramp_scale, shown_band, tip_scale
from hil.bench.bench import Bench
from hil.bench.model import Identified, with_identified
from hil.control.arrays import Complex
from hil.control.trajectory import reach_rps
from hil.design.estimation import FAR_SIGMAS
from hil.design.frequency import CONTROL_PERIOD_S
from hil.design.paper import TABLE_1
from hil.design.ringing import NoResonanceError, Ramp, Ringing, ringing
from hil.design.uncertainty import LEAST_SPREAD
from hil.errors import NotPossibleError
from hil.experiments.shaping import rates_of
from hil.recording import Recording
from hil.robot_tables import ORDERS

PAPER_LINE_AXIS = 2
"""Bound: axis by whose f_al the line motion of the paper's robot becomes a displacement."""
MOST_DIFFERENCE = 0.15
"""Measured: difference between a model's f_al and a run's own, as a fraction, from which the run is not judged: 0.031 at most on
the six of 14 drawn robots (10700, 10712, 10730, 10735, 10740 to 10749) whose ramps show it."""


@dataclass(frozen=True)
class FoundScale:
    """Scale of the axes that move, and where its f_al comes from.

    Attributes:
        scale: The scale; None if no f_al is known.
        source: `model`, or `own` for the run's own vibration; None without a scale, or where the bench gives the band.
        error_hz: Standard error of an f_al that comes from the run's own vibration.
        words: f_al and where it comes from, as a line; without a scale, why there is none.
        doubt: Reason why nothing may be judged by it, or None.
        remark: Sentence on what else the run shows, or None.
        most_factor: Factor by which a displacement may be larger, by the uncertainty of f_al.
    """

    scale: TipScale | None
    source: str | None = None
    error_hz: float | None = None
    words: str = ""
    doubt: str | None = None
    remark: str | None = None
    most_factor: float = 1.0


class RunJudge:
    """Scales of the runs on a bench."""

    def __init__(self, bench: Bench, identified: Identified | None = None) -> None:
        self.bench, self._identified = bench, identified
        self._own: dict[int, Ringing] = {}
        self._why: dict[int, str] = {}

    def look(self, recording: Recording, axis: int) -> None:
        """Look for the resonance of an axis in a ramp without a treatment."""
        try:
            self._own[axis] = own_ringing(recording, axis)
        except NoResonanceError as error:
            self._own.pop(axis, None)
            self._why[axis] = str(error)

    def rates(self, axis: int) -> Complex:
        """Closed-loop rates of an axis that its loop holds at standstill.

        Raises:
            NotPossibleError: The plant or the gains of the axis are not known.
        """
        return rates_of(self.bench, axis, self._identified)

    def found(self, axis: int | None) -> FoundScale:
        """Scale of a ramp of one axis, or of the line motion."""
        return self._line() if axis is None else self._axis(axis)

    def _axis(self, axis: int) -> FoundScale:
        known, own = axis_scale(self.bench, axis), self._own.get(axis)
        if known is not None:
            return _compared(known, own, f"axis {axis}")
        if own is None and self.bench.specification.band_hz is not None:
            low_hz, high_hz = self.bench.specification.band_hz
            words = f"band {low_hz:g} to {high_hz:g} Hz, from the bench file: the ramp does not show a single clear resonance"
            return FoundScale(ramp_scale((low_hz, high_hz)), words=words)
        if own is None:
            why = self._why.get(axis)
            rest = "" if why is None else f". The ramp by itself does not show f_al: {why}"
            return FoundScale(None, words=missing_words([axis]) + rest)
        factor = (own.peak_hz / (own.peak_hz - 2.0 * own.standard_error_hz)) ** 2
        return FoundScale(
            scale_at(self.bench, axis, own.peak_hz), "own", own.standard_error_hz, own_words(own), None, None, factor
        )

    def _line(self) -> FoundScale:
        bench = self.bench
        known = line_scale(bench)
        if bench.specification.band_hz is not None:
            low_hz, high_hz = bench.specification.band_hz
            return FoundScale(known, words=f"band {low_hz:g} to {high_hz:g} Hz, from the bench file")
        if known is not None:
            return FoundScale(known, "model", words=f"f_al {known.f_al_hz:.2f} Hz, from the model")
        own = {axis: self._own[axis] for axis in bench.chain_axes if axis in self._own}
        if not own:
            return FoundScale(None, words=missing_words(bench.chain_axes))
        scale = joint_scale([scale_at(bench, axis, each.peak_hz) for axis, each in own.items()])
        lowest = min(own.values(), key=lambda each: each.peak_hz)
        factor = (lowest.peak_hz / (lowest.peak_hz - 2.0 * lowest.standard_error_hz)) ** 2
        axes = " and ".join(f"axis {axis}" for axis in own)
        words = f"f_al {lowest.peak_hz:.2f} ± {lowest.standard_error_hz:.2f} Hz, from the ramps of {axes}"
        return FoundScale(scale, "own", lowest.standard_error_hz, words, None, None, factor)


def _compared(known: TipScale, own: Ringing | None, who: str) -> FoundScale:
    """Compare the scale of a model with the resonance of the ramp."""
    words = f"f_al {known.f_al_hz:.2f} Hz, from the model"
    if own is None:
        return FoundScale(known, "model", words=words)
    difference = own.peak_hz - known.f_al_hz
    least = max(FAR_SIGMAS * own.standard_error_hz, LEAST_SPREAD * known.f_al_hz)
    if abs(difference) <= least:
        return FoundScale(known, "model", words=words)
    remark = f"{who}: the model says f_al = {known.f_al_hz:.2f} Hz; the ramp itself shows {own_words(own)}"
    doubt = None
    if abs(difference) > MOST_DIFFERENCE * known.f_al_hz:
        doubt = f"{remark}: the model is for another robot, or the robot has changed; repeat hil identify plant"
    return FoundScale(known, "model", None, words, doubt, remark, max(1.0, (known.f_al_hz / own.peak_hz) ** 2))


def own_words(own: Ringing) -> str:
    """Describe a ramp's own resonance with standard error and orders."""
    orders = " and ".join(f"{order:g}" for order in own.orders)
    many = "order" if len(own.orders) == 1 else "orders"
    return f"f_al {own.peak_hz:.2f} ± {own.standard_error_hz:.2f} Hz, from the run's own {many} {orders}"


def own_ringing(recording: Recording, axis: int) -> Ringing:
    """Find the resonance that a ramp itself shows.

    Raises:
        NoResonanceError: It shows none that is clearly the arm's.
    """
    ramp = Ramp(
        recording.axis(axis, "position_rad"), recording.axis(axis, "reference_rad"), recording.felt_m_s2,
        recording.axis(axis, "torque_nm"), recording.period_s,
    )  # fmt: skip
    return ringing(ramp, ORDERS)


def shown_rps(bench: Bench) -> float:
    """Motor speed up to which the bench's ramps show the arm."""
    ramp = bench.constant_acceleration
    return math.inf if ramp is None else last_rps(ramp.end_rps, ramp.acceleration_rps_s)


def unreached(bench: Bench, axis: int, scale: TipScale) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Describe the orders that meet f_al beyond the ramp's end.

    Returns the orders within the axis' limits, and those beyond them.

    What the limits allow is reckoned for a ramp from the middle of the travel, at the bench's accelerations.
    """
    ramp, limits = bench.constant_acceleration, bench.axis[axis].limits
    if ramp is None:
        return (), ()
    room_rev = 0.5 * (limits.position_max_rev - limits.position_min_rev)
    most_rps = min(limits.speed_rps, reach_rps(room_rev, ramp.acceleration_rps_s, ramp.deceleration_rps_s))
    within, beyond = [], []
    for order in scale.windows_rps:
        resonant_rps = scale.f_al_hz / order
        if shown_rps(bench) >= resonant_rps:
            continue
        if ramp.end_rps > resonant_rps:
            within.append(
                f"axis {axis}: order {order:g} is not judged: the ramp meets f_al = {scale.f_al_hz:.2f} Hz at "
                f"{resonant_rps:.2f} rev/s, less than {1e3 * BRAKING_S:g} ms before it brakes; in "
                f"[constant_acceleration] lower acceleration_rps_s, {ramp.acceleration_rps_s:g} rev/s², or raise "
                f"end_rps, {ramp.end_rps:g} rev/s"
            )
            continue
        text = (
            f"axis {axis}: order {order:g} is not judged: it meets f_al = {scale.f_al_hz:.2f} Hz at {resonant_rps:.2f} rev/s, "
            f"but the ramp ends at {ramp.end_rps:g} rev/s. From the middle of the travel the limits allow"
        )
        last = last_rps(most_rps, ramp.acceleration_rps_s)
        if last >= resonant_rps:
            within.append(f"{text} {most_rps:.3g} rev/s; raise end_rps in [constant_acceleration]")
        else:
            beyond.append(f"{text} no more than {most_rps:.3g} rev/s ({last:.3g} rev/s {1e3 * BRAKING_S:g} ms before braking)")
    return tuple(within), tuple(beyond)


def peak_hz(bench: Bench, axis: int, control_period_s: float = CONTROL_PERIOD_S) -> float | None:
    """Frequency f_al of an axis in Hz; None without a model."""
    loop = bench.axis[axis].loop(control_period_s, with_notch=False)
    return None if loop is None else loop.peak_hz()


def scale_at(bench: Bench, axis: int, f_al_hz: float) -> TipScale:
    """Scale of an axis with a known f_al."""
    paper = TABLE_1.get(axis) if bench.is_paper else None
    if paper is not None and abs(f_al_hz - paper[0]) <= LEAST_SPREAD * paper[0]:
        return paper_scale(f_al_hz)
    return tip_scale(f_al_hz)


def axis_scale(bench: Bench, axis: int, control_period_s: float = CONTROL_PERIOD_S) -> TipScale | None:
    """Scale of an axis; None without a model."""
    f_al_hz = peak_hz(bench, axis, control_period_s)
    return None if f_al_hz is None else scale_at(bench, axis, f_al_hz)


def line_scale(bench: Bench, control_period_s: float = CONTROL_PERIOD_S) -> TipScale | None:
    """Scale of the line motion, or None if nothing is known."""
    if bench.specification.band_hz is not None:
        return band_scale(bench.specification.band_hz)
    scales = {axis: axis_scale(bench, axis, control_period_s) for axis in bench.chain_axes}
    known = {axis: scale for axis, scale in scales.items() if scale is not None}
    if bench.is_paper and PAPER_LINE_AXIS in known:
        return known[PAPER_LINE_AXIS]
    return joint_scale(list(known.values())) if known else None


def motion_scale(bench: Bench, axis: int | None) -> TipScale | None:
    """Scale of a motion: of one axis, or of the line; None if nothing is known."""
    return line_scale(bench) if axis is None else axis_scale(bench, axis)


def missing_words(axes: Iterable[int]) -> str:
    """Sentence on why a run is not judged that has no f_al."""
    numbers = [str(axis) for axis in axes]
    who = f"axis {numbers[0]} has" if len(numbers) == 1 else f"none of the axes {', '.join(numbers)} has"
    return (
        f"{who} {'no' if len(numbers) == 1 else 'a'} model, so f_al is not known, and accelerations cannot be converted to mm. "
        f"Run hil "
        "identify plant --model model.toml, then repeat with --model model.toml, or give the model in the bench file"
    )


def check_shown(what: str, period_s: float, scale: TipScale) -> None:
    """Refuse a SYNC period whose samples do not show the band of a scale.

    Raises:
        NotPossibleError: The period is too long.
    """
    try:
        shown_band(period_s, scale.band_hz)
    except ValueError as error:
        words = f"{what} at a SYNC period of {1e3 * period_s:g} ms: {error}: shorten sync_period_s in the bench file"
        raise NotPossibleError(words, ("cycle",)) from error


def check_axis_shown(what: str, bench: Bench, axis: int, identified: Identified | None) -> None:
    """Refuse a SYNC period whose samples do not show the vibration of an axis.

    Its band is that of f_al, from the identified plant or the bench file's model; without either nothing is refused.

    Raises:
        NotPossibleError: The period is too long.
    """
    scale = axis_scale(with_identified(bench, identified), axis)
    if scale is not None:
        check_shown(what, bench.bus.sync_period_s, scale)


def vibration_scale(bench: Bench, axes: Iterable[int], identified: Identified | None = None) -> TipScale:
    """Scale for vibrations that are only compared with each other.

    Args:
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
