"""What speaks against a transmission error that has been fitted, each with the number that is wrong and the number needed."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.design.ate_identification import DELAY_S, JointEstimate
from hil.errors import HilError
from hil.master.motion import RunResult

Real = NDArray[np.float64]

MAX_MISSED = 0.005
"""Share of a pass' cycles that may lack an answer, the accelerometer, or a set-point in time."""
LEAST_EXPLAINED = 0.5
"""Share of the vibration that θ_sync must explain: 0.99 on a robot that is what the bench file says, 0.1 on another axis."""
LEAST_SIGMAS = 5.0
"""How many standard errors A_2 or A_4 must be."""
SCALE_TOLERANCE, SCALE_SIGMAS = 0.25, 5.0
"""By how much the motor's own motion may show in the signal other than it should, and by how many standard errors."""
FLAT_STRETCHES, FLAT_STEPS, PILE = 4, 20.0, 4.0
"""How often a signal must stay at its very end, how many of its steps that is off the middle, and how many times as often as at
the values beside (a sine in steps: 2.4), to count as saturated."""


class NotIdentifiedError(HilError):
    """The runs do not give the transmission error."""

    exit_code = 9

    def __init__(
        self, what: str, value: float, needed: float, unit: str = "", remedy: str = "", *, at_most: bool = False
    ) -> None:
        """Keep what, its value, and what it must be."""
        self.what, self.value, self.needed, self.unit, self.remedy = what, value, needed, unit, remedy
        suffix, tail = f" {unit}" if unit else "", f"; {remedy}" if remedy else ""
        bound = f"at most {needed:.4g}{suffix} is allowed" if at_most else f"at least {needed:.4g}{suffix} is needed"
        super().__init__(f"not identified: {what} is {value:.4g}{suffix}, {bound}{tail}")


def check_run(result: RunResult, *, sensorless: bool) -> None:
    """Whether a pass came in whole.

    Raises:
        NotIdentifiedError: Too many cycles lack something.
    """
    allowed = MAX_MISSED * result.cycles
    if not sensorless and result.sensor_missed > allowed:
        what = f"the number of cycles without the accelerometer (of {result.cycles})"
        raise NotIdentifiedError(what, result.sensor_missed, allowed, "", "check it, or use --sensorless", at_most=True)
    if result.missed_cycles + result.dropped_cycles > allowed:
        lost = result.missed_cycles + result.dropped_cycles
        remedy = "see docs/realtime.md"
        raise NotIdentifiedError(
            "the number of cycles without an answer, or with a set-point too late,", lost, allowed, "", remedy, at_most=True
        )


def check_accelerometer(tip: Real) -> None:
    """Whether a tip acceleration is that of a living sensor within its range.

    Raises:
        NotIdentifiedError: It never changes, or comes back to the very same largest value as only a saturated sensor does.
    """
    levels, counts = np.unique(tip, return_counts=True)
    if len(levels) < 8:
        what = f"the number of different values of the accelerometer in {len(tip)} samples"
        raise NotIdentifiedError(
            what, len(levels), 8, "", "is it powered, does it sit on the arm, is its resolution fine enough?"
        )
    step = float(np.min(np.diff(levels)))
    for end, count, beside in ((levels[0], counts[0], counts[1:4]), (levels[-1], counts[-1], counts[-4:-1])):
        at_end = tip == end
        longer = at_end[1:] & at_end[:-1]
        stretches = int(np.count_nonzero(np.diff(longer.astype(np.int8)) == 1) + (1 if longer[0] else 0))
        is_pile = count > PILE * int(beside.max()) and abs(end - float(np.median(tip))) > FLAT_STEPS * step
        if stretches >= FLAT_STRETCHES and is_pile:
            what = f"the number of times that the accelerometer stays at {end:.3g} m/s², the end of its range,"
            remedy = f"a range beyond {abs(end):.3g} m/s² or a faster ramp is needed"
            raise NotIdentifiedError(what, stretches, FLAT_STRETCHES - 1, "", remedy, at_most=True)


def check_estimate(found: JointEstimate, *, sensorless: bool) -> None:
    """Whether a fit is one of this axis, with something in it.

    Raises:
        NotIdentifiedError: It is not.
    """
    signal = "motor torque's" if sensorless else "tip's"
    if found.explained_by_error < LEAST_EXPLAINED:
        what = f"the share of the {signal} vibration that the transmission error explains"
        remedy = "is this the axis that moves the accelerometer, and are its reduction ratio and node right?"
        raise NotIdentifiedError(what, found.explained_by_error, LEAST_EXPLAINED, "", remedy)
    strongest = max(
        amplitude / max(found.amplitude_error_arcsec[order], 1e-30) for order, amplitude in found.error.amplitude_arcsec.items()
    )
    if strongest < LEAST_SIGMAS:
        what = "the largest amplitude over its standard error"
        raise NotIdentifiedError(what, strongest, LEAST_SIGMAS, "", "excite more: more passes, a slower ramp, a better sensor")
    off = abs(found.motion_scale - 1.0)
    if off > max(SCALE_TOLERANCE, SCALE_SIGMAS * found.motion_scale_error):
        known = "J_l/N² of the plant" if sensorless else "tip_lever_m / reduction_ratio of the bench file"
        what = f"the factor by which the motor's own motion shows in the signal other than {known} says, less 1,"
        factor = f"the factor is {found.motion_scale:.3f} ± {found.motion_scale_error:.3f}"
        remedy = f"is this the axis that moved? {factor}; a gear with a soft wind-up shows like this too"
        raise NotIdentifiedError(
            what, off, max(SCALE_TOLERANCE, SCALE_SIGMAS * found.motion_scale_error), "", remedy, at_most=True
        )
    delay = found.arm.delay_s
    if not DELAY_S[0] + 1e-3 < delay < DELAY_S[1] - 1e-3:
        bound = DELAY_S[1] - 1e-3 if delay > 0.0 else -DELAY_S[0] - 1e-3
        what = "the delay between motor angle and accelerometer"
        raise NotIdentifiedError(
            what, 1e3 * abs(delay), 1e3 * bound, "ms", "beyond it φ cannot be told from φ + 180°", at_most=True
        )


def reached_rps(angle_rad: Real, period_s: float, end_row: int, over_s: float = 0.05) -> float:
    """The speed that a motor had at the end of its ramp."""
    back = max(1, round(over_s / period_s))
    return abs(float(angle_rad[end_row] - angle_rad[end_row - back])) / (back * period_s * 2.0 * math.pi)
