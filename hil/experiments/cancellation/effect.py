"""Effect of each order of each axis on the tip.

It is read from recordings of the vibration.

An order k of an axis shakes the tip by L X(s) [A_k cos(k θ_m + φ_k)]'', where X = θ_l/θ_sync is the response of arm and loop.
A cancellation of that order is the same wave with another amplitude and phase, whatever X is. So a recording is fitted with the
waves L X(s) [cos k θ_m]'' and −L X(s) [sin k θ_m]'' of all orders of all axes at once, by least squares: one complex amplitude
for each, in arcseconds as the tip feels it. Without cancellation that is e = A_k e^{jφ_k}; with a fraction g of it, e − g c. Only
c and e are compared with each other, and a response that is not quite X changes both alike.

X is that of the model; its resonance, its damping and the sensor's delay are refined on the recordings themselves. The planned
motion, as the position loop lets it through, is fitted beside the orders: its jerks ring as well. Its amplitude is 1 within
`PLANNED_SPREAD`, so that it does not explain what it hardly shows.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy

from hil.control.angles import ARCSEC
from hil.control.arrays import Complex, Real, Rows
from hil.design.ate.model import Arm, levelled
from hil.design.estimation import EVALUATIONS, ROUNDING
from hil.design.frequency import OF_SAMPLING, Loop
from hil.design.ringing import PADDING_S
from hil.design.transmission_error import acceleration_spectrum, shown_fraction, shown_waves
from hil.design.uncertainty import LIKELY
from hil.recording import Recording

LOWEST_HZ = 0.3
"""Bound: nothing of X is needed below it: a band of vibration begins at 2 Hz."""
LEAST_NOISE_M_S2 = 1e-5
"""Bound: noise that every accelerometer has: no verdict rests on less."""
LEAK = 0.01
"""Measured: fraction of other orders' vibration that a response which is not quite X adds to an order's: on 50 drawn robots
(50201 to 50299) the rms of z of a cancellation's factor and turn is 0.52 and 0.42."""
JOLT = 0.6
"""Measured: what of the motion's own vibration an order takes as its own, by its projection on the order's wave: on 119 drawn
arms below 7 Hz (10142 to 10341, 50001 to 50200), 190 right orders kept 0.6 of it (rms; nine in ten less than 1.0)."""
PLANNED_SPREAD = 1.6
"""Measured: standard deviation of the planned motion's two amplitudes around 1 and 0: it is 1.6 on the 16 of the drawn robots
51105 to 51144 that determine them to 0.1."""


class Part(NamedTuple):
    """Order of an axis, the unit that is cancelled or left out."""

    axis: int
    order: float

    @property
    def words(self) -> str:
        """The part in words."""
        return f"axis {self.axis}, order {self.order:g}"


@dataclass(frozen=True)
class Response:
    """Response X of the arm to its transmission error.

    Attributes:
        known: The loop around the model; or, where nothing but the arm on its gear is known, that.
        stretch: Factor of the resonance.
        damping: Factor of the damping.
    """

    known: Loop | Arm
    stretch: float = 1.0
    damping: float = 1.0
    delay_s: float = 0.0

    def at(self, frequency_hz: Real) -> Complex:
        """Response X(jω) e^{−jωΔ}; shape of `frequency_hz`.

        It is 0 at frequencies that are too low to matter.
        """
        response = np.zeros(len(frequency_hz), dtype=np.complex128)
        inside = frequency_hz > LOWEST_HZ
        frequency = frequency_hz[inside]
        late = np.exp(-2j * math.pi * frequency * self.delay_s)
        if isinstance(self.known, Arm):
            arm = replace(
                self.known, resonance_hz=self.known.resonance_hz * self.stretch, damping=self.known.damping * self.damping
            )
            response[inside] = arm.response(frequency) * late
            return response
        plant = self.known.plant
        plant = replace(
            plant,
            gear_stiffness_nm_rad=plant.gear_stiffness_nm_rad * self.stretch**2,
            gear_damping_nm_s_rad=plant.gear_damping_nm_s_rad * self.damping,
            arm_damping_nm_s_rad=plant.arm_damping_nm_s_rad * self.damping,
        )
        response[inside] = replace(self.known, plant=plant).arm_per_transmission_error(frequency) * late
        return response

    def varied(self, steps: Real) -> "Response":
        """Change the response by some of its `LIKELY` deviations; shape (3,)."""
        stretch, damping, delay = (float(step) * likely for step, likely in zip(steps, LIKELY, strict=True))
        return replace(
            self, stretch=self.stretch * math.exp(stretch), damping=self.damping * math.exp(damping), delay_s=self.delay_s + delay
        )


@dataclass(frozen=True)
class AxisWaves:
    """An axis whose orders are read.

    Attributes:
        orders: Orders k that are fitted, those that are not cancelled included.
        lever_m: Lever of the tip: a number, or one for each row; shape () or (n,).
        planned_rad: Planned motor angle over the reduction ratio, as the position loop lets it through; shape (n,).
    """

    number: int
    orders: tuple[float, ...]
    lever_m: Real
    response: Response
    planned_rad: Real

    def levers_m(self, count: int) -> Real:
        """Lever in the first rows; shape () or (count,)."""
        return self.lever_m if np.ndim(self.lever_m) == 0 else self.lever_m[:count]


@dataclass(frozen=True)
class Sighting:
    """Complex amplitudes of all parts in one recording.

    Attributes:
        amplitude: Amplitude at the tip in arcsec, by part.
        unit_variance: Variance of either component of it for residuals of variance 1, by part.
        residual: What the waves leave of the vibration in m/s²; shape (rows,).
        free: Fraction of the noise that the fit leaves in it, by power; the waves take the rest for their own.
        vibration: The vibration itself; shape (rows,).
        images: Images of the set-points in it, which are no order; shape (rows,).
        waves: Wave of each part for an amplitude of 1 and of j; shape (rows, 2).
        jolt: Amplitude of each part's wave that is most like the motion's own vibration, in arcsec.
    """

    amplitude: Mapping[Part, complex]
    unit_variance: Mapping[Part, float]
    residual: Real
    free: float
    vibration: Real
    images: Real
    waves: Mapping[Part, Real]
    jolt: Mapping[Part, float] = field(default_factory=dict)

    def wave(self, part: Part, amplitude: complex) -> Real:
        """Vibration in m/s² of a part with an amplitude in arcsec; shape (rows,)."""
        return np.asarray(self.waves[part] @ np.array([amplitude.real, amplitude.imag]))

    @property
    def noise_variance(self) -> float:
        """Variance of the noise in the band."""
        return float(np.mean(self.residual**2)) / self.free

    def variance(self, part: Part) -> float:
        """Variance of either component of a part's amplitude, by residual and leakage."""
        noise = max(self.noise_variance, LEAST_NOISE_M_S2**2)
        leaks = sum(abs(size) ** 2 / self.unit_variance[other] for other, size in self.amplitude.items() if other != part)
        return self.unit_variance[part] * (noise + LEAK**2 * leaks)

    def bias_variance(self, part: Part) -> float:
        """Variance of either component that is alike in all runs of the motion: its own vibration taken for the part's."""
        return 0.5 * (JOLT * self.jolt.get(part, 0.0)) ** 2


@dataclass(frozen=True)
class Look:
    """One run of a trial, with its cancellation and its vibration.

    Attributes:
        gains: Fraction of each part that acted.
        sighting: Its vibration and the waves in it.
    """

    gains: Mapping[Part, float]
    sighting: Sighting


def alike(looks: Sequence[Look], used: Collection[Part]) -> list[Look]:
    """Runs in which exactly these parts acted with full gain."""
    return [look for look in looks if all(gain == float(part in used) for part, gain in look.gains.items())]


class _Spectra:
    """Transforms of one recording and of its waves."""

    def __init__(
        self,
        recording: Recording,
        axes: Sequence[AxisWaves],
        rows: Rows,
        band_hz: tuple[float, float],
        images_m_s2: Real | None = None,
    ) -> None:
        period, self._count = recording.period_s, len(recording.time_s)
        self._rows = rows[: self._count]
        self._length = int(scipy.fft.next_fast_len(self._count + round(PADDING_S / period), real=True))
        self.frequency = scipy.fft.rfftfreq(self._length, period)
        self._weight = _weight(self.frequency, period, band_hz)
        self.independent = float(np.mean(self._weight**2))
        felt = np.stack([levelled(recording.felt_m_s2), np.zeros(self._count) if images_m_s2 is None else images_m_s2])
        self.vibration, self.images = self._samples(self._weight * scipy.fft.rfft(felt, self._length))
        self.signal = self.vibration - self.images
        self._waves: dict[int, Complex] = {}
        for axis in axes:
            angle = recording.axis(axis.number, "position_rad")
            pairs = shown_waves(angle, period, axis.orders)
            waves = np.concatenate([ARCSEC * pairs, axis.planned_rad[np.newaxis, : self._count]])
            spectra = acceleration_spectrum(waves, period, self._length)[1]
            # the planned motion twice, a quarter of a period apart: the loop turns its jerks by what is not known here
            self._waves[axis.number] = np.concatenate([spectra, 1j * spectra[-1:]])

    def _samples(self, spectra: Complex) -> Real:
        whole = scipy.fft.irfft(spectra, self._length)[..., : self._count]
        return np.asarray(whole[..., self._rows])

    def noise_in(self, columns: Real, solver: Real) -> tuple[float, Real]:
        """White noise in a fit: fraction of its power that is left, one sample's at least, and covariance of the unknowns.

        tr (I − H) C (I − H)ᵀ/tr C and K C Kᵀ n/tr C per residual variance; C is the covariance behind the band-pass, A the
        columns, shape (n, unknowns), K their solver, H = A K.
        """
        both = np.zeros((2, columns.shape[1], self._count))
        both[:, :, self._rows] = columns.T, solver
        spectra = scipy.fft.rfft(both, self._length) * self._weight
        # sums over both halves of a spectrum: its ends count once
        ends = np.full(len(self.frequency), 2.0 / self._length)
        ends[0] *= 0.5
        ends[-1] *= 1.0 - 0.5 * float(self._length % 2 == 0)
        seen, solved = spectra
        covariance = ((solved * ends) @ solved.conj().T).real
        taken = 2.0 * np.sum(ends * (solved * seen.conj()).real) - np.sum(columns.T @ columns * covariance)
        samples = self.independent * len(columns)
        return max(1.0 - float(taken) / samples, min(1.0, 1.0 / samples)), covariance / self.independent

    def columns(self, axis: AxisWaves, response: Response) -> Real:
        """Columns of an axis; shape (rows, 2 orders + 2)."""
        made = self._samples(self._waves[axis.number] * (self._weight * response.at(self.frequency)))
        lever = axis.levers_m(self._count)
        return np.asarray(made * (lever if np.ndim(lever) == 0 else lever[self._rows])).T


def _weight(frequency_hz: Real, period_s: float, band_hz: tuple[float, float]) -> Real:
    """Gain of the band-pass of a vibration, forward and backward.

    Shape of `frequency_hz`.
    """
    top = min(band_hz[1], OF_SAMPLING / period_s)
    band = scipy.signal.butter(2, (band_hz[0], top), "bandpass", fs=1.0 / period_s, output="sos")
    return np.asarray(np.abs(scipy.signal.sosfreqz(band, frequency_hz, fs=1.0 / period_s)[1]) ** 2)


def in_band(frequency_hz: Real, band_hz: tuple[float, float]) -> Real:
    """Gain of the band-pass for a sine, sampled or not, 0 to 1; shape of `frequency_hz`."""
    band = scipy.signal.butter(2, 2.0 * math.pi * np.asarray(band_hz), "bandpass", analog=True)
    return np.asarray(np.abs(scipy.signal.freqs(*band, 2.0 * math.pi * frequency_hz)[1]) ** 2)


def unshown(frequency_hz: Real, period_s: float, band_hz: tuple[float, float]) -> Real:
    """Part of a sine in a band that its samples do not show, 0 to 1; shape of `frequency_hz`."""
    inside = np.minimum(frequency_hz, 0.5 / period_s)
    shown = _weight(inside, period_s, band_hz) * shown_fraction(frequency_hz * period_s)
    return np.asarray(np.clip(in_band(frequency_hz, band_hz) - shown, 0.0, 1.0))


def acceleration_of(
    values: Real, period_s: float, band_hz: tuple[float, float], angle_per_value: Callable[[Real], Complex]
) -> Real:
    """Acceleration in a band of the angle that samples cause; shape of `values`."""
    length = int(scipy.fft.next_fast_len(len(values) + round(PADDING_S / period_s), real=True))
    frequency, spectrum = acceleration_spectrum(values, period_s, length)
    made = scipy.fft.irfft(spectrum * _weight(frequency, period_s, band_hz) * angle_per_value(frequency), length)
    return np.asarray(made[: len(values)])


def _solver(columns: Real) -> tuple[Real, Real]:
    """Matrix that solves least squares, and the errors of the unknowns that the rows do not show.

    Shapes (unknowns, rows) and (unknowns, unknowns).
    """
    scale = np.sqrt(np.sum(columns**2, axis=0)) + np.finfo(np.float64).tiny ** 0.25
    scaled = columns / scale
    # what the rows do not show, or cannot tell from another, has a huge variance so, and not none
    inverse = np.linalg.inv(scaled.T @ scaled + ROUNDING * np.eye(len(scale)))
    return inverse @ scaled.T / scale[:, np.newaxis], math.sqrt(ROUNDING) * inverse / scale[:, np.newaxis]


def sight(
    recording: Recording, axes: Sequence[AxisWaves], rows: Rows, band_hz: tuple[float, float], images_m_s2: Real | None = None
) -> Sighting:
    """Read the complex amplitudes of all orders of all axes from one recording.

    `images_m_s2` is what images of the set-points do in it (`images`), shape (n,); None: nothing.
    """
    spectra = _Spectra(recording, axes, rows, band_hz, images_m_s2)
    columns = [spectra.columns(axis, axis.response) for axis in axes]
    whole = np.concatenate(columns, axis=1)
    known, values = _motion_known(whole, axes, spectra)
    solver, unseen = _solver(np.vstack([whole, known]))
    by_rows, by_known = np.split(solver, [len(whole)], axis=1)
    unknowns = by_rows @ spectra.signal + by_known @ values
    residual = spectra.signal - whole @ unknowns
    free, covariance = spectra.noise_in(whole, by_rows)
    variance = np.diag(covariance) + np.sum(np.hstack([by_known, unseen]) ** 2, axis=1) / spectra.independent
    amplitude, unit, waves, at = {}, {}, {}, 0
    own_vibration = np.zeros(len(spectra.signal))
    for axis, own in zip(axes, columns, strict=True):
        for index, order in enumerate(axis.orders):
            part = Part(axis.number, order)
            waves[part] = own[:, 2 * index : 2 * index + 2]
            amplitude[part] = complex(unknowns[at], unknowns[at + 1])
            unit[part] = 0.5 * float(variance[at] + variance[at + 1])
            at += 2
        planned = own[:, 2 * len(axis.orders) :]
        own_vibration += planned @ unknowns[at : at + planned.shape[1]]
        at += planned.shape[1]
    jolt = {part: float(np.linalg.norm(np.linalg.pinv(wave) @ own_vibration)) for part, wave in waves.items()}
    return Sighting(amplitude, unit, residual, free, spectra.vibration, spectra.images, waves, jolt)


def _motion_known(columns: Real, axes: Sequence[AxisWaves], spectra: _Spectra) -> tuple[Real, Real]:
    """What is known of the planned motions: two rows more for each axis, weighed by the noise, and their values."""
    solver = _solver(columns)[0]
    residual = spectra.signal - columns @ (solver @ spectra.signal)
    noise = float(np.mean(residual**2)) / (spectra.independent * spectra.noise_in(columns, solver)[0])
    weight = math.sqrt(noise) / PLANNED_SPREAD
    ends = np.cumsum([2 * len(axis.orders) + 2 for axis in axes])
    known = np.zeros((2 * len(ends), columns.shape[1]))
    known[np.arange(len(known)), np.stack([ends - 2, ends - 1], axis=1).ravel()] = weight
    return known, np.tile([weight, 0.0], len(ends))


def refined(
    recordings: Sequence[Recording],
    axes: Sequence[AxisWaves],
    rows: Sequence[Rows],
    band_hz: tuple[float, float],
    images_m_s2: Sequence[Real | None],
) -> tuple[AxisWaves, ...]:
    """Refine the responses of the axes on some recordings, one after the other.

    Each recording has amplitudes of its own, so a cancellation in it, right or wrong, does not matter. What is known of a
    model (`LIKELY`) counts as much as the noise allows.
    """
    spectra = [
        _Spectra(recording, axes, each, band_hz, images)
        for recording, each, images in zip(recordings, rows, images_m_s2, strict=True)
    ]
    found = list(axes)
    for index, axis in enumerate(axes):
        others = [[one.columns(each, each.response) for each in found if each is not axis] for one in spectra]
        problem = _Refinement(spectra, axis, others)
        simplex = np.vstack([np.zeros(3), 0.5 * np.eye(3)])
        best = scipy.optimize.minimize(
            problem.cost,
            np.zeros(3),
            method="Nelder-Mead",
            options={"maxfev": EVALUATIONS, "xatol": 0.01, "fatol": 0.1, "initial_simplex": simplex},
        )
        found[index] = replace(axis, response=axis.response.varied(np.asarray(best.x, dtype=np.float64)))
    return tuple(found)


class _Refinement:
    """Cost of a response: residual power over the noise, plus the prior's part."""

    def __init__(self, spectra: Sequence[_Spectra], axis: AxisWaves, others: Sequence[Sequence[Real]]) -> None:
        self._spectra, self._axis, self._others = spectra, axis, others
        samples = sum(
            one.independent * len(one.signal) * one.noise_in(*self._fit(one, np.zeros(3), beside))[0]
            for one, beside in zip(spectra, others, strict=True)
        )
        self._noise = max(self._power(np.zeros(3)) / max(samples, 1.0), 1e-30)

    def _fit(self, one: _Spectra, steps: Real, beside: Sequence[Real]) -> tuple[Real, Real]:
        """Columns of a recording and their solver."""
        columns = np.concatenate([one.columns(self._axis, self._axis.response.varied(steps)), *beside], axis=1)
        return columns, _solver(columns)[0]

    def _power(self, steps: Real) -> float:
        total = 0.0
        for one, beside in zip(self._spectra, self._others, strict=True):
            columns, solver = self._fit(one, steps, beside)
            residual = one.signal - columns @ (solver @ one.signal)
            total += one.independent * float(residual @ residual)
        return total

    def cost(self, steps: Real) -> float:
        """Residual power over the noise at the start, plus squared steps."""
        return self._power(steps) / self._noise + float(steps @ steps)
