"""Checks of a fitted transmission error; each failure names the number that is wrong and the number needed."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.design.ate_identification import DELAY_S, JointEstimate
from hil.errors import HilError
from hil.master.motion import RunResult

Real = NDArray[np.float64]

MAX_MISSED = 0.005
"""Fraction of a pass' cycles that may lack an answer, the accelerometer, or a set-point in time."""
LEAST_EXPLAINED = 0.5
"""Fraction of the vibration that θ_sync must explain: 0.99 on a robot that is what the bench file says, 0.1 on another axis."""
LEAST_SIGMAS = 5.0
"""Least ratio of A_2 or A_4 to its standard error."""
SCALE_TOLERANCE, SCALE_SIGMAS = 0.25, 5.0
"""Allowed deviation from 1 of the factor of the motor's own motion in the signal: absolute, and in standard errors."""
FLAT_STRETCHES, FLAT_STEPS, PILE = 4, 20.0, 4.0
"""Signs of a saturated signal: stretches at its largest value, distance of that value from the median in resolution steps,
and its count over that of the neighbouring values (a sine in steps: 2.4)."""


class AteNotIdentifiedError(HilError):
    """The runs do not identify the transmission error."""

    exit_code = 9

    def __init__(
        self, what: str, value: float, needed: float, unit: str = "", remedy: str = "", *, at_most: bool = False
    ) -> None:
        """Keep the quantity, its value, and the value that it must have.

        Args:
            what: Quantity that is wrong, in words.
            value: Its value.
            needed: Value that it must have.
            unit: Unit of both values.
            remedy: Advice, in words; empty for none.
            at_most: True where `needed` is an upper bound.
        """
        self.what, self.value, self.needed, self.unit, self.remedy, self.at_most = what, value, needed, unit, remedy, at_most
        suffix, tail = f" {unit}" if unit else "", f"; {remedy}" if remedy else ""
        bound = f"at most {needed:.4g}{suffix} is allowed" if at_most else f"at least {needed:.4g}{suffix} is needed"
        super().__init__(f"not identified: {what} is {value:.4g}{suffix}, {bound}{tail}")


def check_run(result: RunResult, *, sensorless: bool) -> None:
    """Check that a pass is complete.

    Raises:
        AteNotIdentifiedError: Too many cycles lack something.
    """
    allowed = MAX_MISSED * result.cycles
    if not sensorless and result.sensor_missed > allowed:
        what = f"the number of cycles without the accelerometer (of {result.cycles})"
        raise AteNotIdentifiedError(what, result.sensor_missed, allowed, "", "check it, or use --sensorless", at_most=True)
    if result.missed_cycles + result.dropped_cycles > allowed:
        lost = result.missed_cycles + result.dropped_cycles
        remedy = "see docs/realtime.md"
        raise AteNotIdentifiedError(
            "the number of cycles without an answer, or with a set-point too late,", lost, allowed, "", remedy, at_most=True
        )


def check_accelerometer(tip: Real) -> None:
    """Check that a tip acceleration, shape (n,), comes from a live sensor within its range.

    Raises:
        AteNotIdentifiedError: It never changes, or comes back to the very same largest value as only a saturated sensor does.
    """
    levels, counts = np.unique(tip, return_counts=True)
    if len(levels) < 8:
        what = f"the number of different values of the accelerometer in {len(tip)} samples"
        raise AteNotIdentifiedError(
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
            raise AteNotIdentifiedError(what, stretches, FLAT_STRETCHES - 1, "", remedy, at_most=True)


def check_estimate(estimate: JointEstimate, *, sensorless: bool) -> None:
    """Check that a fit belongs to this axis and is significant.

    Raises:
        AteNotIdentifiedError: One of the checks fails.
    """
    signal = "motor torque's" if sensorless else "tip's"
    if estimate.explained_by_error < LEAST_EXPLAINED:
        what = f"the fraction of the {signal} vibration that the transmission error explains"
        remedy = "is this the axis that moves the accelerometer, and are its reduction ratio and node right?"
        raise AteNotIdentifiedError(what, estimate.explained_by_error, LEAST_EXPLAINED, "", remedy)
    strongest = max(
        amplitude / max(estimate.amplitude_error_arcsec[order], 1e-30)
        for order, amplitude in estimate.error.amplitude_arcsec.items()
    )
    if strongest < LEAST_SIGMAS:
        what = "the largest amplitude over its standard error"
        raise AteNotIdentifiedError(what, strongest, LEAST_SIGMAS, "", "excite more: more passes, a slower ramp, a better sensor")
    off = abs(estimate.motion_scale - 1.0)
    if off > max(SCALE_TOLERANCE, SCALE_SIGMAS * estimate.motion_scale_error):
        known = "J_l/N² of the plant" if sensorless else "tip_lever_m / reduction_ratio of the bench file"
        what = f"the factor by which the motor's own motion shows in the signal other than {known} says, less 1,"
        factor = f"the factor is {estimate.motion_scale:.3f} ± {estimate.motion_scale_error:.3f}"
        remedy = f"is this the axis that moved? {factor}; a gear with a soft wind-up shows like this too"
        raise AteNotIdentifiedError(
            what, off, max(SCALE_TOLERANCE, SCALE_SIGMAS * estimate.motion_scale_error), "", remedy, at_most=True
        )
    delay = estimate.arm.delay_s
    if not DELAY_S[0] + 1e-3 < delay < DELAY_S[1] - 1e-3:
        bound = DELAY_S[1] - 1e-3 if delay > 0.0 else -DELAY_S[0] - 1e-3
        what = "the delay between motor angle and accelerometer"
        raise AteNotIdentifiedError(
            what, 1e3 * abs(delay), 1e3 * bound, "ms", "beyond it φ cannot be told from φ + 180°", at_most=True
        )


def reached_rps(angle_rad: Real, period_s: float, end_row: int, over_s: float = 0.05) -> float:
    """Motor speed at the end of a ramp, rev/s.

    Args:
        angle_rad: Motor angle, shape (n,).
        period_s: Period of the samples.
        end_row: Last row of the ramp.
        over_s: Time over which the speed is averaged.
    """
    back = max(1, round(over_s / period_s))
    return abs(float(angle_rad[end_row] - angle_rad[end_row - back])) / (back * period_s * 2.0 * math.pi)
