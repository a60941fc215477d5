"""Transmission error, gear and sensor delay by maximum likelihood, the arm simulated on its gear.

For given unknowns p the arm is simulated along the measured motor (`gear`). The residual of each ramp, e = y − ŷ(p), has the
spectrum E(f), whose bins are independent and complex normal with the variance n S(f):

    −log L = Σ |E|²/(n S) + log S,      S = s² + q² Q(f; p) + τ² V(f)

s² is the sensor's variance, q² Q the encoder's noise as it passes through the arm, and τ² V the part of the vibration that the
model misses. The unknowns have normal priors. Fisher's scoring finds p, and the curvature there is its covariance; s, q and τ
maximise the likelihood in between.

For p itself the determinant is left out: the encoder's noise is one of the regressor θ_m, and the motor's true motion is unknown.
Its most likely value given θ_m and y leaves Σ |E|²/(n S) alone, as in Deming's regression. With the determinant, p would draw
towards an arm that passes less of the encoder's noise.

Sources: P. Whittle, Estimation and information in stationary time series, Arkiv för Matematik 2 (1953); W. A. Fuller, Measurement
Error Models, Wiley 1987, section 1.3.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from hil.control.angles import ARCSEC
from hil.control.arrays import Complex, Real
from hil.design.ate.gear import GearLaw
from hil.design.ate.gear_ramp import (
    BEGINNING,
    FACTORS,
    GEAR_FROM,
    OF_IMAGES,
    OF_ROUNDING,
    SHARED,
    Ramp,
    Setting,
    moved_ramps,
    thinning,
)
from hil.design.ate.gravity import Weight
from hil.design.ate.identification import ARM_KEYS, DELAY_KEY, SPRING_MISS, JointEstimate, missed, polar
from hil.design.ate.misfit import LEAST_MISSED
from hil.design.ate.model import BAND, Arm, Sensing, Sweep
from hil.design.ate.rest import STILL_ROOM
from hil.design.ate.ripple import Ripple
from hil.design.estimate import Estimate
from hil.design.frequency import MOUNTING_HZ, RESONANCE_BAND
from hil.design.modes.problem import LARGEST_ZETA, SMALLEST_ZETA
from hil.design.plant_problem import SMOOTHED_LINES
from hil.design.transmission_error import TransmissionError

LARGEST_ENCODER = 13.0
"""Bound: an encoder's noise over its rounding's q²/12: one count rms beside it, more than any data sheet allows."""
SCORING_STEPS = 8
"""Accuracy: steps in a round of scoring, most of them: 12 change nothing."""
SEARCHING, FINISHING = (2, 1.0), (4, 0.01)
"""Accuracy: rounds of scoring and noise from each gear and from the best, and the gain in log-likelihood below which a step or
round is the last: a move by 1.4 standard errors, or by 0.14."""
ADDITIVE = ("softness", "hysteresis")
"""Unknowns whose exponential scales a torque. Where the ramps show none of it, the gradient pulls the logarithm down, and the
curvature contains that pull: d²/dx² f(eˣ) = df/dx for a proportional f. Without it, Fisher's scoring oversteps."""
RINGING_RAD = 100.0 * ARCSEC
"""Standard deviation of the ringing with which a ramp begins; on a drawn robot of 7 Hz (10139) it was 30″."""
DELAY_LEFT_OPEN_S = 5e-6
"""Measured: least error of Δ: on the fifth of the robots 50401 to 50600 that stated the least, 7 µs, it was off by 11 µs
(rms)."""
MOST_MISS = 0.1
"""Measured: part of a vibration that a gear may miss: on robot 10116 one that missed 5 % had A_k right to 4 %, the linear arm 80
to 120 % too large."""
MOST_DAMPED = 1e7
"""Accuracy: Marquardt's damping of the shortest step that is tried, 1e-7 of Gauss and Newton's."""
SIZES = {
    "resonance": 1e-3, "damping": 0.02, "gear_fraction": 0.2, "bend": 1e-3, "droop": 1e-3, "delay": 1e-4, "dispersion": 0.01,
    **dict.fromkeys(OF_IMAGES, 0.05),
    "softness": 0.05, "wind_up": 0.05, "hysteresis": 0.05, "hysteresis_torsion": 0.05, "cosine": 0.3, "sine": 0.3,
}  # fmt: skip
"""Steps of the slopes by each unknown: where the signal changes by a per cent or less."""
LINEAR = {
    "softness": math.log(1e-6), "wind_up": math.log(60.0 * ARCSEC), "hysteresis": math.log(1e-6 * ARCSEC),
    "hysteresis_torsion": math.log(20.0 * ARCSEC),
}  # fmt: skip
"""A linear gear, of which these are no unknowns."""
OF_LAW = ("resonance", "damping", *LINEAR, "cosine", "sine")
"""Those on which f_a and ζ of a vibration depend."""
GEARS = (
    LINEAR,
    {"softness": math.log(0.15), "hysteresis": math.log(5.0 * ARCSEC)},
    {"softness": math.log(0.3), "hysteresis": math.log(0.5 * ARCSEC)},
    {"softness": math.log(0.03), "hysteresis": math.log(10.0 * ARCSEC)},
)
"""Gears from which the search starts: a linear one, a soft one with friction, one that is soft alone, and one with friction
alone.

The last two are tried where the best of the others misses more of the vibration than a spring does (`SPRING_MISS`)."""


@dataclass(frozen=True)
class Prior:
    """Normal prior of an unknown."""

    mean: float
    sigma: float


def priors(weight: Weight, resonance_hz: float) -> dict[str, Prior]:
    """Priors of the shared unknowns.

    The gear's torsions are a factor of 2 wide, softness and friction one of 20 and 55, around the middle of the gears that the
    emulator draws. Its part of ζ is 0.55 to 0.9: as the delay does, it turns the phase in proportion to the frequency, so the
    ramps hardly tell it; with a standard deviation of 0.58, learning on a drawn robot (50202) left 0.026 instead of 0.005 mm.
    The sensor's mounting and its filter of order 2 resonate above or below 110 Hz, one as likely as the other: the filter's gain
    falls as 1 − ½ (f/f_c)⁴.

    Args:
        resonance_hz: A resonance near the arm's own.
    """
    return {
        "resonance": Prior(math.log(resonance_hz), 1.0),
        "damping": Prior(math.log(0.035), 1.0),
        "gear_fraction": Prior(1.2, 1.0),
        "delay": Prior(0.01, 0.02),
        "bend": Prior(0.0, (resonance_hz / MOUNTING_HZ) ** 2),
        "droop": Prior(0.0, 0.5 * (resonance_hz / MOUNTING_HZ) ** 4),
        "dispersion": Prior(0.0, math.sqrt(2.0) / 3.0 * (resonance_hz / MOUNTING_HZ) ** 3),
        **dict.fromkeys(OF_IMAGES, Prior(0.0, 0.5)),
        "softness": Prior(math.log(0.1), 3.0),
        "wind_up": Prior(math.log(60.0 * ARCSEC), 0.7),
        "hysteresis": Prior(math.log(5.0 * ARCSEC), 4.0),
        "hysteresis_torsion": Prior(math.log(20.0 * ARCSEC), 0.7),
        "cosine": Prior(weight.values_rad_s2[0], weight.errors_rad_s2[0]),
        "sine": Prior(weight.values_rad_s2[1], weight.errors_rad_s2[1]),
    }


@dataclass
class _Noise:
    """s², q² over the rounding's, and τ²."""

    sensor: float
    encoder: float = 1.0
    miss: float = LEAST_MISSED**2


@dataclass(frozen=True)
class GearEstimate:
    """Unknowns with their covariance.

    Attributes:
        mean: Unknowns, `SHARED` first, then A_k cos φ_k and A_k sin φ_k of each order in rad.
        torsion_rad: Largest amplitude of the gear's torsion in the ramps.
        arm: f_a in Hz and ζ of a vibration of that amplitude, as a function of the unknowns.
        postures_hz: Standard deviation of f_a between the arm angles of the ramps.
        noise: s² in (m/s²)² of a sample of the thinned recordings, q² over that of rounding, and τ².
    """

    mean: Real
    covariance: Real
    orders: tuple[float, ...]
    law: GearLaw
    torsion_rad: float
    arm: Callable[[Real], Real]
    postures_hz: float
    noise: _Noise

    @property
    def is_true(self) -> bool:
        """True if the gear explains the vibration."""
        return self.noise.miss <= MOST_MISS**2

    @property
    def miss(self) -> float:
        """Part τ of the vibration that the model misses."""
        return math.sqrt(self.noise.miss)

    def values(self) -> Estimate:
        """A_k, φ_k, the sensor's delay, f_a and ζ; the missed part may be a shift by τ rad of the arm's vibration."""
        count, delay = 2 * len(self.orders), SHARED.index("delay")
        hz, damping = self.arm(self.mean).tolist()
        slopes = np.eye(len(self.mean))[[*range(len(SHARED), len(SHARED) + count), delay, delay, delay]]
        slopes[-2:] = self._slopes_of_arm()
        square = slopes @ self.covariance @ slopes.T
        square[:count, :count] += missed(self.mean[len(SHARED) :][:count], np.full(len(self.orders), self.miss))
        left_open = [
            math.hypot(self.miss / (2.0 * math.pi * hz), DELAY_LEFT_OPEN_S),
            math.hypot(self.miss * damping * hz, self.postures_hz),
            self.miss * damping,
        ]
        square[count:, count:] += np.diag(left_open) ** 2
        mean = np.concatenate([self.mean[len(SHARED) :][:count], [self.mean[delay], hz, damping]])
        return polar(self.orders, mean, square, (DELAY_KEY, *ARM_KEYS))

    def _slopes_of_arm(self) -> Real:
        """Slopes of f_a and ζ by every unknown."""
        slopes = np.zeros((2, len(self.mean)))
        for name in OF_LAW:
            step = np.zeros(len(self.mean))
            step[SHARED.index(name)] = SIZES[name]
            slopes[:, SHARED.index(name)] = (self.arm(self.mean + step) - self.arm(self.mean - step)) / (2.0 * SIZES[name])
        return slopes


class GearFit:
    """The likelihood of some ramps.

    Args:
        sweeps: Ramps in both directions.
        sensing: The kind of signal: that of an accelerometer.
        start: An arm near the true one.
        error: A transmission error near the true one.
    """

    def __init__(
        self,
        sweeps: Sequence[Sweep],
        reduction_ratio: float,
        sensing: Sensing,
        start: Arm,
        error: TransmissionError,
        weight: Weight,
    ) -> None:
        hz = start.resonance_hz
        top = 0.45 / max(each.period_s for each in sweeps)
        self.orders = tuple(error.amplitude_arcsec)
        band = (GEAR_FROM * hz, min(BAND[1] * hz, top))
        self._setting = Setting(reduction_ratio, sensing.gain, self.orders, band, Ripple.of(sweeps, self.orders, hz, band[1]))
        first = len(SHARED) + 2 * len(self.orders)
        every = thinning(sweeps, self._setting)
        self._ramps = [Ramp(each, self._setting, first + len(BEGINNING) * i, every) for i, each in enumerate(sweeps)]
        self._priors = priors(weight, hz)
        given = {
            "resonance": math.log(hz), "damping": math.log(start.damping), "delay": start.delay_s, "bend": start.bend,
        }  # fmt: skip
        shared = [given.get(name, self._priors[name].mean) for name in SHARED]
        waves = []
        for order in self.orders:
            size, phase = error.amplitude_arcsec[order] * ARCSEC, math.radians(error.phase_deg[order])
            waves += [size * math.cos(phase), size * math.sin(phase)]
        ramps, begun = len(sweeps), len(BEGINNING) * len(sweeps)
        self._small, self._is_linear = (1.0, 1.0), False
        self._arm_rad = np.concatenate([each.motor_angle_rad[each.direction != 0] for each in sweeps]) / reduction_ratio
        self.start = np.array(shared + waves + [0.0] * begun)
        weights, sizes = [3.0, *[1.0 / RINGING_RAD**2] * 2], [0.05, *[0.2 * ARCSEC] * 2]
        known = [1.0 / self._priors[name].sigma ** 2 for name in SHARED]
        self._known = np.array(known + [0.0] * len(waves) + weights * ramps)
        self._mean = np.array([self._priors[name].mean for name in SHARED] + [0.0] * (len(waves) + begun))
        self._size = np.array([SIZES[name] for name in SHARED] + [0.2 * ARCSEC] * len(waves) + sizes * ramps)
        self._is_gears = np.array([name in LINEAR for name in SHARED] + [False] * (len(waves) + begun))

    # -- the likelihood ------------------------------------------------------------------------------------------------

    @property
    def _weight(self) -> Real:
        """Reciprocal variance of every unknown's prior; 0 without a prior, and for what a linear gear does not have."""
        return np.where(self._is_gears & self._is_linear, 0.0, self._known)

    def _left(self, p: Real) -> tuple[list[list[Complex]], list[Complex]]:
        """Residual spectra of every ramp's parts, and the simulated spectra."""
        spectra = moved_ramps(self._ramps, p, self._setting.law(p))
        return [self._of(ramp, spectrum, p) for ramp, spectrum in zip(self._ramps, spectra, strict=True)], spectra

    @staticmethod
    def _of(ramp: Ramp, moved: Complex, p: Real) -> list[Complex]:
        return [seen - shown for seen, shown in zip(ramp.seen, ramp.shown(moved, p), strict=True)]

    def _small_motion(self, p: Real, moved: list[Complex]) -> tuple[float, float]:
        """Factors of f_a and ζ for a motion as small as the encoder's rounding, beside all else that the gear does."""
        if self._is_linear:
            return 1.0, 1.0
        law = self._setting.law(p)
        power = [ramp.shaken(p, law, each) for ramp, each in zip(self._ramps, moved, strict=True)]
        seen = np.concatenate([part for each in power for part in each])

        def cost(x: Real) -> float:
            small = (math.exp(x[0]), math.exp(x[1]))
            q = np.concatenate([part for ramp in self._ramps for part in ramp.rounding(p, small)])
            return float(np.sum(seen / q + np.log(q)))

        # without bounds, ζ falls to 0 where the ramps shake nothing near the resonance
        low, high = np.log([RESONANCE_BAND, (SMALLEST_ZETA / law.damping, LARGEST_ZETA / law.damping)]).T
        found = scipy.optimize.minimize(
            cost,
            np.clip(np.log(self._small), low, high),
            method="Nelder-Mead",
            bounds=scipy.optimize.Bounds(low, high),
            options={"xatol": 1e-3, "fatol": 1e-2},
        )
        return float(math.exp(found.x[0])), float(math.exp(found.x[1]))

    def _variances(self, p: Real, noise: _Noise, vibration: list[list[Real]]) -> list[list[Real]]:
        return [
            [noise.sensor + noise.encoder * q + noise.miss * v for q, v in zip(ramp.rounding(p, self._small), each, strict=True)]
            for ramp, each in zip(self._ramps, vibration, strict=True)
        ]

    def _vibration(self, p: Real, left: list[list[Complex]]) -> list[list[Real]]:
        """Smoothed power of the vibration that θ_sync makes, per sample."""
        still = p.copy()
        still[self._setting.waves] = 0.0
        made, window = [], np.ones(SMOOTHED_LINES) / SMOOTHED_LINES
        without, _ = self._left(still)
        for ramp, one, other in zip(self._ramps, left, without, strict=True):
            powers = [np.abs(a - b) ** 2 / n for a, b, n in zip(one, other, ramp.counts, strict=True)]
            made.append([np.convolve(each, window, "same") for each in powers])
        return made

    def _cost(self, p: Real, left: list[list[Complex]], variances: list[list[Real]]) -> float:
        """What scoring lowers: the determinant is left out, as errors of a regressor demand (Deming's regression)."""
        total = 0.5 * float(np.sum(self._weight * (p - self._mean) ** 2))
        for ramp, each, every in zip(self._ramps, left, variances, strict=True):
            for spectrum, s, n in zip(each, every, ramp.counts, strict=True):
                total += float(np.sum(np.abs(spectrum) ** 2 / (n * s)))
        return total

    def _noise(self, p: Real, left: list[list[Complex]], vibration: list[list[Real]], before: _Noise | None) -> _Noise:
        """The noise that maximises the likelihood."""
        parts = [zip(each, ramp.counts, strict=True) for ramp, each in zip(self._ramps, left, strict=True)]
        power = np.concatenate([np.abs(spectrum) ** 2 / n for part in parts for spectrum, n in part])
        rounding = np.concatenate([q for ramp in self._ramps for q in ramp.rounding(p, self._small)])
        shaken = np.concatenate([v for each in vibration for v in each])
        low = float(np.median(power)) / math.log(2.0)
        most = max(min([1e3 * low, *(STILL_ROOM * ramp.still for ramp in self._ramps)]), 1e-5 * low)

        def cost(x: Real) -> float:
            s = math.exp(x[0]) + math.exp(x[1]) * rounding + math.exp(x[2]) * shaken
            return float(np.sum(power / s + np.log(s)))

        start = before or _Noise(low, 1.0, 1e-4)
        limits = ((1e-6 * low, most), (1.0, LARGEST_ENCODER), (LEAST_MISSED**2, 1.0))
        bounds = [(math.log(least), math.log(most)) for least, most in limits]
        given = np.log([min(start.sensor, most), start.encoder, start.miss])
        found = scipy.optimize.minimize(cost, given, method="L-BFGS-B", bounds=bounds)
        return _Noise(*np.exp(found.x).tolist())

    def _slopes(self, p: Real, moved: list[Complex]) -> list[list[Complex]]:
        """Slopes of what the sensor shows by every unknown: a row each, per ramp and part."""
        steps, law, shared = np.tile(p, (len(p), 1)), self._setting.law(p), range(len(SHARED))
        steps[range(len(p)), range(len(p))] += self._size
        has_images = bool(self._setting.ripple.waves)
        nothing = {c for c in shared if (SHARED[c] in OF_IMAGES and not has_images) or (SHARED[c] in LINEAR and self._is_linear)}
        factors = {SHARED.index(name) for name in FACTORS}
        waves = range(self._setting.waves.start, self._setting.waves.stop)
        of_law = [c for c in shared if c not in nothing | factors]
        laws = [self._setting.law(steps[c]) for c in of_law] + [law] * len(BEGINNING)
        found = []
        for ramp, spectrum in zip(self._ramps, moved, strict=True):
            alike = [*of_law, *range(ramp.own.start, ramp.own.stop)]
            after = dict(zip(alike, ramp.moved_alike(steps[alike], laws), strict=True))
            after |= zip(waves, ramp.moved_alike(steps[waves], [law] * len(waves)), strict=True)
            after |= dict.fromkeys(factors - nothing, spectrum)
            before = ramp.shown(spectrum, p)
            columns = list(after)
            slopes = [np.zeros((len(p), len(at)), at.dtype) for at in before]
            for rows, there, at in zip(slopes, ramp.shown_alike(list(after.values()), steps[columns]), before, strict=True):
                rows[columns] = (there - at) * (1.0 / self._size[columns, np.newaxis])
            found.append(slopes)
        return found

    def _curvature(
        self, p: Real, left: list[list[Complex]], moved: list[Complex], variances: list[list[Real]], noise: _Noise
    ) -> tuple[Real, Real]:
        """Fisher's information with the priors', and minus the gradient of the cost."""
        square = np.diag(np.where(self._is_gears & self._is_linear, 1.0, self._weight))
        downhill = -self._weight * (p - self._mean)
        slopes = self._slopes(p, moved)
        columns = [SHARED.index(name) for name in OF_ROUNDING]
        additive = [SHARED.index(name) for name in ADDITIVE]
        pulled = np.zeros(len(additive))
        turned = {}
        for column in columns:
            step = p.copy()
            step[column] += self._size[column]
            turned[column] = [ramp.rounding(step, self._small) for ramp in self._ramps]
        for i, ramp in enumerate(self._ramps):
            now = ramp.rounding(p, self._small)
            for j, n in enumerate(ramp.counts):
                s, jacobian, e = variances[i][j], slopes[i][j], left[i][j]
                conjugate, scaled = jacobian.conj(), e / (n * s)
                square += 2.0 * (jacobian * (1.0 / (n * s)) @ conjugate.T).real
                downhill += 2.0 * (conjugate @ scaled).real
                pulled += 2.0 * (conjugate[additive] @ scaled).real
                logs = np.stack([noise.encoder * (turned[c][i][j] - now[j]) / self._size[c] / s for c in columns])
                downhill[columns] += logs @ (np.abs(e) ** 2 / (n * s))
        square[additive, additive] += np.maximum(0.0, -pulled)
        return square, downhill

    # -- the fit -------------------------------------------------------------------------------------------------------

    def run(self) -> GearEstimate:
        """The most likely unknowns, and their covariance."""
        found: list[_State] = []
        for gear in GEARS:
            if found and not self._is_linear and min(found, key=lambda each: each.evidence).noise.miss <= SPRING_MISS**2:
                break
            self._is_linear = gear is LINEAR
            found.append(self._climbed(self._from(gear), *SEARCHING))
        best = min(found, key=lambda each: each.evidence)
        self._is_linear = best is found[0]
        made = self._climbed(best.p, *FINISHING)
        scale = 1.0 / np.sqrt(np.diag(made.square))
        covariance = np.linalg.inv(made.square * np.outer(scale, scale)) * np.outer(scale, scale)
        law, torsion_rad = self._setting.law(made.p), self._largest_torsion(made)

        def arm(p: Real) -> Real:
            return np.array(self._setting.law(p).arm_at(torsion_rad, self._arm_rad))

        # f = √K/2π, so that df = dK/(8 π² f)
        spread_hz = float(np.std(law.posture_stiffness(self._arm_rad))) / (8.0 * math.pi**2 * law.resonance_hz)
        return GearEstimate(made.p, covariance, self.orders, law, torsion_rad, arm, spread_hz, made.noise)

    def _largest_torsion(self, made: "_State") -> float:
        """Largest amplitude of the torsion in the ramps, of the simulated vibration in the band."""
        omega = 2.0 * math.pi * self._setting.law(made.p).resonance_hz
        return max(ramp.largest(moved) for ramp, moved in zip(self._ramps, made.moved, strict=True)) / omega**2

    def _from(self, gear: Mapping[str, float]) -> Real:
        """The start with the values of a gear."""
        p = self.start.copy()
        for name, value in gear.items():
            p[SHARED.index(name)] = value
        return p

    def _climbed(self, p: Real, rounds: int, least_gain: float) -> "_State":
        """Rounds of scoring and noise from some unknowns.

        Args:
            least_gain: Gain in log-likelihood below which a step or a round is the last.
        """
        left, moved = self._left(p)
        noise, vibration = self._noise_at(p, left, moved, None)
        began = math.inf
        for _ in range(rounds):
            state = self._scored(p, left, moved, vibration, noise, least_gain)
            p, left, moved = state.p, state.left, state.moved
            noise, vibration = self._noise_at(p, left, moved, noise)
            variances = self._variances(p, noise, vibration)
            cost = self._cost(p, left, variances) + sum(float(np.sum(np.log(s))) for each in variances for s in each)
            if began - cost < least_gain:
                break
            began = cost
        known = self._weight[self._weight > 0.0]
        evidence = cost + 0.5 * (np.linalg.slogdet(state.square)[1] - float(np.sum(np.log(known))))
        return replace(state, noise=noise, cost=cost, evidence=evidence)

    def _noise_at(
        self, p: Real, left: list[list[Complex]], moved: list[Complex], before: _Noise | None
    ) -> tuple[_Noise, list[list[Real]]]:
        """The noise that maximises the likelihood, and the vibration's power."""
        vibration = self._vibration(p, left)
        self._small = self._small_motion(p, moved)
        return self._noise(p, left, vibration, before), vibration

    def _scored(
        self,
        p: Real,
        left: list[list[Complex]],
        moved: list[Complex],
        vibration: list[list[Real]],
        noise: _Noise,
        least_gain: float,
    ) -> "_State":
        """Fisher's scoring with damped steps, the noise held."""
        variances = self._variances(p, noise, vibration)
        cost, damped = self._cost(p, left, variances), 1e-3
        for _ in range(SCORING_STEPS):
            square, downhill = self._curvature(p, left, moved, variances, noise)
            while damped < MOST_DAMPED:
                trial = p + np.linalg.solve(square + damped * np.diag(np.diag(square)), downhill)
                left_t, moved_t = self._left(trial)
                variances_t = self._variances(trial, noise, vibration)
                cost_t = self._cost(trial, left_t, variances_t)
                if cost_t < cost:
                    break
                damped *= 8.0
            else:
                return _State(p, left, moved, noise, cost, square)
            gained, damped = cost - cost_t, max(1e-6, damped * 0.2)
            p, left, moved, variances, cost = trial, left_t, moved_t, variances_t, cost_t
            if gained < least_gain:
                break
        return _State(p, left, moved, noise, cost, square)


@dataclass(frozen=True)
class _State:
    """Unknowns with what follows from them.

    The evidence is minus the logarithm of the likelihood with all unknowns integrated out (Laplace), but for a constant: it tells
    whether a gear is worth its additional unknowns.
    """

    p: Real
    left: list[list[Complex]]
    moved: list[Complex]
    noise: _Noise
    cost: float
    square: Real
    evidence: float = math.inf


def on_its_gear(
    estimate: JointEstimate, sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, weight: Weight | None
) -> JointEstimate:
    """An estimate with A_k, φ_k and the delay of the simulated gear.

    The estimate stays as it is if the arm has several modes or an unknown weight, or no gear explains its vibration.
    Without the weight, a soft gear's fit has several minima.

    Args:
        estimate: Estimate with a linear arm, from which the fit starts.
        sensing: The kind of signal: that of an accelerometer.
        weight: Weight of the arm; None if it is not known.
    """
    if estimate.arm.others or weight is None:
        return estimate
    try:
        found = GearFit(sweeps, reduction_ratio, sensing, estimate.arm, estimate.error, weight).run()
    except np.linalg.LinAlgError:
        return estimate
    if not (np.all(np.isfinite(found.mean)) and np.all(np.diag(found.covariance) > 0.0) and found.is_true):
        return estimate
    return replace(
        estimate,
        values=found.values(),
        miss=found.miss,
        structured=found.noise.miss,
        gear=found.law,
        torsion_rad=found.torsion_rad,
    )
