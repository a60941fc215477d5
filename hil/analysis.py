"""Metrics of a recording, and the scale of their verdict.

An arm rings at f_al, the peak of |G_al|. So every speed, band and displacement follows from the f_al of the axis that moved, and
there is no verdict without it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.recording import Recording
from hil.robot_tables import ORDERS

SPEED_LOWPASS_HZ = 20.0
"""Corner of the low-pass, forward and backward, that makes a speed from the sampled motor angle."""

WINDOW_FACTORS = (0.76, 1.27)
"""Motor speeds in which order k is judged, in units of f_al/k."""
BAND_FACTORS = (0.5, 2.1)
"""Band of the tip vibration in units of f_al: the resonance with its skirts, without the motion itself."""
PEAK_BAND_FACTORS = (0.68, 1.35)
"""Band in which the largest line of the spectrum is looked for, in units of f_al."""

PAPER_WINDOWS_RPS: dict[float, tuple[float, float]] = {2: (4.5, 7.5), 4: (2.2, 3.6)}
PAPER_BAND_HZ = (6.0, 25.0)
PAPER_PEAK_BAND_HZ = (8.0, 16.0)
"""The same for both axes of the paper's robot, with an f_al near 12 Hz."""

LINE_BEGIN_S, LINE_BEGIN_FRACTION = 0.5, 0.25
LINE_END_S, LINE_END_FRACTION = 0.2, 0.1
"""Parts at the beginning and at the end of a line motion in which its tip displacement is not judged; the shorter counts."""
LINE_BAND_HZ = (0.0, 50.0)

NOISE_MARGIN = 1.5
"""A vibration up to so many times what noise alone would show is not told apart from it."""

BRAKING_S = 0.12
"""Time before the top of a ramp in which a filter without phase shows the jerk of the braking already."""
LAST_S = 0.18
"""Time before the end of a ramp's set-points, by the same and by how far the motor is behind them."""


@dataclass(frozen=True)
class TipScale:
    """Scale by which the vibration of the tip is judged.

    Attributes:
        f_al_hz: Peak of |G_al|, by which an acceleration becomes a displacement.
        peak_band_hz: Band in which the largest line of the spectrum is looked for.
        windows_rps: Motor speeds in which a ramp is judged, by the order k that meets f_al there.
    """

    f_al_hz: float
    band_hz: tuple[float, float]
    peak_band_hz: tuple[float, float]
    windows_rps: Mapping[float, tuple[float, float]] = field(default_factory=dict)

    def orders_met(self, last_rps: float) -> tuple[float, ...]:
        """Orders that meet f_al up to a speed; if none does, the highest order, which comes nearest."""
        met = tuple(order for order in self.windows_rps if last_rps >= self.f_al_hz / order)
        return met or (max(self.windows_rps),)


def tip_scale(f_al_hz: float) -> TipScale:
    """Return the scale of an axis from its f_al."""
    windows: dict[float, tuple[float, float]] = {order: order_window_rps(f_al_hz, order) for order in ORDERS}
    return TipScale(f_al_hz, _times(f_al_hz, BAND_FACTORS), _times(f_al_hz, PEAK_BAND_FACTORS), windows)


def order_window_rps(f_al_hz: float, order: float) -> tuple[float, float]:
    """Motor speeds in which an order is judged."""
    return _times(f_al_hz / order, WINDOW_FACTORS)


def last_rps(end_rps: float, acceleration_rps_s: float) -> float:
    """Return the motor speed up to which a ramp is judged.

    The motor lags behind its set-points, and braking begins earlier.
    """
    return end_rps - LAST_S * acceleration_rps_s


def judged_orders(scale: TipScale | None, last_rps: float) -> tuple[int, ...]:
    """Return the orders in whose windows a ramp is judged.

    The scale is None if no f_al is known; the ramp shows the arm up to `last_rps`.
    """
    if scale is None:
        return ORDERS[1:]
    met = scale.orders_met(last_rps)
    return tuple(order for order in ORDERS if order in met)


def paper_scale(f_al_hz: float) -> TipScale:
    """Return the scale of an axis of the paper's robot."""
    return TipScale(f_al_hz, PAPER_BAND_HZ, PAPER_PEAK_BAND_HZ, PAPER_WINDOWS_RPS)


def joint_scale(scales: Sequence[TipScale]) -> TipScale:
    """Return the scale of a motion of several axes.

    Its bands cover those of all axes. Its f_al is the lowest, so that no displacement is too small.

    Raises:
        ValueError: There is no scale.
    """
    if not scales:
        raise ValueError("there is no scale of an axis; expected at least 1")
    band, peak_band = (
        (min(low for low, _ in bands), max(high for _, high in bands))
        for bands in ([scale.band_hz for scale in scales], [scale.peak_band_hz for scale in scales])
    )
    return TipScale(min(scale.f_al_hz for scale in scales), band, peak_band)


def band_scale(band_hz: tuple[float, float]) -> TipScale:
    """Return the scale of an arm's line with a given band.

    Its f_al, for quantities in units of it, follows from the middle of the band.
    """
    f_al_hz = math.sqrt(band_hz[0] * band_hz[1] / (BAND_FACTORS[0] * BAND_FACTORS[1]))
    return TipScale(f_al_hz, band_hz, band_hz)


def ramp_scale(band_hz: tuple[float, float]) -> TipScale:
    """Return the scale of an arm's ramp with a given band."""
    windows: dict[float, tuple[float, float]] = {order: (band_hz[0] / order, band_hz[1] / order) for order in ORDERS}
    return replace(band_scale(band_hz), windows_rps=windows)


def _times(value: float, factors: tuple[float, float]) -> tuple[float, float]:
    return value * factors[0], value * factors[1]


def line_window_s(duration_s: float) -> tuple[float, float]:
    """Return begin and end of the judged part of a line.

    In s after its start: 0.5 to 2.0 s of 2.2 s.
    """
    begin_s = min(LINE_BEGIN_S, LINE_BEGIN_FRACTION * duration_s)
    return begin_s, duration_s - min(LINE_END_S, LINE_END_FRACTION * duration_s)


def motor_speed_rps(recording: Recording, axis: int) -> Real:
    """Compute the motor speed f_m in rev/s; shape (n,)."""
    return speed_of(recording.axis(axis, "position_rad") / (2.0 * math.pi), recording.period_s)


def speed_of(revolutions: Real, period_s: float) -> Real:
    """Compute the speed of a sampled angle, low-passed without phase, in rev/s; shape (n,)."""
    return without_phase(np.gradient(revolutions, period_s), period_s, "lowpass", min(SPEED_LOWPASS_HZ, 0.2 / period_s))


Kind = Literal["lowpass", "highpass", "bandpass"]
"""Kind of a filter."""


def without_phase(values: Real, period_s: float, kind: Kind, *corners_hz: float) -> Real:
    """Filter by a 2nd-order Butterworth, forward and backward; shape (…, n).

    As `scipy.signal.sosfiltfilt`, which computes the filter's state at rest anew for each signal: a third of its time.

    Args:
        values: Signals; shape (…, n).
        corners_hz: Corner, or both of a bandpass.

    Raises:
        ValueError: There are too few samples.
    """
    sections, at_rest = _butterworth(period_s, kind, *corners_hz)
    edge, count = 3 * (2 * len(sections) + 1), values.shape[-1]
    if count <= edge:
        raise ValueError(f"{count} samples are too few for a {kind} without phase; at least {edge + 1} are needed")
    before = 2.0 * values[..., :1] - values[..., edge:0:-1]
    after = 2.0 * values[..., -1:] - values[..., -2 : -edge - 2 : -1]
    longer = np.concatenate([before, values, after], axis=-1)
    at_rest = at_rest.reshape(len(sections), *(1,) * (values.ndim - 1), 2)
    there, _ = scipy.signal.sosfilt(sections, longer, zi=at_rest * longer[..., :1])
    back, _ = scipy.signal.sosfilt(sections, there[..., ::-1], zi=at_rest * there[..., -1:])
    return np.asarray(back[..., ::-1][..., edge:-edge])


@lru_cache(maxsize=32)
def _butterworth(period_s: float, kind: Kind, *corners_hz: float) -> tuple[Real, Real]:
    """Return the sections of a filter, and their state at rest.

    They are cached: a search for a filter needs the same ones a thousand times.
    """
    sections = scipy.signal.butter(2, np.squeeze(corners_hz), kind, fs=1.0 / period_s, output="sos")
    return sections, scipy.signal.sosfilt_zi(sections)


SHOWN_FRACTION = 0.45
"""Highest frequency of a band that samples do not show whole, times their period: a filter needs some room below a half."""
LEAST_SHOWN = 0.7
"""Fraction of a band's end up to which samples must show it: of 2.1 f_al, 1.5 f_al."""


def shown_band(period_s: float, band_hz: tuple[float, float]) -> tuple[float, float]:
    """Return the part of a band that the sampling rate allows.

    All of it, or up to 0.45 of the rate if little is missing.

    Raises:
        ValueError: The sampling period is too long for the band.
    """
    low_hz, high_hz = band_hz
    if 0.5 / period_s > high_hz:
        return band_hz
    if SHOWN_FRACTION / period_s < LEAST_SHOWN * high_hz:
        raise ValueError(
            f"samples every {1e3 * period_s:g} ms show vibrations up to {SHOWN_FRACTION / period_s:.3g} Hz only; "
            f"{LEAST_SHOWN * high_hz:.3g} Hz need a sample at least every {1e3 * SHOWN_FRACTION / (LEAST_SHOWN * high_hz):.3g} ms"
        )
    return low_hz, SHOWN_FRACTION / period_s


def band_passed(acceleration_m_s2: Real, period_s: float, band_hz: tuple[float, float]) -> Real:
    """Band-pass a vertical acceleration; shape (…, n).

    2nd-order Butterworth, forward and backward, as far as the sampling rate allows.

    Raises:
        ValueError: The sampling period is too long for the band.
    """
    return without_phase(acceleration_m_s2, period_s, "bandpass", *shown_band(period_s, band_hz))


def integrated_twice(acceleration_m_s2: Real, period_s: float, lowest_hz: float) -> Real:
    """Integrate a vibration twice to a displacement in m.

    Without frequencies far below the band; shape of `acceleration_m_s2`. The acceleration has the shape (n,); nothing below
    half of `lowest_hz`, the lower end of its band, is left.
    """
    length = 1 << (2 * len(acceleration_m_s2) - 1).bit_length()
    omega = 2.0 * math.pi * np.fft.rfftfreq(length, period_s)
    inverse = np.where(omega > math.pi * lowest_hz, -1.0 / np.maximum(omega, 1e-9) ** 2, 0.0)
    return np.asarray(np.fft.irfft(np.fft.rfft(acceleration_m_s2, length) * inverse, length)[: len(acceleration_m_s2)])


def tip_displacement_mm(acceleration_m_s2: Real, period_s: float, scale: TipScale) -> Real:
    """The paper's equivalent displacement of the tip, in mm.

    The vertical acceleration in the band of the vibration (2nd-order Butterworth, forward and backward), over (2π f_al)². The
    vertical tip acceleration has the shape (…, n); the scale is that of the axis that moved.
    """
    return np.asarray(1e3 * band_passed(acceleration_m_s2, period_s, scale.band_hz) / (2.0 * math.pi * scale.f_al_hz) ** 2)


def speed_window(recording: Recording, axis: int, window_rps: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the rows of a ramp with f_m in a window.

    Shape (n,). Only the rising part of a constant-acceleration run counts. If the ramp ends within the window, the rows end
    before its braking.
    """
    return rising_within(np.abs(motor_speed_rps(recording, axis)), recording.period_s, window_rps)


def rising_within(speed_rps: Real, period_s: float, window_rps: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the rows of a ramp with its speed in a window; see `speed_window`."""
    low, high = window_rps
    top = int(np.argmax(speed_rps))
    end = top if speed_rps[top] >= high else top - round(BRAKING_S / period_s)
    return np.asarray((speed_rps >= low) & (speed_rps <= high) & (np.arange(len(speed_rps)) < end))


def ramp_rows(recording: Recording, axis: int) -> NDArray[np.bool_]:
    """Return the rows of a rising ramp without its ends; shape (n,)."""
    speed, edge = np.abs(motor_speed_rps(recording, axis)), round(BRAKING_S / recording.period_s)
    top = int(np.argmax(speed))
    standing = np.flatnonzero(speed[: top + 1] < 0.01 * speed[top])
    rows = np.arange(len(speed))
    return np.asarray((rows >= (standing[-1] if len(standing) else 0) + edge) & (rows < top - edge))


def amplitude_spectrum(values: Real, period_s: float, window: str) -> tuple[Real, Real]:
    """Return frequencies in Hz and one-sided amplitudes, shapes (m,).

    A sine of amplitude 1 has 1 with either window.
    """
    weights = scipy.signal.get_window(window, len(values))
    amplitude = np.asarray(2.0 * np.abs(np.fft.rfft(values * weights)) / float(np.sum(weights)), dtype=np.float64)
    amplitude[0] *= 0.5
    if len(values) % 2 == 0:
        amplitude[-1] *= 0.5  # Nyquist's line, like the mean, has no mirror image
    return np.asarray(np.fft.rfftfreq(len(values), period_s), dtype=np.float64), amplitude


def area(frequency_hz: Real, amplitude: Real, band_hz: tuple[float, float]) -> float:
    """Trapezoid area of a spectrum over a band, in amplitude times Hz."""
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])
    return float(np.trapezoid(amplitude[inside], frequency_hz[inside]))


Direction = Literal["x", "y", "z", "worst"]
DIRECTIONS: tuple[Direction, ...] = ("x", "y", "z", "worst")


@dataclass(frozen=True)
class DirectionMetrics:
    """The tip's vibration along one direction of the base frame.

    Attributes:
        unit: The direction, of length 1: the worst is that of the largest displacement; None if no f_al is known.
        tip_peak_mm: Largest |displacement|; None if no f_al is known.
        tip_rms_mm: Root mean square of the displacement; of the worst that of the whole vector: no direction has more.
        spectrum_peak_m_s2: Largest amplitude of the spectrum near f_al; of the worst that of the whole vector.
        spectrum_area: Area of the amplitude spectrum from 0.2 f_al to 50 Hz, m/s²·Hz; of the worst that of the whole vector.
    """

    unit: tuple[float, float, float] | None
    tip_peak_mm: float | None
    tip_rms_mm: float | None
    spectrum_peak_m_s2: float | None
    spectrum_peak_hz: float | None
    spectrum_area: float


@dataclass(frozen=True)
class Metrics:
    """Metrics of a run; None for those that need an unknown f_al.

    Attributes:
        tip_peak_mm: Largest |tip displacement| in the window.
        spectrum_peak_m_s2: Largest amplitude near f_al of the Hann spectrum of the window, or of the spectrum of the line motion.
        spectrum_area: Trapezoid area of the amplitude spectrum in m/s²·Hz: the Hann spectrum of the window in the band of the
            vibration (single axis), or the rectangular spectrum of the whole motion from 0 to 50 Hz (line motion).
        ramp_peak_mm: Largest |tip displacement| on the whole ramp, without the jerks at its ends; None for the line motion.
        order_mm: Largest amplitude of the order itself in the window, as a displacement; None if it cannot be tracked there.
        noise_mm: Largest tip displacement that noise alone would show in the window.
        directions: The tip as a vector, on a bench with an arm: the numbers above are then those of the worst direction.
    """

    tip_peak_mm: float | None
    tip_rms_mm: float | None
    spectrum_peak_m_s2: float | None
    spectrum_peak_hz: float | None
    spectrum_area: float
    ramp_peak_mm: float | None = None
    order_mm: float | None = None
    order_error_mm: float | None = None
    noise_mm: float | None = None
    directions: Mapping[Direction, DirectionMetrics] | None = None

    @property
    def is_noise(self) -> bool:
        """True if the tip's peak does not exceed the noise."""
        return is_noise(self.tip_peak_mm, self.noise_mm)


def is_noise(tip_peak_mm: float | None, noise_mm: float | None) -> bool:
    """True if a tip's peak does not exceed that of noise alone."""
    return tip_peak_mm is not None and noise_mm is not None and tip_peak_mm <= NOISE_MARGIN * noise_mm


def constant_acceleration_metrics(recording: Recording, axis: int, order: int, scale: TipScale) -> Metrics:
    """Metrics of a constant-acceleration run in the window of one order.

    Raises:
        ValueError: The run does not pass through the window.
    """
    low, high = scale.windows_rps[order]
    inside = speed_window(recording, axis, (low, high))
    samples = np.count_nonzero(inside)
    if samples < 16:
        raise ValueError(f"the run has {samples} samples between {low:.3g} and {high:.3g} rev/s; at least 16 are needed")
    top_rps, resonant_rps = float(np.max(np.abs(motor_speed_rps(recording, axis))[inside])), scale.f_al_hz / order
    if top_rps < resonant_rps:
        raise ValueError(
            f"the motor lags its set-points and reaches {top_rps:.2f} rev/s before the ramp brakes; order {order} meets "
            f"f_al = {scale.f_al_hz:.2f} Hz at {resonant_rps:.2f} rev/s; raise end_rps of constant_acceleration by "
            f"{math.ceil(10.0 * (resonant_rps - top_rps)) / 10.0:.1f} rev/s or more"
        )
    acceleration, period = recording.felt_m_s2, recording.period_s
    displacement = tip_displacement_mm(acceleration, period, scale)
    frequency, amplitude = amplitude_spectrum(acceleration[inside], period, "hann")
    peak, peak_hz = peak_of(frequency, amplitude, scale.peak_band_hz)
    whole = ramp_rows(recording, axis) | inside
    return Metrics(
        _largest(displacement[inside]), _rms(displacement[inside]), peak, peak_hz, area(frequency, amplitude, scale.band_hz),
        _largest(displacement[whole]),
    )  # fmt: skip


def line_motion_metrics(recording: Recording, start_s: float, duration_s: float, scale: TipScale | None) -> Metrics:
    """Compute the metrics of a line motion.

    Without a scale, only the area of its spectrum. The motion starts at `start_s` of the recording; the scale is None if no
    f_al is known.
    """
    acceleration, period, time = recording.felt_m_s2, recording.period_s, recording.time_s
    motion = acceleration[(time >= start_s) & (time <= start_s + duration_s)]
    frequency, amplitude = amplitude_spectrum(motion, period, "boxcar")
    covered = area(frequency, amplitude, LINE_BAND_HZ)
    if scale is None:
        return Metrics(None, None, None, None, covered)
    begin, end = (start_s + each for each in line_window_s(duration_s))
    displacement = tip_displacement_mm(acceleration, period, scale)[(time >= begin) & (time <= end)]
    return Metrics(_largest(displacement), _rms(displacement), *peak_of(frequency, amplitude, scale.peak_band_hz), covered)


def peak_of(frequency: Real, amplitude: Real, band_hz: tuple[float, float]) -> tuple[float, float]:
    """The largest amplitude of a spectrum in a band, and its frequency."""
    inside = np.flatnonzero((frequency >= band_hz[0]) & (frequency <= band_hz[1]))
    if not len(inside):  # a window shorter than a cycle of the resonance: its line that is nearest
        inside = np.array([int(np.argmin(np.abs(frequency - math.sqrt(band_hz[0] * band_hz[1]))))])
    top = inside[int(np.argmax(amplitude[inside]))]
    return float(amplitude[top]), float(frequency[top])


def _largest(values: Real) -> float:
    return float(np.max(np.abs(values)))


def _rms(values: Real) -> float:
    return float(np.sqrt(np.mean(values**2)))
