"""A recorded ramp beside the simulated arm, as spectra."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np
import scipy

from hil.control.arrays import Complex, Real
from hil.design.ate.gear import BaseMotion, GearLaw, follow_alike
from hil.design.ate.model import BAND, Arm, Sweep, resolution_rad
from hil.design.ate.rest import variance_at_rest
from hil.design.ate.ripple import Ripple
from hil.design.transmission_error import motor_speed_rps

GEAR_FROM = 0.3
"""Accuracy: lower end of the fit's band by the arm's frequency, which ends with `BAND`; the motion itself lies below it: a factor
of 2 changes 0.2, errors by 19 %."""
TAPERED = 0.05
"""Accuracy: part of each ramp over which its ends fade, so that the motion below the band does not leak into it: a factor of 2
changes 0.1, errors by 5 %."""
THINNED_STEPS_PER_RADIAN = 3.0
"""Accuracy: samples of a thinned recording per radian of the fastest vibration: on a soft gear with hysteresis 0.09 % of the
vibration are missed, and 0.24 % with two."""
LEAST_STEP_RAD = 1e-9
"""Bound: step of an encoder whose readings show none: finer than any."""
OF_IMAGES = tuple(f"{part}_{degree}" for degree in range(3) for part in ("beyond", "turned"))
"""Unknowns of the sensor's filter beyond half of the sampling rate; the samples show such vibrations in the band.

Its gain there over that of the model is 1 + Σ (beyond + j turned) (2 T f − 1)^degree."""
SHARED = (
    "resonance", "damping", "gear_fraction", "bend", "droop", "delay", "dispersion", *OF_IMAGES,
    "softness", "wind_up", "hysteresis", "hysteresis_torsion", "cosine", "sine",
)  # fmt: skip
"""Unknowns of arm, gear and sensor. Resonance, damping ζ and all of the gear's are logarithms; gear_fraction is the logarithm of
the gear's part of ζ over the arm's, and the last two are gravity's. The sensor's gain is 1/(1 − bend x² + droop x⁴): a mounting
that resonates, and a low-pass of order 2. Its filter turns the phase by the delay, which is
that at the resonance, and by dispersion (x³ − x) more, x = f/f_a."""
BEGINNING = ("wound", "real", "imaginary")
"""Unknowns of each ramp: z/F at its beginning, and the phasor in rad with which the arm rings there."""
FACTORS = ("bend", "droop", "delay", "dispersion", *OF_IMAGES)
"""Those that need no simulation: factors of the spectrum."""
OF_ROUNDING = ("resonance", "damping", "gear_fraction", "bend", "droop")
"""Those on which the noise of the encoder depends."""


@dataclass(frozen=True)
class Setting:
    """What all ramps share.

    A vector of unknowns has `SHARED` first, then A_k cos φ_k and A_k sin φ_k of each order in rad, then those of each ramp's
    beginning: z/F, and both parts of the phasor with which the arm rings.

    Attributes:
        ripple: Ripple of the motor beyond half of the sampling rate.
        sensor: The sensor at some frequencies, once for all ramps that have them.
    """

    reduction_ratio: float
    lever_m: float
    orders: tuple[float, ...]
    band_hz: tuple[float, float]
    ripple: Ripple
    sensor: Callable[[int, float, float], "Sensor"] = field(default_factory=lambda: lru_cache(maxsize=None)(Sensor))

    @property
    def waves(self) -> slice:
        """Unknowns of the orders."""
        return slice(len(SHARED), len(SHARED) + 2 * len(self.orders))

    @staticmethod
    def shared(p: Real) -> dict[str, float]:
        """The shared unknowns by name."""
        return dict(zip(SHARED, p.tolist(), strict=False))

    def law(self, p: Real) -> GearLaw:
        """The gear of a vector of unknowns."""
        v = self.shared(p)
        return GearLaw(
            math.exp(v["resonance"]), math.exp(v["damping"]), 1.0 / (1.0 + math.exp(-v["gear_fraction"])),
            math.exp(v["softness"]), math.exp(v["wind_up"]), math.exp(v["hysteresis"]), math.exp(v["hysteresis_torsion"]),
            (v["cosine"], v["sine"]),
        )  # fmt: skip


def thinning(sweeps: Sequence[Sweep], setting: Setting) -> int:
    """Return the largest n for which every n-th sample is enough.

    A radian of the band's fastest vibration keeps `THINNED_STEPS_PER_RADIAN` samples, and every order stays below 0.8 of half
    of the new rate. n is 1 where the samples show ripple of the motor at another frequency: its image depends on their rate.
    """
    if setting.ripple.waves:
        return 1
    fastest_rps = max(float(np.max(np.abs(motor_speed_rps(each.motor_angle_rad, each.period_s)))) for each in sweeps)
    period_s = max(each.period_s for each in sweeps)
    per_step = 1.0 / (THINNED_STEPS_PER_RADIAN * 2.0 * math.pi * setting.band_hz[1] * period_s)
    per_order = 0.4 / (max(setting.orders) * fastest_rps * period_s)
    return max(1, int(min(per_step, per_order)))


def thinned(sweep: Sweep, every: int) -> Sweep:
    """Return a recording with one of `every` samples, behind a low-pass without phase.

    The filter is flat to 1e-4 below a third of half of the new rate.
    """
    if every == 1:
        return sweep
    angle, signal = (
        scipy.signal.resample_poly(each, 1, every, window=("kaiser", 8.0), padtype="line")
        for each in (sweep.motor_angle_rad, sweep.signal)
    )
    return Sweep(angle, signal, every * sweep.period_s, sweep.direction[::every])


def _folded(spectrum: Complex, count: int, every: int) -> Complex:
    """Spectrum of every n-th sample of a real signal, of which one without a filter shows all; shape (count // 2 + 1,)."""
    if every == 1:
        return spectrum
    folded, last = spectrum[: count // 2 + 1].copy(), count * every // 2
    for begin in range(count, count * every, count):
        direct = spectrum[begin : min(begin + len(folded), last + 1)]
        folded[: len(direct)] += direct
        mirrored = count * every - begin - len(direct)
        folded[len(direct) :] += spectrum[mirrored - len(folded) + len(direct) + 1 : mirrored + 1][::-1].conj()
    return folded


def _gain(hz: Real, resonance: float, bend: float, droop: float) -> Real:
    """Gain of the sensor: of its mounting and of its low-pass."""
    square = np.minimum(hz / math.exp(resonance), BAND[1]) ** 2
    return np.asarray(1.0 / (1.0 - bend * square + droop * square**2))


def _complex_gain(hz: Real, resonance: float, bend: float, droop: float) -> Complex:
    """Gain as a complex number, with which a spectrum is multiplied in half of the time."""
    return _gain(hz, resonance, bend, droop).astype(np.complex128)


def _turn(hz: Real, resonance: float, delay: float, dispersion: float) -> Complex:
    """Turn of the phase by the sensor."""
    x = np.minimum(hz / math.exp(resonance), BAND[1])
    return np.asarray(np.exp(-1j * (2.0 * math.pi * hz * delay + dispersion * (x**3 - x))))


def _beyond(x: Real, *gains: complex) -> Complex:
    """Gain beyond half of the sampling rate over that of the model, as in `OF_IMAGES`."""
    return np.asarray(1.0 + np.polynomial.polynomial.polyval(x, gains))


class Sensor:
    """The sensor at the frequencies of a transform.

    Args:
        count: Samples of the transform.
        step_s: Time between two of them.
        period_s: Time between two samples of the recording.
    """

    def __init__(self, count: int, step_s: float, period_s: float) -> None:
        self.hz = scipy.fft.rfftfreq(count, step_s)
        self._is_beyond = slice(int(np.searchsorted(self.hz, 0.5 / period_s, "right")), None)
        # most unknowns change none of these, and ramps of one length share them
        self._gain, self._turn, self._beyond = (
            lru_cache(maxsize=4)(partial(function, hz))
            for function, hz in (
                (_complex_gain, self.hz),
                (_turn, self.hz),
                (_beyond, 2.0 * period_s * self.hz[self._is_beyond] - 1.0),
            )
        )

    def shown(self, moved: Complex, lever_m: float, v: Mapping[str, float]) -> Complex:
        """Spectrum behind the sensor of one of the arm's acceleration, by the shared unknowns."""
        late = moved * lever_m
        late *= self._gain(v["resonance"], v["bend"], v["droop"])
        late *= self._turn(v["resonance"], v["delay"], v["dispersion"])
        beyond = [v[name] + 1j * v[other] for name, other in zip(OF_IMAGES[::2], OF_IMAGES[1::2], strict=True)]
        if any(beyond):
            late[self._is_beyond] *= self._beyond(*beyond)
        return np.asarray(late)


class Ramp:
    """A recording: its motion, and its spectra in the band, one for each direction.

    Args:
        setting: What all ramps share.
        begins_at: Place of the first unknown of this ramp's beginning.
        every: One of so many samples is kept.

    Attributes:
        setting: What all ramps share.
        motion: Motion of the gear's input.
        counts: Samples of each part.
        hz: Frequencies of each part's bins.
        own: Unknowns of the ramp's beginning.
        seen: Spectra of the signal.
        still: Variance of the signal while the motor stands; infinite if it never does.
    """

    def __init__(self, sweep: Sweep, setting: Setting, begins_at: int, every: int = 1) -> None:
        recorded, sweep = sweep, thinned(sweep, every)
        self.setting, self._period_s = setting, sweep.period_s
        self.own = slice(begins_at, begins_at + len(BEGINNING))
        self.motion = BaseMotion.of(
            sweep.motor_angle_rad, sweep.period_s, setting.reduction_ratio, setting.orders, setting.band_hz[1], setting.ripple
        )
        self._count = len(sweep.motor_angle_rad)
        self._length = int(scipy.fft.next_fast_len(self._count, real=True))
        self._sensor = setting.sensor(self._length * self.motion.per_sample, self.motion.step_s, self._period_s)
        turned = int(np.flatnonzero(sweep.direction == sweep.direction[np.flatnonzero(sweep.direction)[0]])[-1])
        later = np.flatnonzero(sweep.direction[turned:] == -sweep.direction[turned])
        between = turned + (int(later[0]) // 2 if len(later) else 0)
        self._pieces = [slice(0, between), slice(between, self._count)] if len(later) else [slice(0, self._count)]
        self.counts = [piece.stop - piece.start for piece in self._pieces]
        low, high = setting.band_hz
        self._tapers = [scipy.signal.windows.tukey(count, TAPERED) for count in self.counts]
        self._lines = [np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), 2))[0] for count in self.counts]
        rates = [scipy.fft.rfftfreq(count, self._period_s) for count in self.counts]
        self._inside = [slice(*np.searchsorted(hz, (low, high))) for hz in rates]
        self.hz = [hz[inside] for hz, inside in zip(rates, self._inside, strict=True)]
        self.seen = [spectra[0] for spectra in self._spectra(sweep.signal[np.newaxis])]
        # at rest a signal may stay within one step, in motion it does not
        steps = resolution_rad(recorded.signal) ** 2 / 12.0 / every
        self.still = variance_at_rest(sweep.signal, motor_speed_rps(sweep.motor_angle_rad, sweep.period_s)) + steps
        step = max(resolution_rad(recorded.motor_angle_rad), LEAST_STEP_RAD) / math.sqrt(every)
        size = setting.lever_m * step / setting.reduction_ratio
        self._rounding = [(size * (2.0 * math.pi * hz) ** 2) ** 2 / 12.0 for hz in self.hz]
        rounded = np.random.default_rng(begins_at).uniform(-0.5, 0.5, self._count) * step
        self._shaken = self.motion.shaken(rounded, setting.reduction_ratio)

    def _spectra(self, signals: Real) -> list[Complex]:
        """Spectra of each part in the band, without its straight line; a row for each signal."""
        made = []
        for piece, line, taper, inside in zip(self._pieces, self._lines, self._tapers, self._inside, strict=True):
            parts = np.stack([(part - line @ (part @ line)) * taper for part in signals[:, piece]])
            made.append(scipy.fft.rfft(parts)[:, inside])
        return made

    def began(self, p: Real) -> tuple[float, complex]:
        """z/F at the beginning, and the phasor of the ringing."""
        wound, real, imaginary = p[self.own].tolist()
        return wound, complex(real, imaginary)

    def moved_alike(self, unknowns: Real, laws: Sequence[GearLaw]) -> Complex:
        """Spectra of several arms, a row each, as each has it alone.

        Args:
            unknowns: A vector of each; shape (arms, unknowns).
        """
        waves = unknowns[:, self.setting.waves]
        motions = np.empty((len(waves) if np.any(waves != waves[0]) else 1, *self.motion.rigid.shape))
        for each, motion in zip(waves, motions, strict=False):
            self.motion.with_error(each, motion)
        records = np.concatenate([law.record(*self.began(p)) for p, law in zip(unknowns, laws, strict=True)])
        return self.spectrum(follow_alike(records, motions, self.motion.step_s))

    def spectrum(self, accelerations: Real) -> Complex:
        """Spectra of accelerations at the integration's steps; of each row."""
        return np.asarray(scipy.fft.rfft(accelerations, self._length * self.motion.per_sample))

    def largest(self, moved: Complex) -> float:
        """Largest acceleration in the band, in rad/s², of a simulated spectrum."""
        (low, high), hz = self.setting.band_hz, self._sensor.hz
        return float(np.max(np.abs(scipy.fft.irfft(np.where((hz > low) & (hz < high), moved, 0.0)))))

    def shown(self, moved: Complex, p: Real) -> list[Complex]:
        """Spectra of each part as the sensor shows them, of one at the integration's steps."""
        return [spectra[0] for spectra in self.shown_alike([moved], p[np.newaxis])]

    def shown_alike(self, moved: Sequence[Complex], unknowns: Real) -> list[Complex]:
        """Spectra of each part of several, a row each, as each alone.

        Args:
            unknowns: A vector for each; shape (spectra, unknowns).
        """
        every, setting = self.motion.per_sample, self.setting
        shown = (self._sensor.shown(each, setting.lever_m, setting.shared(p)) for each, p in zip(moved, unknowns, strict=True))
        late = np.stack([_folded(each, self._length, every) for each in shown])
        return self._spectra(scipy.fft.irfft(late, self._length)[:, : self._count] / every)

    def shaken(self, p: Real, law: GearLaw, moved: Complex) -> list[Real]:
        """Power that one draw of the rounding adds, simulated; per sample."""
        base, speed = self.motion.with_error(p[self.setting.waves]) + self._shaken
        added = law.follow(base, speed, self.motion.step_s, *self.began(p))
        spectrum = np.asarray(scipy.fft.rfft(added, self._length * self.motion.per_sample)) - moved
        return [np.abs(each) ** 2 / n for each, n in zip(self.shown(spectrum, p), self.counts, strict=True)]

    def rounding(self, p: Real, small: tuple[float, float]) -> list[Real]:
        """Variance of a sample's bin that the encoder's rounding gives.

        For so small a motion the arm is linear; `small` holds the factors by which f_a and ζ are others there.
        """
        v, law, found = self.setting.shared(p), self.setting.law(p), list[Real]()
        for hz, size in zip(self.hz, self._rounding, strict=True):
            arm = Arm(small[0] * law.resonance_hz, small[1] * law.damping, 0.0, law.gear_fraction).response(hz)
            found.append(size * np.abs(_gain(hz, v["resonance"], v["bend"], v["droop"]) * arm) ** 2)
        return found


def moved_ramps(ramps: Sequence[Ramp], p: Real, law: GearLaw) -> list[Complex]:
    """Spectra of the simulated acceleration of each ramp; those of one step are simulated side by side."""
    found: dict[int, Complex] = {}
    for step_s in {ramp.motion.step_s for ramp in ramps}:
        alike = [i for i, ramp in enumerate(ramps) if ramp.motion.step_s == step_s]
        motions = np.empty((len(alike), 2, max(ramps[i].motion.rigid.shape[1] for i in alike)))
        for i, motion in zip(alike, motions, strict=True):
            made = ramps[i].motion.with_error(p[ramps[i].setting.waves])
            motion[:, : made.shape[1]], motion[:, made.shape[1] :] = made, made[:, -1:]
        records = np.concatenate([law.record(*ramps[i].began(p)) for i in alike])
        for i, acceleration in zip(alike, follow_alike(records, motions, step_s), strict=True):
            found[i] = ramps[i].spectrum(acceleration[: ramps[i].motion.rigid.shape[1] // 2 + 1])
    return [found[i] for i in range(len(ramps))]
