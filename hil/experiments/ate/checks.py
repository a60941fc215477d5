"""Checks of a fitted transmission error."""

import math

import numpy as np

from hil.bench.bench import Limits
from hil.bench.model import SIGNIFICANT_SIGMAS
from hil.control.arrays import Real
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import DELAY_S
from hil.design.estimation import FAR_SIGMAS, SEEN_SIGMAS, SURE_SIGMAS
from hil.design.ringing import LEAST_EXPLAINED
from hil.errors import HilError, RefusalCause
from hil.experiments.ate.motion import Ramps
from hil.experiments.measurement import MAX_MISSED
from hil.master.motion import RunResult

VIBRATES = 0.1
"""Measured with `SCALE_TOLERANCE`, 0.02 at most: unexplained fraction of the vibration from which another order is looked for."""
GAIN_OF_PASSES = 2.0
"""Measured with `SCALE_TOLERANCE`, 7 (median): factor by which further, slower passes lower the errors."""
SCALE_TOLERANCE = 0.25
"""Measured: deviation from 1 of the motion's factor that is a wrong axis, sensor or lever: on the drawn robots 10700 to 10764 it
is 0.8 % (rms, 5 % at most)."""
SCALE_REMARK = 0.08
"""Measured with `SCALE_TOLERANCE`: deviation of that factor that is worth a note."""
FEELS_NOTHING = 0.2
"""Measured with `SCALE_TOLERANCE`: factor below which the accelerometer does not feel the axis."""
HELD_TORQUE_FRACTION, HELD_TRAVEL_FRACTION = 0.9, 0.7
"""Measured with `SCALE_TOLERANCE`, 0.26 at most and 1 on 30 robots: torque by its limit and travel of an arm that is held."""
LEAST_ASKED_REV = 0.2
"""Bound: distance from which it is told whether a motor follows: with K_pp = 25/s it lags a ramp of 4 rev/s² by a quarter of
it."""
FLAT_STRETCHES, FLAT_STEPS, PILE = 4, 20.0, 4.0
"""Bound: signs of a saturated signal: stretches at its largest value, distance of that from the median in resolution steps, and
its count over that of the neighbouring values (a sine in steps: 2.4)."""

MISWIRED: tuple[RefusalCause, ...] = ("wrong axis or wiring",)


class AteNotIdentifiedError(HilError):
    """Error: the runs do not identify the transmission error."""

    exit_code = 9

    def __init__(
        self,
        what: str,
        value: float,
        needed: float,
        unit: str = "",
        remedy: str = "",
        *,
        at_most: bool = False,
        is_of_orders: bool = False,
        causes: tuple[RefusalCause, ...] = (),
    ) -> None:
        self.is_of_orders, self.causes = is_of_orders, causes
        self.what, self.value, self.needed, self.unit, self.remedy, self.at_most = what, value, needed, unit, remedy, at_most
        suffix, tail = f" {unit}" if unit else "", f"; {remedy}" if remedy else ""
        bound = f"at {'most' if at_most else 'least'} {needed:.4g}{suffix}"
        super().__init__(f"not identified: {what}: {value:.4g}{suffix} ({bound}){tail}")


def check_run(result: RunResult, *, sensorless: bool, sensor: str = "accelerometer") -> None:
    """Check that a pass is complete.

    `sensorless` is for a fit of the motor torque.

    Raises:
        AteNotIdentifiedError: Too many cycles lack something.
    """
    allowed = MAX_MISSED * result.cycles
    if not sensorless and result.sensor_missed > allowed:
        what = f"cycles without the {sensor} (of {result.cycles})"
        remedy = "check it, or use --sensorless"
        raise AteNotIdentifiedError(what, result.sensor_missed, allowed, "", remedy, at_most=True, causes=MISWIRED)
    if result.missed_cycles + result.dropped_cycles > allowed:
        what, lost = "cycles without an answer or with a late set-point", result.missed_cycles + result.dropped_cycles
        raise AteNotIdentifiedError(what, lost, allowed, "", "see docs/realtime.md", at_most=True, causes=("cycle",))


def check_accelerometer(tip: Real, sensor: str = "accelerometer") -> None:
    """Check that a tip acceleration comes from a live, unsaturated sensor.

    The acceleration has the shape (n,); `sensor` is the sensor's name in words.

    Raises:
        AteNotIdentifiedError: It never changes, or comes back to the very same largest value as only a saturated sensor does.
    """
    levels, counts = np.unique(tip, return_counts=True)
    if len(levels) < 8:
        what = f"different values of the {sensor} in {len(tip)} samples"
        remedy = "check that it is powered, sits on the arm, and has a fine enough resolution"
        raise AteNotIdentifiedError(what, len(levels), 8, "", remedy, causes=MISWIRED)
    step = float(np.min(np.diff(levels)))
    for end, count, beside in ((levels[0], counts[0], counts[1:4]), (levels[-1], counts[-1], counts[-4:-1])):
        at_end = tip == end
        longer = at_end[1:] & at_end[:-1]
        stretches = int(np.count_nonzero(np.diff(longer.astype(np.int8)) == 1) + (1 if longer[0] else 0))
        is_pile = count > PILE * int(beside.max()) and abs(end - float(np.median(tip))) > FLAT_STEPS * step
        if stretches >= FLAT_STRETCHES and is_pile:
            what = f"times that the {sensor} saturates at {end:.3g} m/s²"
            remedy = f"take a sensor with a range beyond {abs(end):.3g} m/s², or a faster ramp"
            raise AteNotIdentifiedError(what, stretches, FLAT_STRETCHES - 1, "", remedy, at_most=True)


def check_estimate(estimate: JointEstimate, *, sensorless: bool, passes_left: int = 0) -> None:
    """Check that a fit belongs to this axis and is significant.

    `sensorless` is for a fit of the motor torque.

    Raises:
        AteNotIdentifiedError: One of the checks fails.
    """
    if not sensorless:
        check_factor(estimate.motion_scale, estimate.motion_scale_error)
    _check_significance(estimate, sensorless=sensorless, passes_left=passes_left)
    of_vibration = estimate.explained_by_error / max(estimate.explained_by_error + estimate.structured, 1e-30)
    if of_vibration < LEAST_EXPLAINED:
        signal = "motor torque's" if sensorless else "tip's"
        orders = ", ".join(f"{order:g}" for order in estimate.error.amplitude_arcsec)
        what = f"the fraction of the {signal} vibration above the noise that the orders {orders} explain"
        remedy = "look for another order (in the order map of a run), another vibrating axis, or a loose sensor"
        raise AteNotIdentifiedError(
            what, of_vibration, LEAST_EXPLAINED, "", remedy, is_of_orders=True, causes=("another source of vibration",)
        )
    delay = estimate.arm.delay_s
    if not DELAY_S[0] + 1e-3 < delay < DELAY_S[1] - 1e-3:
        bound = DELAY_S[1] - 1e-3 if delay > 0.0 else -DELAY_S[0] - 1e-3
        what = "the delay between motor angle and sensor"
        raise AteNotIdentifiedError(
            what, 1e3 * abs(delay), 1e3 * bound, "ms", "with a longer delay φ looks like φ + 180°", at_most=True
        )


def check_factor(factor: float, error: float) -> None:
    """Refuse a signal that does not fit the motor's own motion.

    It is the factor that the motor's own motion has in the signal, with its standard error.

    Raises:
        AteNotIdentifiedError: It is too far from 1.
    """
    off, allowed = abs(factor - 1.0), max(SCALE_TOLERANCE, SURE_SIGMAS * error)
    if off <= allowed:
        return
    what = "relative deviation of the tip's response to the motor from tip_lever_m / reduction_ratio"
    if factor < -FEELS_NOTHING:
        remedy = "the tip moves against the motor: the encoder counts backwards (607Eh), or the accelerometer sits upside down"
    elif factor < FEELS_NOTHING:
        remedy = (
            "the sensor does not respond to this axis: check that it works and sits on this arm, and that the arm is coupled "
            "and free"
        )
    else:
        remedy = "check that this is the axis that moved, and check its reduction ratio and lever"
    remedy += f"; the factor is {factor:.3f} ± {error:.3f}"
    raise AteNotIdentifiedError(what, off, allowed, "", remedy, at_most=True, causes=MISWIRED)


def _check_significance(estimate: JointEstimate, *, sensorless: bool, passes_left: int) -> None:
    """Refuse an error that further passes would not make significant."""
    errors = estimate.amplitude_error_arcsec
    ratios = {k: amplitude / max(errors[k], 1e-30) for k, amplitude in estimate.error.amplitude_arcsec.items()}
    order = max(ratios, key=lambda k: ratios[k])
    most = max(a + SIGNIFICANT_SIGMAS * errors[k] for k, a in estimate.error.amplitude_arcsec.items())
    hope = GAIN_OF_PASSES if passes_left and not sensorless else 1.0
    if hope * ratios[order] >= SEEN_SIGMAS:
        return
    remedy = f"no A_k is significant, and none is above {most:.2g}″; to see a smaller one, take a slower ramp or a better sensor"
    what = f"the ratio of the largest amplitude, A_{order:g}, to its standard error"
    is_of_orders = estimate.structured > VIBRATES
    raise AteNotIdentifiedError(what, ratios[order], SEEN_SIGMAS, "", remedy, is_of_orders=is_of_orders, causes=("noise",))


def factor_remark(estimate: JointEstimate) -> str | None:
    """Describe a factor of the motor's motion that is doubtful, or None."""
    off = abs(estimate.motion_scale - 1.0)
    if off <= max(SCALE_REMARK, FAR_SIGMAS * estimate.motion_scale_error):
        return None
    return (
        f"the tip follows the motor {estimate.motion_scale:.3f} ± {estimate.motion_scale_error:.3f} times as far "
        "as tip_lever_m / reduction_ratio of the bench file says; A_k is wrong by as much, or the gear is nonlinear; the trial "
        "of the cancellation shows which"
    )


def check_moved(motion: Ramps, result: RunResult, axis: int, limits: Limits) -> None:
    """Check that the motor made its motion.

    Raises:
        AteNotIdentifiedError: The motor did not move, or pressed against something that holds it.
    """
    recording = result.recording
    if not len(recording.time_s):
        return
    angle, wanted = recording.axis(axis, "position_rad"), motion.motion.motor_angle_rad[: len(recording.time_s), 0]
    asked_rev = float(np.ptp(wanted)) / (2.0 * math.pi)
    made_rev = float(np.ptp(angle)) / (2.0 * math.pi)
    if asked_rev < LEAST_ASKED_REV or made_rev >= HELD_TRAVEL_FRACTION * asked_rev:
        return
    torque_nm = float(np.max(np.abs(recording.axis(axis, "torque_nm"))))
    pressed = torque_nm >= HELD_TORQUE_FRACTION * limits.torque_nm
    remedy = (
        f"the motor torque was {torque_nm:.3g} N·m of {limits.torque_nm:g}; check that the brake is open and the arm free"
        if pressed
        else (
            f"its torque was {torque_nm:.3g} N·m; check that the motor is coupled, its encoder counts, and the gains "
            "are those of this axis"
        )
    )
    what = f"the motion of axis {axis}'s motor, with {asked_rev:.2f} rev commanded"
    raise AteNotIdentifiedError(what, made_rev, HELD_TRAVEL_FRACTION * asked_rev, "rev", remedy, causes=MISWIRED)


def reached_rps(angle_rad: Real, period_s: float, end_row: int, over_s: float = 0.05) -> float:
    """Mean motor speed over the last `over_s` of a ramp, rev/s."""
    back = max(1, round(over_s / period_s))
    return abs(float(angle_rad[end_row] - angle_rad[end_row - back])) / (back * period_s * 2.0 * math.pi)
