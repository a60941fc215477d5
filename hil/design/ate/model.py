"""Model of ramps with a transmission error, as a sensor sees them.

The sensor lags the motor angle; see `identification`.

For given ω, ζ and Δ it is linear in A_k cos φ_k and A_k sin φ_k: `SweepModel` and `RampsModel` give its columns.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real
from hil.design.frequency import TwoInertia
from hil.design.transmission_error import AT_ONCE, TransmissionError, acceleration_spectrum, shown_error, shown_waves

Signs = NDArray[np.int8]

GEAR_FRACTION = 0.9
"""Accuracy: ζ_g/ζ unless a plant gives it: most of the damping is the gear's. A tenth more or less is 0.2 ζ/ω in Δ, 0.1 ms."""
DELAY_S = (-0.010, 0.030)
"""Bound: delays that are searched where none is known: half a period more (42 ms at 12 Hz) looks like φ_k + 180°."""
LEAST_SENSOR_NOISE = 0.05
"""Accuracy: fraction of a residual's power that is the sensor's at least: a factor of 2 changes nothing."""
BAND = (0.5, 2.1)
"""Measured: pass band by the arm's frequency, the resonance with its skirts; below lies the motion itself, above lies noise.

On the drawn robots 10712, 10730 and 10735 a factor of 2 in either end changes 1.5 standard errors, and these by 77 %; on the
simulated gear of 10700 an upper end of 3 changes ζ by 3.3 of them, and one of 1.5 by 24."""
RING_DOWN_RAD = 300.0
"""Accuracy: radians of the lowest frequency by which a transform is padded: a factor of 2 changes nothing."""


@dataclass(frozen=True)
class Sweep:
    """Recorded ramps, in one piece that begins and ends at rest.

    The time between the ramps belongs to it: the arm still rings from there when the next ramp begins.

    Attributes:
        motor_angle_rad: θ_m, equally spaced; shape (n,).
        signal: The tip acceleration in m/s², or the motor torque in N·m, sampled with it; shape (n,).
        direction: +1 where the motor speeds up forwards, −1 backwards, 0 for samples that do not count; shape (n,).
        torque_nm: Torque of the motor beside a tip acceleration, which shows the arm's weight; None if it is not known.
        late: Samples of θ_m that were taken late, and are moved back in time.
        late_s: Delay of the one that was off most.
    """

    motor_angle_rad: Real
    signal: Real
    period_s: float
    direction: Signs
    torque_nm: Real | None = None
    late: int = 0
    late_s: float = 0.0


@dataclass(frozen=True)
class Sensing:
    """Kind of signal in the ramps.

    Attributes:
        gain: g: the tip lever in m, or J_l/N in kg·m² for the motor torque.
        motor_inertia_kg_m2: J: 0 for the tip, J_m for the motor torque. Left free it would take A_k 5 % with it, since the
            motor moves as θ_sync makes it; 5 % wrong it changes A_k by 0.3 %.
        delay_from_s: Least delay of the signal behind the motor angle that is searched.
    """

    gain: float
    motor_inertia_kg_m2: float = 0.0
    delay_from_s: float = DELAY_S[0]
    delay_to_s: float = DELAY_S[1]


@dataclass(frozen=True)
class OtherMode:
    """Mode of a coupled arm beside the one that is fitted.

    Attributes:
        resonance_hz: Its frequency, with the motor held.
        part: Part of the tip's rigid motion that it carries.
    """

    resonance_hz: float
    damping: float
    part: float


@dataclass(frozen=True)
class Arm:
    """Arm on its gear, with the sensor's delay.

    Attributes:
        resonance_hz: Resonance ω/2π.
        damping: Damping ratio ζ.
        delay_s: Delay Δ.
        gear_fraction: Fraction ζ_g/ζ of the damping, assumed.
        bend: (f_a/f_s)², for a sensor that resonates at f_s on its mounting; below 0 for one that falls off.
        others: Further modes of a coupled arm; what they do not carry of the tip's rigid motion is this one's, so that all gains
            add up to the lever.
    """

    resonance_hz: float
    damping: float
    delay_s: float = 0.0
    gear_fraction: float = GEAR_FRACTION
    bend: float = 0.0
    others: tuple[OtherMode, ...] = ()

    @classmethod
    def of(cls, plant: TwoInertia) -> "Arm":
        """Arm of a plant, with its part of the damping."""
        damping = plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad
        critical = 2.0 * math.sqrt(plant.gear_stiffness_nm_rad * plant.arm_inertia_kg_m2)
        share = plant.gear_damping_nm_s_rad / damping if damping > 0.0 else 1.0
        return cls(plant.antiresonance_hz, damping / critical, gear_fraction=share)

    def response(self, frequency_hz: Real) -> Complex:
        """H(jω) e^{−jωΔ} of arm and sensor; shape of `frequency_hz`."""
        made = self.in_time(frequency_hz)
        return made * turn(frequency_hz, self.delay_s) if self.delay_s else made

    def in_time(self, frequency_hz: Real) -> Complex:
        """H(jω) of arm and sensor, without the delay; shape of `frequency_hz`."""
        x = np.asarray(frequency_hz) / self.resonance_hz
        made = self._follows(x, self.damping)
        if self.others:
            made = (1.0 - sum(each.part for each in self.others)) * made
            for each in self.others:
                made = made + each.part * self._follows(np.asarray(frequency_hz) / each.resonance_hz, each.damping)
        if self.bend:
            made = made / (1.0 - self.bend * np.minimum(x, BAND[1]) ** 2)
        return made

    def _follows(self, over_resonance: Real, damping: float) -> Complex:
        """Motion of a mode on a moving base, by frequency over its own."""
        x = over_resonance
        made, below = np.empty(np.shape(x), np.complex128), np.empty(np.shape(x), np.complex128)
        made.real, made.imag = 1.0, 2.0 * self.gear_fraction * damping * x
        below.real, below.imag = 1.0 - x**2, 2.0 * damping * x
        made /= below
        return made


def turn(frequency_hz: Real, delay_s: float) -> Complex:
    """Turn e^{−jωΔ} of a delay; shape of `frequency_hz`."""
    return np.asarray(np.exp(-2j * math.pi * frequency_hz * delay_s))


@dataclass(frozen=True)
class Noise:
    """Noise of a signal, from sensor and encoder rounding behind the arm."""

    arm: Arm
    sensor_variance: float

    def seen_with(self, weight: float) -> "Noise":
        """Noise of a recording with a weight, by which residuals become similar."""
        return replace(self, sensor_variance=self.sensor_variance / weight**2)


def _spectra_of_waves(
    sweep: Sweep, reduction_ratio: float, orders: Sequence[float], length: int, inside: slice
) -> tuple[Real, Complex]:
    """All frequencies, and the spectra of θ̈_m/N and of the waves of each order inside a band; shape (1 + 2·orders, m)."""
    angle, period_s, made = sweep.motor_angle_rad, sweep.period_s, []
    for first in range(0, max(1, len(orders)), AT_ONCE):
        waves = shown_waves(angle, period_s, orders[first : first + AT_ONCE])
        given = waves if first else np.vstack([angle / reduction_ratio, waves])
        frequency, spectra = acceleration_spectrum(given, period_s, length)
        made.append(spectra[:, inside].copy())  # the copy lets go of what lies outside
    return frequency, np.concatenate(made)


class SweepModel:
    """Model of one recording.

    Args:
        like: Another model of the same recording and orders; the spectra that do not depend on the band are taken from it.
    """

    def __init__(
        self,
        sweep: Sweep,
        reduction_ratio: float,
        sensing: Sensing,
        orders: Sequence[float],
        band_hz: tuple[float, float],
        noise: Noise | None = None,
        weight_of_all: float = 1.0,
        kept_bands: float = 4.0,
        like: "SweepModel | None" = None,
    ) -> None:
        angle, period_s, self._orders = sweep.motor_angle_rad, sweep.period_s, tuple(orders)
        # nothing passes beyond four times the band, so every n-th sample says all
        self._every = max(1, int(0.5 / period_s / (kept_bands * band_hz[1])))
        self.sample_s = self._every * period_s
        self.direction = sweep.direction[:: self._every]
        self._rows = np.flatnonzero(self.direction)
        ring_down = round(min(RING_DOWN_RAD / (2.0 * math.pi * band_hz[0]), 4.0) / period_s)
        self._length = int(scipy.fft.next_fast_len(-(-(len(angle) + ring_down) // self._every), real=True))
        full = self._length * self._every
        inside = slice(0, self._length // 2)
        if like is None or (like._length, like._every) != (self._length, self._every):
            seen = scipy.fft.rfft(levelled(sweep.signal), full)[inside]
            self._whole = *_spectra_of_waves(sweep, reduction_ratio, self._orders, full, inside), seen
        else:
            self._whole = like._whole
        frequency, spectra, seen = self._whole
        band = scipy.signal.butter(2, band_hz, "bandpass", fs=1.0 / period_s, output="sos")
        _, gain = scipy.signal.sosfreqz(band, frequency, fs=1.0 / period_s)
        weight = np.abs(gain) ** 2  # forward and backward: no phase
        self._white = float(np.mean(weight**2))
        # a rounded angle carries white noise of q²/12, twice differentiated and filtered like the angle
        rounding = sensing.gain * (2.0 * math.pi * frequency) ** 2 * resolution_rad(angle) / reduction_ratio / math.sqrt(12.0)
        if noise is not None:
            weight = weight / np.sqrt(1.0 + np.abs(rounding * noise.arm.response(frequency)) ** 2 / noise.sensor_variance)
        weight = weight_of_all * weight
        self._rounding, self._all_frequency = weight * rounding, frequency
        self._frequency = frequency[inside]
        self._spectra = sensing.gain * weight[inside] * spectra
        inertia = sensing.motor_inertia_kg_m2 * reduction_ratio  # the first spectrum is that of θ̈_m/N
        self._own = inertia * weight[inside] * spectra[0]
        self._has_own = bool(np.any(self._own))
        self._kept: tuple[bytes, Complex] | None = None
        # slopes of an arm hold its delay, or have it once on either side
        self._turn, self._turn_of_all = (lru_cache(3)(partial(turn, each)) for each in (self._frequency, frequency))
        # the fraction of white noise that comes through, hence of the samples that are independent
        self.independent = self._every * self._white
        self._seen = weight[inside] * seen
        self.signal = self._samples(self._seen)

    def ahead(self, delay_s: float) -> Real:
        """Signal advanced by a delay, in the rows that count."""
        return self._samples(self._seen * np.exp(2j * math.pi * self._frequency * delay_s))

    def _samples(self, spectra: Complex) -> Real:
        """Spectra as samples in the rows that count."""
        samples = scipy.fft.irfft(spectra, self._length, axis=-1) / self._every
        return np.asarray(samples[..., self._rows], dtype=np.float64)

    def columns(self, arm: Arm) -> tuple[Real, Real]:
        """Columns of the linear model.

        Returns the signal of the motor's motion alone, shape (n,), and that per unit of each linear unknown, shape (n,
        unknowns).
        """
        spectra = self._spectra * self._response(arm)
        if self._has_own:
            spectra[0] += self._own * self._turn(arm.delay_s)
        rows = self._samples(spectra)
        return rows[0], rows[1:].T

    def difference(self, more: Arm, less: Arm, unknowns: Real) -> Real:
        """Difference of the signals with two arms and the same unknowns; shape (n,)."""
        key = unknowns.tobytes()  # all slopes need the same spectrum
        if self._kept is None or self._kept[0] != key:
            self._kept = key, np.append(1.0, unknowns) @ self._spectra
        total = self._kept[1] * (self._response(more) - self._response(less))
        if self._has_own:
            total += self._own * (self._turn(more.delay_s) - self._turn(less.delay_s))
        return self._samples(total)

    def _response(self, arm: Arm) -> Complex:
        """Response of an arm at the frequencies inside."""
        made = arm.in_time(self._frequency)
        return made * self._turn(arm.delay_s) if arm.delay_s else made

    @property
    def white(self) -> float:
        """Power of white noise of variance 1 behind the filter."""
        return self._white

    def rounding_power(self, arm: Arm) -> float:
        """Expected power of the encoder's rounding, summed over the counted rows."""
        made = arm.in_time(self._all_frequency)
        passed = np.abs(self._rounding * (made * self._turn_of_all(arm.delay_s) if arm.delay_s else made)) ** 2
        return float(np.mean(passed)) * len(self._rows)


def resolution_rad(angle_rad: Real) -> float:
    """Step of an encoder: the smallest difference of two readings; 0 for none."""
    steps = np.diff(np.unique(angle_rad))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0


def levelled(values: Real, edge: int = 16) -> Real:
    """Subtract the straight line from beginning to end.

    The line is gravity's part, which would be a step at the ends of a recording.
    """
    few = min(edge, len(values))
    return np.asarray(values - np.linspace(float(np.mean(values[:few])), float(np.mean(values[-few:])), len(values)))


class RampsModel:
    """Model of several recordings at once.

    Args:
        like: Another model of the same recordings and orders, as in `SweepModel`.
    """

    def __init__(
        self,
        sweeps: Sequence[Sweep],
        reduction_ratio: float,
        sensing: Sensing,
        orders: tuple[float, ...],
        band_hz: tuple[float, float],
        noise: Noise | None = None,
        weights: Sequence[float] | None = None,
        kept_bands: float = 4.0,
        like: "RampsModel | None" = None,
    ) -> None:
        known: Sequence[SweepModel | None] = [None] * len(sweeps) if like is None else like._parts
        self._parts: list[SweepModel] = [
            SweepModel(sweep, reduction_ratio, sensing, orders, band_hz, noise and noise.seen_with(each), each, kept_bands, part)
            for sweep, each, part in zip(sweeps, weights or (1.0,) * len(sweeps), known, strict=True)
        ]
        self.directions = np.concatenate([part.direction[part.direction != 0] for part in self._parts])
        self.signal = np.concatenate([part.signal for part in self._parts])
        self.independent = float(np.mean([part.independent for part in self._parts]))
        self.orders, self.band_hz = orders, band_hz
        self._put_forward: dict[tuple[int, tuple[float, ...]], tuple[Real, Real]] = {}
        self._made = lru_cache(1)(self._columns)
        self._inverted = lru_cache(1)(lambda arm: Inverted(self.columns(arm)[1]))
        self._direction_rows: dict[int, NDArray[np.intp]] = {}

    def columns(self, arm: Arm) -> tuple[Real, Real]:
        """Columns of all recordings, one behind the other; those of the last arm are kept."""
        return self._made(arm)

    def _columns(self, arm: Arm) -> tuple[Real, Real]:
        """Columns of all recordings, made anew."""
        parts = [part.columns(arm) for part in self._parts]
        return np.concatenate([motion for motion, _ in parts]), np.concatenate([matrix for _, matrix in parts])

    def solve(self, arm: Arm) -> tuple[Real, Real]:
        """Solve for the linear unknowns, and return them and the residual."""
        motion, matrix = self.columns(arm)
        unknowns = self._inverted(arm).solve(self.signal - motion)
        return unknowns, self.signal - motion - matrix @ unknowns

    def projected(self, arm: Arm, slopes: Real) -> Real:
        """What the linear unknowns do not explain of slopes; shape (n, slopes)."""
        return np.asarray(slopes - self.columns(arm)[1] @ self._inverted(arm).solve(slopes))

    def difference(self, more: Arm, less: Arm, unknowns: Real) -> Real:
        """Difference of all recordings with two arms; shape (n,)."""
        return np.concatenate([part.difference(more, less, unknowns) for part in self._parts])

    def block(self, frequency_hz: float, periods: float = 3.0) -> int:
        """Samples of a block of so many periods of a frequency."""
        return max(4, round(periods / frequency_hz / self._parts[0].sample_s))

    def rounding_power(self, arm: Arm) -> float:
        """Expected power of the encoder's rounding, summed over all rows."""
        return sum(part.rounding_power(arm) for part in self._parts)

    def noise(self, arm: Arm) -> Noise:
        """Noise of the residual, less the part that rounding explains."""
        left = self.power(arm)
        sensor = max(left - self.rounding_power(arm), LEAST_SENSOR_NOISE * left) / len(self.signal)
        return Noise(arm, sensor / float(np.mean([part.white for part in self._parts])))

    def weights(self, arm: Arm) -> tuple[float, ...]:
        """Weights of the recordings, by their residuals; mean square 1."""
        left = self.split(self.solve(arm)[1])
        weights = np.array([1.0 / (math.sqrt(float(np.mean(each**2))) + 1e-300) for each in left])
        return tuple((weights / math.sqrt(float(np.mean(weights**2)))).tolist())

    def split(self, values: Real) -> list[Real]:
        """Values of all rows, by recording."""
        ends = np.cumsum([len(part.signal) for part in self._parts])[:-1]
        return [np.asarray(each) for each in np.split(values, ends)]

    def powers_apart(self, arm: Arm, delays_s: Sequence[float], orders: Sequence[float]) -> list[float]:
        """Power of the residual by delay, with some of the orders, each direction with its own."""
        motion, matrix = self.columns(replace(arm, delay_s=0.0))
        columns = [matrix.T[2 * self.orders.index(order) + part] for order in orders for part in (0, 1)]
        totals = np.zeros(len(delays_s))
        for direction in (1, -1):
            rows = self._rows_of(direction)
            if not len(rows):
                continue
            ahead, power = self._ahead(direction, tuple(delays_s))
            own = np.stack([column.take(rows) for column in (*columns, motion)])
            square, along = own @ own.T, own @ ahead
            # the motor's motion is taken off all signals
            wanted, along = power - 2.0 * along[-1] + square[-1, -1], along[:-1] - square[:-1, -1:]
            scale = np.sqrt(np.diag(square)[:-1]) + 1e-300
            along /= scale[:, np.newaxis]
            solver = pseudo_inverse(square[:-1, :-1] / np.outer(scale, scale))
            totals += wanted - np.einsum("ij,ij->j", along, solver @ along)
        return [float(total) for total in totals]

    def _rows_of(self, direction: int) -> NDArray[np.intp]:
        if direction not in self._direction_rows:
            self._direction_rows[direction] = np.flatnonzero(self.directions == direction)
        return self._direction_rows[direction]

    def _ahead(self, direction: int, delays_s: tuple[float, ...]) -> tuple[Real, Real]:
        """Signal advanced by each delay, in one direction, shape (rows, delays), and its power, shape (delays,)."""
        key = direction, delays_s
        if key not in self._put_forward:
            whole = [np.concatenate([part.ahead(delay) for part in self._parts]) for delay in delays_s]
            for side in (1, -1):
                ahead = np.stack([each[self._rows_of(side)] for each in whole], axis=1)
                self._put_forward[side, delays_s] = ahead, np.einsum("ij,ij->j", ahead, ahead)
        return self._put_forward[key]

    def power(self, arm: Arm) -> float:
        """Power of the residual."""
        return float(np.sum(self.solve(arm)[1] ** 2))


class Inverted:
    """Columns for least squares, by normal equations of them scaled."""

    def __init__(self, matrix: Real) -> None:
        self._scale = np.sqrt(np.einsum("ij,ij->j", matrix, matrix)) + 1e-300
        self._scaled = matrix / self._scale
        self._inverse = pseudo_inverse(self._scaled.T @ self._scaled)

    def solve(self, wanted: Real) -> Real:
        """Unknowns that make the columns come nearest to what is wanted; shape (unknowns,) or (unknowns, n)."""
        return np.asarray(((self._inverse @ (self._scaled.T @ wanted)).T / self._scale).T)


def least_squares(matrix: Real, wanted: Real) -> Real:
    """Solve a least-squares problem once."""
    return Inverted(matrix).solve(wanted)


def pseudo_inverse(square: Real) -> Real:
    """Pseudo-inverse of a positive semidefinite matrix, by its eigenvalues from 1e-12 of the largest."""
    values, vectors = np.linalg.eigh(square)
    values, vectors = values[::-1], vectors[:, ::-1]
    kept = values > 1e-12 * values[0]
    return np.asarray(vectors @ (np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)[:, np.newaxis] * vectors.T))


def modelled(sweep: Sweep, reduction_ratio: float, sensing: Sensing, arm: Arm, error: TransmissionError) -> Real:
    """Predict the signal of a whole recording without gravity's part; shape (n,)."""
    angle, period_s = np.asarray(sweep.motor_angle_rad, dtype=np.float64), sweep.period_s
    waves = np.stack([angle / reduction_ratio + shown_error(error, angle, period_s), angle])
    length = int(
        scipy.fft.next_fast_len(len(angle) + round(RING_DOWN_RAD / (2.0 * math.pi * arm.resonance_hz) / period_s), real=True)
    )
    frequency, (driven, own) = acceleration_spectrum(waves, period_s, length)
    late = np.exp(-2j * math.pi * frequency * arm.delay_s)
    spectrum = sensing.gain * driven * arm.response(frequency) + sensing.motor_inertia_kg_m2 * own * late
    return np.asarray(scipy.fft.irfft(spectrum, length)[: len(angle)])
