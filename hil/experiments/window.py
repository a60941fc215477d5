"""One window of a run: its metrics and the verdict on it, or the reason why there is none."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.analysis import (
    BRAKING_S,
    Metrics,
    TipScale,
    constant_acceleration_metrics,
    line_motion_metrics,
    motor_speed_rps,
)
from hil.bench.bench import Bench
from hil.design.order_map import order_track
from hil.experiments.judge import FoundScale
from hil.master.motion import RunResult
from hil.recording import Recording

Real = NDArray[np.float64]

MAX_SENSOR_MISSED = 0.005
"""Fraction of a motion's cycles that may lack the accelerometer; beyond it the run is not judged."""
AT_RANGE = 0.998
"""Fraction of its range from which a sensor counts as saturated: a step of its resolution below."""
NOISE_PEAK = 2.5
"""Largest value of a band's noise in a window, in units of its root mean square: that of a dozen independent samples."""
MAX_LATE = 0.005
"""Fraction of a motion's cycles on the wall clock that may be dropped or lack an answer; beyond it the run is not judged."""


@dataclass(frozen=True)
class JudgedWindow:
    """One window of a run.

    Attributes:
        metrics: Its metrics; None where there are none.
        is_within: True within the specification; None where it was not judged.
        invalid: Reason why it was not judged.
    """

    metrics: Metrics | None = None
    is_within: bool | None = None
    invalid: str | None = None


def judged_window(bench: Bench, axis: int | None, result: RunResult, order: int | None, found: FoundScale) -> JudgedWindow:
    """Metrics and verdict of one window; a window that cannot be judged has the reason, and is never within the limits.

    Args:
        bench: The bench file.
        axis: Axis of a ramp, None for the line motion.
        result: Result of the run.
        order: Order of the window, None for the line motion.
        found: Scale of the axes that moved.
    """
    if result.stopped is not None:
        return JudgedWindow()
    try:
        _check_cycles(result)
        check_range(bench, result.recording)
        metrics = _metrics(bench, axis, result.recording, order, found)
    except ValueError as error:
        return JudgedWindow(invalid=str(error))
    if metrics.tip_peak_mm is None:
        return JudgedWindow(metrics, invalid=found.words)
    if found.doubt is not None:
        return JudgedWindow(metrics, invalid=found.doubt)
    return _verdict(metrics, metrics.tip_peak_mm, bench.specification.tip_mm, found)


def _verdict(metrics: Metrics, peak_mm: float, limit_mm: float, found: FoundScale) -> JudgedWindow:
    """The verdict, unless it would hang on the error of f_al or on the sensor's noise."""
    if peak_mm <= limit_mm < peak_mm * found.most_factor:
        reason = (
            f"the tip's peak of {peak_mm:.4f} mm keeps ±{limit_mm:g} mm, but as {found.remark or found.words} it may be up to "
            f"{peak_mm * found.most_factor:.4f} mm"
        )
        return JudgedWindow(metrics, invalid=reason)
    if peak_mm > limit_mm and metrics.is_noise:
        reason = (
            f"the tip's peak of {peak_mm:.4f} mm is not told apart from the sensor's noise, which alone shows up to "
            f"{metrics.noise_mm:.4f} mm: --repeat runs it several times and judges the mean"
        )
        return JudgedWindow(metrics, invalid=reason)
    return JudgedWindow(metrics, is_within=bool(peak_mm <= limit_mm))


def _check_cycles(result: RunResult) -> None:
    """Refuse a run that lacks too many answers.

    Raises:
        ValueError: It does; the message has the numbers.
    """
    if result.timing is not None and result.dropped_cycles + result.missed_cycles > MAX_LATE * result.cycles:
        raise ValueError(
            f"of {result.cycles} cycles {result.dropped_cycles} were not sent in time and {result.missed_cycles} "
            f"lack an answer, more than {100.0 * MAX_LATE:g} %; docs/realtime.md"
        )
    if result.sensor_missed > MAX_SENSOR_MISSED * result.cycles:
        raise ValueError(f"the accelerometer was missing in {result.sensor_missed} of {result.cycles} cycles")


def check_range(bench: Bench, recording: Recording) -> None:
    """Refuse a recording in which the accelerometer was at the end of its range.

    Raises:
        ValueError: The accelerometer was there; the message has the number of samples.
    """
    limit = bench.accelerometer.range_m_s2
    if limit is None:
        return
    for name in ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2"):
        values = np.abs(recording.columns[name])
        count = int(np.count_nonzero(values >= AT_RANGE * limit))
        if count:
            raise ValueError(
                f"the accelerometer was at the end of its range of {limit:g} m/s² in {count} samples of {name}: "
                "move more slowly, or take one with a wider range"
            )


def _metrics(bench: Bench, axis: int | None, recording: Recording, order: int | None, found: FoundScale) -> Metrics:
    if axis is not None and order is not None:
        if found.scale is None:
            raise ValueError(found.words)
        metrics = constant_acceleration_metrics(recording, axis, order, found.scale)
        return replace(metrics, **_order_and_noise_mm(recording, axis, order, found.scale))
    line = bench.line_motion
    assert line is not None  # noqa: S101 - the motion was made from it
    return line_motion_metrics(recording, line.dwell_s, line.duration_s, found.scale)


def _order_and_noise_mm(recording: Recording, axis: int, order: int, scale: TipScale) -> dict[str, float]:
    """Amplitude of an order where it is largest in its window with its standard error, and the peak of noise alone, in mm.

    No amplitude where the motor makes too few turns in the window for an order to be told from its neighbours.
    """
    tip, to_mm = recording.columns["tip_z_m_s2"], 1e3 / (2.0 * math.pi * scale.f_al_hz) ** 2
    passed = min(1.0, 2.0 * recording.period_s * (scale.band_hz[1] - scale.band_hz[0]))
    found = {"noise_mm": to_mm * NOISE_PEAK * math.sqrt(passed * noise_variance(tip))}
    end = max(0, int(np.argmax(np.abs(motor_speed_rps(recording, axis)))) - round(BRAKING_S / recording.period_s))
    orders = tuple(scale.windows_rps)
    try:
        track = order_track(recording.axis(axis, "position_rad")[:end], tip[:end], recording.period_s, orders)
    except ValueError:
        return found
    (low, high), column = scale.windows_rps[order], orders.index(order)
    is_inside = (track.speed_rps >= low) & (track.speed_rps <= high)
    rows = np.flatnonzero(is_inside & np.isfinite(track.standard_error[:, column]))
    if len(rows):
        at = rows[int(np.argmax(track.amplitude[rows, column]))]
        found["order_mm"] = to_mm * float(track.amplitude[at, column])
        found["order_error_mm"] = to_mm * float(track.standard_error[at, column])
    return found


def noise_variance(values: Real) -> float:
    """Variance of the white noise of a sensor, from the median of its spectrum's upper half, above all that the motor drives.

    Args:
        values: Samples; shape (n,).
    """
    weights = np.hanning(len(values))
    power = np.abs(np.fft.rfft((values - np.mean(values)) * weights)) ** 2 / float(np.sum(weights**2))
    return float(np.median(power[len(power) // 2 :])) / math.log(2.0)
