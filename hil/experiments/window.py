"""Metrics of one window of a run, and the verdict on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.analysis import (
    BRAKING_S,
    Metrics,
    TipScale,
    amplitude_spectrum,
    area,
    constant_acceleration_metrics,
    line_motion_metrics,
    motor_speed_rps,
    peak_of,
    ramp_rows,
    shown_band,
    speed_window,
)
from hil.bench.bench import Bench
from hil.bench.tip import AT_RANGE
from hil.control.arrays import Complex, Real
from hil.design.ate.model import resolution_rad
from hil.design.ate.rest import STILL_ROOM, variance_at_rest
from hil.design.modes.ring_down import RingDown, ring_down
from hil.design.order_map import OrderTrack, order_track
from hil.experiments.judge import FoundScale
from hil.experiments.measurement import MAX_MISSED
from hil.master.motion import RunResult
from hil.recording import SENSED, TIP, Recording
from hil.tip_vector import displacement_mm, noise_rms_mm, steady_window_s, tip_acceleration, vector_metrics

NOISE_PEAK = 2.5
"""Probability: largest value of a band's noise in a window by its root mean square: that of a dozen independent samples."""


@dataclass(frozen=True)
class JudgedWindow:
    """One window of a run.

    Attributes:
        is_within: True within the specification; None if it was not judged.
    """

    metrics: Metrics | None = None
    is_within: bool | None = None
    invalid: str | None = None


def judged_windows(
    bench: Bench, axis: int | None, result: RunResult, orders: Sequence[int | None], found: FoundScale
) -> list[JudgedWindow]:
    """Compute metrics and verdict of each window of a run.

    A window that cannot be judged has the reason, and is never within the limits.

    Args:
        axis: Axis of a ramp, None for the line motion.
        orders: Orders of the windows, None for the line motion.
        found: Scale of the axes that moved.
    """
    ramp = None if axis is None or found.scale is None else _RampTip(result.recording, axis, found.scale)
    return [_judged(bench, axis, result, order, found, ramp) for order in orders]


def _judged(
    bench: Bench, axis: int | None, result: RunResult, order: int | None, found: FoundScale, ramp: "_RampTip | None"
) -> JudgedWindow:
    if result.stopped is not None:
        return JudgedWindow()
    try:
        _check_cycles(bench, result)
        check_range(bench, result.recording)
        metrics = _one_direction(bench, result.recording, order, found, ramp)
        if bench.arm is not None:
            metrics = _with_vector(bench, metrics, result.recording, axis, order, found.scale)
    except ValueError as error:
        return JudgedWindow(invalid=str(error))
    if metrics.tip_peak_mm is None:
        return JudgedWindow(metrics, invalid=found.words)
    if found.doubt is not None:
        return JudgedWindow(metrics, invalid=found.doubt)
    return _verdict(metrics, metrics.tip_peak_mm, bench.specification.tip_mm, found)


@dataclass(frozen=True)
class JudgedStop:
    """Ringing after a stop, and the verdict on it."""

    window: JudgedWindow
    ringing: RingDown | None = None


def judged_stop(bench: Bench, axis: int, result: RunResult, found: FoundScale, rates: Complex) -> JudgedStop:
    """Judge a stop by the ringing of the tip."""
    if result.stopped is not None:
        return JudgedStop(JudgedWindow())
    recording = result.recording
    try:
        _check_cycles(bench, result)
        check_range(bench, recording)
        if found.scale is None:
            raise ValueError(found.words)
        tip = recording.felt_m_s2[stop_row(recording, axis) :]
        ringing = ring_down(tip, recording.period_s, rates)
    except ValueError as error:
        return JudgedStop(JudgedWindow(invalid=str(error)))
    frequency, amplitude = amplitude_spectrum(ringing.wave_m_s2, recording.period_s, "boxcar")
    peak, peak_hz = peak_of(frequency, amplitude, found.scale.peak_band_hz)
    covered = area(frequency, amplitude, shown_band(recording.period_s, found.scale.band_hz))
    metrics = Metrics(
        ringing.largest_mm, ringing.rms_mm, peak, peak_hz, covered, noise_mm=NOISE_PEAK * math.hypot(*ringing.error_mm)
    )
    if found.doubt is not None:
        return JudgedStop(JudgedWindow(metrics, invalid=found.doubt), ringing)
    return JudgedStop(_verdict(metrics, ringing.largest_mm, bench.specification.tip_mm, found), ringing)


def stop_row(recording: Recording, axis: int) -> int:
    """Row of a recording at which an axis has come to rest.

    The drive reaches the last set-point one cycle after it is sent.

    Raises:
        ValueError: They move up to the end, or not at all.
    """
    reference = recording.axis(axis, "reference_rad")
    moving = np.flatnonzero(reference != reference[-1])
    if not len(moving) or moving[-1] + 2 >= len(reference):
        raise ValueError("the set-points do not come to rest, so a stop cannot be judged")
    return int(moving[-1]) + 2


def _verdict(metrics: Metrics, peak_mm: float, limit_mm: float, found: FoundScale) -> JudgedWindow:
    """Judge a peak, unless f_al or noise leaves it open."""
    if peak_mm <= limit_mm < peak_mm * found.most_factor:
        reason = (
            f"the tip's peak of {peak_mm:.4f} mm is within ±{limit_mm:g} mm, but may be up to "
            f"{peak_mm * found.most_factor:.4f} mm, since f_al is uncertain: {found.remark or found.words}"
        )
        return JudgedWindow(metrics, invalid=reason)
    if peak_mm > limit_mm and metrics.is_noise:
        reason = (
            f"the tip's peak of {peak_mm:.4f} mm may be sensor noise, which alone reaches up to "
            f"{metrics.noise_mm:.4f} mm; repeat the run with --repeat, which judges the mean"
        )
        return JudgedWindow(metrics, invalid=reason)
    return JudgedWindow(metrics, is_within=bool(peak_mm <= limit_mm))


def _check_cycles(bench: Bench, result: RunResult) -> None:
    """Refuse a run that lacks too many answers."""
    if result.timing is not None and result.dropped_cycles + result.missed_cycles > MAX_MISSED * result.cycles:
        raise ValueError(
            f"of {result.cycles} cycles {result.dropped_cycles} were not sent in time and {result.missed_cycles} "
            f"lack an answer; at most {100.0 * MAX_MISSED:g} % is allowed; see docs/realtime.md"
        )
    if result.sensor_missed > MAX_MISSED * result.cycles:
        raise ValueError(
            f"the {bench.accelerometer.title} was missing in {result.sensor_missed} of {result.cycles} cycles; at "
            f"most {100.0 * MAX_MISSED:g} % is allowed"
        )


def check_range(bench: Bench, recording: Recording) -> None:
    """Refuse a recording with a saturated or doubtful accelerometer.

    Raises:
        ValueError: It was, or is not; the message has the number of samples, or the reason.
    """
    if recording.doubt is not None:
        raise ValueError(recording.doubt)
    limit = bench.accelerometer.range_m_s2
    if limit is None:
        return
    for name in SENSED if SENSED[0] in recording.columns else TIP:
        values = np.abs(recording.columns[name])
        count = int(np.count_nonzero(values >= AT_RANGE * limit))
        if count:
            raise ValueError(
                f"the accelerometer was at the end of its range of {limit:g} m/s² in {count} samples of {name}; "
                "move more slowly, or take a sensor with a wider range"
            )


def _with_vector(
    bench: Bench, metrics: Metrics, recording: Recording, axis: int | None, order: int | None, scale: TipScale | None
) -> Metrics:
    """Metrics of the tip as a vector."""
    acceleration, period = tip_acceleration(recording), recording.period_s
    judged = moving = np.ones(len(acceleration), dtype=np.bool_)
    line = bench.line_motion
    if axis is not None and order is not None and scale is not None:
        judged = moving = speed_window(recording, axis, scale.windows_rps[order])
    elif line is not None:
        since = recording.time_s - line.dwell_s
        begin, end = steady_window_s(line.duration_s, line.ramp_s)
        judged, moving = (since >= begin) & (since <= end), (since >= 0.0) & (since <= line.duration_s)
    directions = vector_metrics(acceleration, period, judged, moving, "boxcar" if axis is None else "hann", scale)
    worst, ramp_mm, noise_mm = directions["worst"], None, None
    if scale is not None:
        noise_mm = NOISE_PEAK * noise_rms_mm(
            [noise_variance(column, recording) for column in acceleration.T], period, scale.band_hz
        )
        if axis is not None:
            moved = np.linalg.norm(displacement_mm(acceleration, period, scale.band_hz), axis=1)
            ramp_mm = float(np.max(moved[ramp_rows(recording, axis) | judged]))
    return replace(
        metrics, tip_peak_mm=worst.tip_peak_mm, tip_rms_mm=worst.tip_rms_mm, spectrum_peak_m_s2=worst.spectrum_peak_m_s2,
        spectrum_peak_hz=worst.spectrum_peak_hz, spectrum_area=worst.spectrum_area, ramp_peak_mm=ramp_mm, noise_mm=noise_mm,
        directions=directions,
    )  # fmt: skip


def _one_direction(bench: Bench, recording: Recording, order: int | None, found: FoundScale, ramp: "_RampTip | None") -> Metrics:
    if ramp is not None and order is not None:
        metrics = constant_acceleration_metrics(recording, ramp.axis, order, ramp.scale)
        return ramp.with_order(replace(metrics, noise_mm=ramp.noise_mm), order)
    if order is not None:
        raise ValueError(found.words)
    line = bench.line_motion
    assert line is not None  # noqa: S101 - the motion was made from it
    return line_motion_metrics(recording, line.dwell_s, line.duration_s, found.scale)


@dataclass(frozen=True)
class _RampTip:
    """Noise and orders of the tip on a ramp, for all its windows."""

    recording: Recording
    axis: int
    scale: TipScale

    @property
    def _to_mm(self) -> float:
        return 1e3 / (2.0 * math.pi * self.scale.f_al_hz) ** 2

    @cached_property
    def noise_mm(self) -> float:
        """Peak of the noise."""
        passed = min(1.0, 2.0 * self.recording.period_s * (self.scale.band_hz[1] - self.scale.band_hz[0]))
        return self._to_mm * NOISE_PEAK * math.sqrt(passed * noise_variance(self.recording.felt_m_s2, self.recording))

    @cached_property
    def _track(self) -> OrderTrack | None:
        """Amplitudes of all orders while the speed rises; None if the motor makes too few turns to separate them."""
        recording, axis = self.recording, self.axis
        end = max(0, int(np.argmax(np.abs(motor_speed_rps(recording, axis)))) - round(BRAKING_S / recording.period_s))
        angle, tip = recording.axis(axis, "position_rad")[:end], recording.felt_m_s2[:end]
        try:
            return order_track(angle, tip, recording.period_s, tuple(self.scale.windows_rps))
        except ValueError:
            return None

    def with_order(self, metrics: Metrics, order: int) -> Metrics:
        """Add an order's largest amplitude in its window, with its standard error."""
        track = self._track
        if track is None:
            return metrics
        (low, high), column = self.scale.windows_rps[order], tuple(self.scale.windows_rps).index(order)
        is_inside = (track.speed_rps >= low) & (track.speed_rps <= high)
        rows = np.flatnonzero(is_inside & np.isfinite(track.standard_error[:, column]))
        if not len(rows):
            return metrics
        at = rows[int(np.argmax(track.amplitude[rows, column]))]
        size, error = self._to_mm * float(track.amplitude[at, column]), self._to_mm * float(track.standard_error[at, column])
        return replace(metrics, order_mm=size, order_error_mm=error)


def noise_variance(values: Real, recording: Recording) -> float:
    """Variance of a sensor's white noise.

    It comes from the median of the spectrum's upper half. Where the motor excites that too, as at long SYNC periods, it comes
    from the rest before or after the motion, if the sensor shows any noise there: a coarse one may show none.

    Args:
        values: Samples; shape (n,).
        recording: Recording of which they are.
    """
    weights = np.hanning(len(values))
    power = np.abs(np.fft.rfft((values - np.mean(values)) * weights)) ** 2 / float(np.sum(weights**2))
    moving = float(np.median(power[len(power) // 2 :])) / math.log(2.0)
    if not recording.axes:
        return moving
    still = variance_at_rest(values, np.array([motor_speed_rps(recording, axis) for axis in recording.axes]))
    is_shown = still > (0.5 * resolution_rad(values)) ** 2
    return still if is_shown and moving > STILL_ROOM * still else moving
