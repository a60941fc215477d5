"""Fit of a plant to spectra.

The module computes what the motor felt and did, the scatter, and the residual as a function of the unknowns.

Y* and U* are what the plant did and felt, made from what was sampled with the SYNC (period T) while the drive's law runs at T_c:

    U* = (D H_d + (U − D e^{−jωT} − Σ F_k) e^{jωδ} sinc(f T_c)) H_c,        Y* = Y − Σ Y_k

The offset is held over a period, H_d = (1 − e^{−jωT})/(jωT), but is sampled at its very end; the loop's own part is younger:
δ ≥ 0 is how old the torque is that the drive reports, half a control period if it reports the present one, and refined by the
fit. At the resonance the two nearly cancel, which is why a single delay for both will not do. What a drive reports is in
general the demand, and the motor feels it behind the current loop, H_c = 1/(1 + jω T_i): T_i ≥ 0 is an unknown too, since a
tenth of a millisecond of it looks like 6 % of motor inertia. F_k and Y_k are the T/T_c − 1 images of the held excitation at
f + k/T, which fold onto the line; they are computed from the fitted plant and the law's gains. The law samples the angle with
T_c, which folds f_k + m/T_c onto f_k: there the motor moves alone.

An accelerometer has a delay δ_a, and a low-pass or a mounting that resonates: gain g exp(−jωδ_a − j d (ω/ω_κ)³)/(1 − κ (ω/ω_κ)²),
used around f_a only.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real
from hil.control.cascade import Cascade
from hil.design.estimation import FAR_SIGMAS, UnidentifiableError
from hil.design.frequency import AnyComplex, Loop, TwoInertia
from hil.design.plant_spectra import Lines, Spectra

AGE_PRIOR_S = 3e-4
"""Bound: standard deviation of the age of the reported torque before the fit, about a control period where that is not known.
Where it is, the age is half of it ± half: of the period's beginning, or of the one before."""
LAG_PRIOR_S = 1e-3
"""Bound: standard deviation of the current loop's time constant, before the fit: real ones have 0.1 to 1 ms."""
TILT_HZ = 40.0
"""Bound: frequency at which the accelerometer's tilt is stated: beyond the resonances of most arms."""
TILT_PRIOR = 0.15
"""Accuracy: standard deviation of the accelerometer's change of gain at `TILT_HZ`, before the fit: 0.13 shifts the plant by a
twentieth of a standard error."""
DISPERSION_PRIOR = math.sqrt(2.0) / 3.0 * TILT_PRIOR**1.5
"""Standard deviation of what the accelerometer's phase at `TILT_HZ` has beyond a delay: that of a low-pass with such a tilt.

A Butterworth low-pass of the second order with the limit f_g turns the phase by √2/3 (f/f_g)³ more than a delay."""
TIP_BAND = (0.5, 1.6)
"""Band in which the tip is used, over f_a. A factor of 2 in either end changes 0.7, and errors by a factor of 2; with the whole
of `RESONANCE_BAND`, f_a was less certain with an accelerometer than without in each of four draws."""
LARGEST_LAG_S, LARGEST_TIP_DELAY_S = 5e-3, 0.05
"""Bound: time constant of a current loop, and delay of an accelerometer, that the fit accepts."""
LEAST_TIP_DELAY_S = 2e-3
"""Bound: delay of an accelerometer: what D_l leads by is the only thing that could make it come early."""
LEAST_LAG_S = 1e-4
"""Bound: time constant of a current loop: a fit begins at half of it, and is held below five of them at first."""
LEVER_RATIO = 2.0
"""Measured: factor by which the lever seen may differ from the bench file's before it is another axis' or another sensor: 0.978
to 1.013 on 14 drawn robots (10700, 10712, 10730, 10735, 10740 to 10749)."""
OUTSIDE = 1.1
"""Measured: largest ratio of a resonance to the highest frequency of the excitation, further out only its flank shows it: 0.31 to
0.87 on 14 drawn robots (10700, 10712, 10730, 10735, 10740 to 10749)."""
TRIED = 16
"""Accuracy: anti-resonances that are tried as a start: a factor of 2 changes nothing."""
OTHER_RESONANCES, OTHER_BY = 8, 0.08
"""Accuracy: resonances that are tried beside a fit's, and the least distance from it, as a logarithm: a factor of 2 changes
nothing."""
HIDDEN_FROM = 0.2
"""Accuracy: resonance over the rate of the SYNC from which images may hide it: a factor of 2 changes nothing, nor does 0, which
takes a third more time."""
GUESSES = 3
"""Accuracy: first guesses that are followed: a factor of 2 changes nothing."""
LARGEST_CHANGE = 3.0
"""Accuracy: change, as a logarithm, of an inertia, stiffness, damping or lever in one round: a factor of 2 changes 0.014."""
MODEL_ERROR, TIP_ERROR = 5e-4, 1e-3
"""Accuracy: parts of the motor's and the tip's motion that the model leaves open, counts, holds and Runge-Kutta steps, without
scatter: a factor of 2 changes 0.08 and 0.02, errors by 5 %."""
LAW_OPEN = 0.02
"""Accuracy: part of the motor's motion that the law's gains do not foretell, filters of a drive that no bench file names: a
factor of 2 changes 0.4, errors by 30 %."""
IMAGE_ERROR = 0.5
"""Accuracy: standard deviation of the sensor's gain where images are, and of each image about it, since it is not known there: a
factor of 2 changes 0.19, errors by 7 %."""
SMOOTHED_LINES = 5
"""Accuracy: lines over which a power is averaged before it weighs, since that of one line is too uncertain alone: a factor of 2
changes 0.5, errors by 18 %."""


@dataclass(frozen=True)
class SamplingTiming:
    """Sampling times of a measurement, and the law inside the drive.

    Attributes:
        sync_s: Time T between two samples and two set-points.
        control_s: Control period T_c of the drive's law; 0 if it is not known.
        kind: Input to which the excitation is added: `torque`, which is held, or `reference`, which is interpolated.
        law: The drive's gains, for the images; None leaves them out.
    """

    sync_s: float
    control_s: float
    kind: Literal["torque", "reference"]
    law: Cascade | None


J_M, J_L, K_G, DAMPING, VISCOUS, AGE, ARM_PART, LAG, LEVER, DELAY, TILT, DISPERSION, BEYOND, TURNED = range(14)
"""Unknowns: ln J_m, ln J_l, ln K_g, ln (D_g + D_l), D_m + D_l/N², δ, D_l/(D_g + D_l), T_i; with an accelerometer ln g, δ_a, κ,
d, and the sensor's gain where images are, 1 + b ± jc."""


KEPT = 32
"""Accuracy: responses that are kept, for time alone: of a point and of a step by each unknown of the plant."""


@dataclass(frozen=True)
class _Responses:
    """Responses of a plant at the lines, and without gravity where images are.

    Attributes:
        angle: Motor angle per torque.
        arm: Arm angle per motor angle, as the tip shows it; zeros without an accelerometer.
        image_angle: The same as `angle` at the frequencies of the images.
        image_arm: The same as `arm` there.
    """

    angle: Complex
    arm: Complex
    image_angle: Complex
    image_arm: Complex


@dataclass(frozen=True)
class _Closed:
    """Closed loop at the lines and their images; without gravity.

    The shape is (1 + images, lines), unless stated.

    Attributes:
        alone: What the law samples besides: the motor's own motion beyond half of the law's rate.
        passed: Change of the sampled motor angle by one of its response.
        continuous: Motor angle at the images; shape (images, lines).
        torque: Reported torque there.
        of_angle: Images in the sampled motor angle; shape (lines,).
        foretold: Sampled motor angle; shape (lines,).
    """

    motion: Complex
    alone: Complex
    acting: Complex
    passed: Complex
    continuous: Complex
    torque: Complex
    of_angle: Complex
    foretold: Complex


@dataclass(frozen=True)
class _Folding:
    """Frequencies that fold onto the lines, and the lines themselves.

    The lines come first; every array has the shape (1 + images, lines), but for the last two, which leave out the lines.

    Attributes:
        frequency_hz: Frequencies f + k/T.
        jw: Their jω.
        feedback: The law, with its hold.
        drive: Demand of the excitation.
        flat: Inverse of the torque's hold.
        beyond: jω of the next frequencies that the law's own sampling folds onto these; shape (4, 1 + images, lines).
        rigid: Motor angle there, for an inertia of 1, over the torque here.
        square: (jω)² of the images.
        side: Sign of the images' frequencies.
    """

    frequency_hz: Real
    jw: Complex
    feedback: Complex
    drive: Complex
    flat: Real
    beyond: Complex
    rigid: Complex
    square: Complex
    side: Real


class PlantProblem:
    """Data of the fit, and its residual by the unknowns."""

    def __init__(self, data: Spectra, timing: SamplingTiming, reduction_ratio: float, lever_m: float, gravity: float) -> None:
        self.data, self.timing, self.ratio, self.lever_m = data, timing, reduction_ratio, lever_m
        self.gravity = gravity
        self.jw = 2j * math.pi * data.frequency_hz
        self._square, tilted = self.jw**2, data.frequency_hz / TILT_HZ
        self._tilted_square, self._tilted_cube = tilted**2, tilted**3
        self.excitation = data.excitation.mean(axis=0)
        self._measured = tuple(each.mean(axis=0) for each in (data.angle, data.torque))
        self._tip = None if data.tip is None else data.tip.mean(axis=0)
        self._flat = np.sinc(data.frequency_hz * timing.control_s)
        self._held = (1.0 - np.exp(-self.jw * timing.sync_s)) / (self.jw * timing.sync_s)
        self._period = np.exp(-self.jw * timing.sync_s)
        self._folded = self._folding()
        self.scatter = Scatter.of(data.angle, data.torque, data.waves)
        self.tip_scatter = None if data.tip is None else Scatter.of(data.tip, data.angle, data.waves)
        self._tip_lines = np.arange(len(self.jw))
        self._aside = [AGE, LAG] if data.tip is None else [AGE, LAG, LEVER, DELAY, TILT, DISPERSION, BEYOND, TURNED]
        self._responses = lru_cache(KEPT)(self._computed)
        self._alone, self._delays = lru_cache(1)(self._lone), lru_cache(KEPT)(self._delayed)
        self._loops = lru_cache(KEPT)(self._closed)

    def _computed(self, plant: bytes) -> _Responses:
        """Responses of the unknowns of a plant, as bytes."""
        x, lines = np.frombuffer(plant), self.data.frequency_hz
        none = np.zeros((0, len(lines)), dtype=np.complex128)
        images = None if self._folded is None else self._folded.frequency_hz
        has_tip = self.data.tip is not None
        return _Responses(
            self.angle_per_torque(x, lines, self.gravity),
            self.arm_per_motor(x, lines, self.gravity) if has_tip else np.zeros_like(self.jw),
            none if images is None else self.angle_per_torque(x, images, 0.0),
            none if images is None or not has_tip else self.arm_per_motor(x, images, 0.0),
        )

    def _of(self, x: Real) -> _Responses:
        """Responses of the unknowns' plant, which age, lag and the accelerometer do not change."""
        plant = np.array(x, dtype=np.float64)
        plant[self._aside] = 0.0
        return self._responses(plant.tobytes())

    def _loop(self, x: Real) -> _Closed:
        """Closed loop, which neither age nor accelerometer change."""
        point = np.array(x, dtype=np.float64)
        point[[each for each in self._aside if each != LAG]] = 0.0
        return self._loops(point.tobytes())

    def _closed(self, point: bytes) -> _Closed:
        """Closed loop of the unknowns, as bytes."""
        x, folded = np.frombuffer(point), self._folded
        assert folded is not None  # noqa: S101 - asked for where there is a law
        motion = self._of(x).image_angle / (1.0 + folded.jw * x[LAG])
        # what moves beyond half of the law's rate is sampled too; there the motor moves alone
        alone = self._alone(float(x[LAG])) / math.exp(x[J_M])
        sampled = motion + alone
        left = 1.0 + folded.feedback * sampled
        acting = folded.drive / left
        moved = sampled * acting
        asked = -folded.feedback * moved if self.timing.kind == "torque" else acting
        return _Closed(
            motion,
            alone,
            acting,
            acting / left,
            (motion * acting)[1:],
            (asked * folded.flat)[1:],
            moved[1:].sum(axis=0),
            moved[0],
        )

    def _lone(self, lag_s: float) -> Complex:
        """Motor angle beyond half of the law's rate, for an inertia of 1; shape (1 + images, lines)."""
        assert self._folded is not None  # noqa: S101 - asked for where there is a law
        return np.asarray((self._folded.rigid / (1.0 + self._folded.beyond * lag_s)).sum(axis=0))

    def _delayed(self, delay_s: float) -> tuple[Complex, Complex]:
        """e^{−jωδ} at the lines and at the frequencies of the images."""
        images = np.zeros_like(self.jw) if self._folded is None else self._folded.jw[1:]
        return np.exp(-self.jw * delay_s), np.exp(-images * delay_s)

    def _folding(self) -> "_Folding | None":
        """Parts of the images that depend on law and times only."""
        law, sync, control = self.timing.law, self.timing.sync_s, self.timing.control_s
        count = round(sync / control) if control > 0.0 else 0
        if law is None or count == 0:
            return None
        fold = np.array([0, *(k for k in range(-(count // 2), count - count // 2) if k)])[:, np.newaxis]
        frequency = self.data.frequency_hz + fold / sync
        jw = 2j * math.pi * frequency
        beyond = np.stack([jw + 2j * math.pi * sign / control for sign in (-2.0, -1.0, 1.0, 2.0)])
        still = TwoInertia(self.ratio, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0)  # the law does not ask for the plant
        feedback = Loop(still, law, (), control).controller(frequency)
        if self.timing.kind == "torque":
            drive = self.excitation * (1.0 - np.exp(-jw * sync)) / (jw * sync)
        else:
            wanted = self.excitation * straight_line(frequency, sync, control)
            drive = _reference_path(law, jw, control) * wanted
        return _Folding(
            frequency,
            np.asarray(jw, dtype=np.complex128),
            feedback,
            np.asarray(drive, dtype=np.complex128),
            1.0 / np.sinc(frequency * control),
            np.asarray(beyond, dtype=np.complex128),
            np.asarray(jw / beyond**3, dtype=np.complex128),
            np.asarray(jw**2, dtype=np.complex128)[1:],
            np.sign(frequency)[1:],
        )

    # -- what the plant felt and did -----------------------------------------------------------------------------------

    def images(self, x: Real) -> tuple[Complex, Complex, Complex, Complex]:
        """Compute the images at the lines, and the predicted motor angle.

        Returns the images in the torque, F_k, in the motor angle, Y_k, and at the tip, and the motor angle that the law
        predicts.

        Images are summed over k; all of shape (lines,). With a SYNC of 4 ms they are as large as what they lie on, so that they
        take part in every step of the fit.
        """
        folded = self._folded
        if folded is None:
            none = np.zeros_like(self.excitation)
            return none, none, none, none
        loop = self._loop(x)
        reported = (loop.torque * self._delays(float(x[AGE]))[1]).sum(axis=0)
        tip = np.zeros_like(self.excitation)
        if self.data.tip is not None:
            sensed = (1.0 + float(x[BEYOND]) + 1j * float(x[TURNED]) * folded.side) * self._sensed(x, folded)
            tip = (self._of(x).image_arm[1:] * sensed * loop.continuous).sum(axis=0)
        return np.asarray(reported), loop.of_angle, np.asarray(tip), loop.foretold

    def _sensed(self, x: Real, folded: _Folding) -> Complex:
        """Tip acceleration per arm angle at the images, for a sensor with the gain that it has at the lines."""
        return np.asarray(self._lever_m(x) * folded.square * self._delays(float(x[DELAY]))[1])

    def _image_slopes(self, x: Real) -> tuple[Complex, Complex, Complex, Complex]:
        """Slopes of `images` by the unknowns; each of shape (unknowns, lines)."""
        folded, by = self._folded, np.zeros((4, len(x), len(self.jw)), dtype=np.complex128)
        if folded is None:
            return by[0], by[1], by[2], by[3]
        loop, late = self._loop(x), self._delays(float(x[AGE]))[1]
        slow, demanded = 1.0 / (1.0 + folded.jw * x[LAG]), folded.feedback * loop.passed
        # what comes of a change of the sampled motion, and of one of the motor's motion beside that
        of_sampled = [(-demanded * folded.flat)[1:] * late, loop.passed[1:]]
        of_motion = [np.zeros_like(late), np.zeros_like(late)]
        of_angle, of_arm = self.shapes(x, folded.jw, 0.0)
        by_angle, by_arm = self.by_shapes(x)
        if self.data.tip is not None:
            sensed = self._sensed(x, folded)
            gain = 1.0 + float(x[BEYOND]) + 1j * float(x[TURNED]) * folded.side
            arm = self._of(x).image_arm[1:]
            shown = arm * sensed * loop.continuous
            of_motion.append(arm * sensed * gain * loop.acting[1:])
            of_sampled.append(-arm * sensed * gain * (loop.motion * demanded)[1:])
            by[2] = by_arm @ np.einsum("kl,bkl->bl", sensed * gain * loop.continuous, of_arm[:, 1:])
            by[2, LEVER], by[2, DELAY] = (shown * gain).sum(axis=0), -(folded.jw[1:] * shown * gain).sum(axis=0)
            by[2, BEYOND], by[2, TURNED] = shown.sum(axis=0), 1j * (folded.side * shown).sum(axis=0)
        sampled, motion = np.stack(of_sampled), np.stack(of_motion)
        by[: len(sampled)] += np.tensordot(
            by_angle, np.einsum("okl,bkl->bol", (sampled + motion) * slow[1:], of_angle[:, 1:]), 1
        ).swapaxes(0, 1)
        by[3] = by_angle @ (of_angle[:, 0] * loop.passed[0] * slow[0])
        by[0, AGE] -= (folded.jw[1:] * loop.torque * late).sum(axis=0)
        lagged = -folded.jw * slow * loop.motion
        beyond = 1.0 + folded.beyond * x[LAG]
        of_lag = lagged - (folded.rigid * folded.beyond / beyond**2).sum(axis=0) / math.exp(x[J_M])
        for unknown, change in ((J_M, -loop.alone), (LAG, of_lag)):
            by[: len(sampled), unknown] += (sampled * change[1:]).sum(axis=1)
            by[3, unknown] += loop.passed[0] * change[0]
        by[: len(motion), LAG] += (motion * lagged[1:]).sum(axis=1)
        return by[0], by[1], by[2], by[3]

    def torque(self, x: Real, torque: Complex, image: Complex) -> Complex:
        """Torque demand on the current loop, from the reported torque.

        Shape (…, lines).
        """
        late = self._delays(-float(x[AGE]))[0] * self._flat
        corrected = (torque - image) * late
        if self.timing.kind == "reference":
            return np.asarray(corrected)
        return np.asarray(self.excitation * (self._held - self._period * late) + corrected)

    def felt(self, x: Real) -> Complex:
        """Response of the current loop, H_c; shape (lines,)."""
        return np.asarray(1.0 / (1.0 + self.jw * x[LAG]))

    # -- unknowns ------------------------------------------------------------------------------------------------------

    def first_guesses(self) -> list[Real]:
        """List the starts of the fit, the likeliest first."""
        none = np.zeros_like(self.excitation)
        torque = self.torque(np.array([0.0] * AGE + [0.5 * self.timing.control_s]), self._measured[1], none)
        response = self._measured[0] / torque
        guesses: list[Real] = []
        try:
            guesses = [self.start(guess) for guess in first_guesses(response, self.data.frequency_hz, self.ratio)]
        except UnidentifiableError:
            if self._folded is None:
                raise
        return guesses if self._folded is None else [*guesses[:2], *self._tried()]

    def _tried(self) -> list[Real]:
        """Try many plants and return the likeliest one or two."""
        low = slice(0, max(2, len(self.jw) // 20))
        unlagged = np.array([0.0] * AGE + [0.5 * self.timing.control_s])
        felt = self.torque(unlagged, self._measured[1], np.zeros_like(self.excitation))
        whole = float(np.median(np.abs(felt[low] / (self._measured[0][low] * self.jw[low] ** 2))))
        tried: list[tuple[float, float, Real]] = []
        for f_a in np.geomspace(1.2 * self.data.frequency_hz[0], 0.9 * self.data.frequency_hz[-1], TRIED).tolist():
            for arms in (0.6, 1.3, 2.5, 4.5):
                for total in (0.6 * whole, whole, 1.7 * whole):
                    motor, arm = total / (1.0 + arms), self.ratio**2 * total * arms / (1.0 + arms)
                    stiffness = (2.0 * math.pi * f_a) ** 2 * arm
                    damping = math.log(0.08 * stiffness / (2.0 * math.pi * f_a))
                    x = self.start(np.array([math.log(motor), math.log(arm), math.log(stiffness), damping, 3.0 * motor]))
                    tried.append((float(np.sum(np.log1p(np.abs(self.residual(x))))), f_a, x))
        tried.sort(key=lambda each: each[0])
        best = tried[0]
        other = next((each for each in tried if abs(math.log(each[1] / best[1])) > 0.25), None)
        return [best[2]] if other is None else [best[2], other[2]]

    def beside(self, x: Real) -> list[Real]:
        """List starts beside a fit, the likeliest first.

        Where a slow SYNC's images lie over the peak of the response, f_r has minima of its own; elsewhere there are no starts.
        """
        plant, tried = self.plant(x), []
        f_a, f_r = plant.antiresonance_hz, plant.resonance_hz
        if self._folded is None or f_r * self.timing.sync_s < HIDDEN_FROM:
            return []
        whole = plant.motor_inertia_kg_m2 + plant.arm_inertia_kg_m2 / self.ratio**2
        for other in np.geomspace(1.15 * f_a, max(1.2 * f_a, 1.1 * self.data.frequency_hz[-1]), OTHER_RESONANCES).tolist():
            motor = whole * (f_a / other) ** 2
            more = math.log(self.ratio**2 * (whole - motor) / plant.arm_inertia_kg_m2)
            moved = self.start(np.array([math.log(motor), x[J_L] + more, x[K_G] + more, x[DAMPING] + more, x[VISCOUS]]))
            moved[LEVER:] = x[LEVER:]
            if abs(math.log(other / f_r)) > OTHER_BY:
                tried.append((float(np.sum(np.log1p(np.abs(self.residual(moved))))), moved))
        tried.sort(key=lambda each: each[0])
        return [moved for _, moved in tried[:2]]

    def with_other_delay(self, x: Real) -> list[Real]:
        """List the same unknowns with a likelier delay of the accelerometer.

        Around f_a alone the phase of a delay comes back after a period, so that a fit may end a period, or a part of one, away.
        The allowed errors of images grow with the lever, so that a lever that has run away explains any tip: if it is off by more
        than `LEVER_RATIO`, a start with the bench file's lever is tried too. The list may be empty.
        """
        if self.data.tip is None or not len(self._tip_lines):
            return []
        likeliest = self._with_likeliest_delay(x)
        found = [] if likeliest is x else [likeliest]
        if abs(x[LEVER]) > math.log(LEVER_RATIO):
            found.append(self._with_likeliest_delay(np.concatenate([x[:LEVER], self.start(x[:AGE])[LEVER:]])))
        return found

    def _with_likeliest_delay(self, x: Real) -> Real:
        """Unknowns with the likeliest delay of the accelerometer, which may be their own."""
        tenth_s = 0.1 / self.data.frequency_hz[self._tip_lines[-1]]
        tried = [x]
        for delay_s in np.arange(-LEAST_TIP_DELAY_S, LARGEST_TIP_DELAY_S, tenth_s).tolist():
            moved = x.copy()
            moved[DELAY] = delay_s
            tried.append(moved)
        return min(tried, key=lambda each: float(np.sum(np.log1p(np.abs(self.residual(each))))))

    def start(self, guess: Real) -> Real:
        """Complete the unknowns from a guess of the first five."""
        more = [0.5 * self.timing.control_s, 0.1, 0.5 * LEAST_LAG_S]
        return np.concatenate([guess, more, [] if self.data.tip is None else [0.0, 1e-3, 0.0, 0.0, 0.0, 0.0]])

    def resumed(self, unknowns: Real) -> Real:
        """Start where another run's fit ended, with its accelerometer if both runs have one."""
        fresh = self.start(unknowns[: VISCOUS + 1])
        return unknowns if len(unknowns) == len(fresh) else fresh

    def is_inside(self, x: Real) -> bool:
        """True if both resonances are in the band, or little above it."""
        plant, frequency = self.plant(x), self.data.frequency_hz
        return bool(frequency[0] < plant.antiresonance_hz < frequency[-1] and plant.resonance_hz < OUTSIDE * frequency[-1])

    def bounds(self, x: Real, *, are_times_held: bool = False) -> tuple[Real, Real]:
        """Bounds of one round of the fit around x."""
        low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
        for unknown in (J_M, J_L, K_G, DAMPING, LEVER)[: 5 if self.data.tip is not None else 4]:
            low[unknown], high[unknown] = x[unknown] - LARGEST_CHANGE, x[unknown] + LARGEST_CHANGE
        low[AGE], high[AGE] = 0.0, 1e-3
        low[ARM_PART], high[ARM_PART] = 0.0, 1.0
        low[LAG], high[LAG] = 0.0, LARGEST_LAG_S
        if are_times_held:
            middle = 0.5 * self.timing.control_s or AGE_PRIOR_S
            low[AGE], high[AGE], high[LAG] = 0.8 * middle, 1.2 * middle, 5.0 * LEAST_LAG_S
        if self.data.tip is not None:
            low[DELAY], high[DELAY] = -LEAST_TIP_DELAY_S, LARGEST_TIP_DELAY_S
            last = self.data.frequency_hz[self._tip_lines[-1]] if len(self._tip_lines) else TILT_HZ
            low[TILT], high[TILT] = -1.0, 0.9 * (TILT_HZ / last) ** 2
        return low, high

    def scale(self, x: Real) -> Real:
        """Step sizes of the unknowns that have similar effects."""
        sizes = [0.1, 0.1, 0.1, 0.3, max(1e-6, 0.3 * math.exp(x[J_M])), 1e-4, 0.1, 1e-4, 0.1, 1e-3, 0.1, 0.03, 0.1, 0.1]
        return np.array(sizes[: len(x)])

    def focus(self, f_a: float) -> None:
        """Restrict the tip's residuals to lines around an antiresonance."""
        frequency = self.data.frequency_hz
        self._tip_lines = np.flatnonzero((frequency > TIP_BAND[0] * f_a) & (frequency < TIP_BAND[1] * f_a))

    def plant(self, x: Real) -> TwoInertia:
        """Plant of the unknowns."""
        motor, arm, stiffness, damping = np.exp(x[:VISCOUS]).tolist()
        arm_damping = float(x[ARM_PART]) * damping
        return TwoInertia(
            self.ratio,
            motor,
            float(x[VISCOUS]) - arm_damping / self.ratio**2,
            arm,
            arm_damping,
            stiffness,
            damping - arm_damping,
        )

    def shapes(self, x: Real, jw: AnyComplex, gravity_nm_rad: float) -> tuple[Complex, Complex]:
        """What the slopes of `angle_per_torque` and `arm_per_motor` are made of.

        The factors are those of `by_shapes`. Returns arrays of shape (n, …) with the shape of `jw`, n being another for each.
        """
        return slopes_by_terms(self.plant(x), jw, gravity_nm_rad)

    def by_shapes(self, x: Real) -> tuple[Real, Real]:
        """Factors of `shapes` in the slopes by each unknown; shape (unknowns, n)."""
        motor, arm, stiffness, damping = np.exp(x[:VISCOUS]).tolist()
        part, slopes = float(x[ARM_PART]), np.zeros((len(x), 6))
        slopes[J_M, 0], slopes[VISCOUS, 1], slopes[J_L, 2], slopes[K_G, 5] = motor, 1.0, arm, stiffness
        slopes[DAMPING, [1, 3, 4]] = -part * damping / self.ratio**2, part * damping, (1.0 - part) * damping
        slopes[ARM_PART, [1, 3, 4]] = -damping / self.ratio**2, damping, -damping
        return slopes, slopes[:, 2:]

    def angle_per_torque(self, x: Real, frequency_hz: Real, gravity_nm_rad: float) -> Complex:
        """Motor angle per torque of the unknowns' plant; shape of `frequency_hz`."""
        return angle_response(self.plant(x), frequency_hz, gravity_nm_rad)

    def arm_per_motor(self, x: Real, frequency_hz: Real, gravity_nm_rad: float) -> Complex:
        """Arm angle per motor angle of the unknowns' plant; shape of `frequency_hz`."""
        return arm_response(self.plant(x), frequency_hz, gravity_nm_rad)

    def _lever_m(self, x: Real) -> float:
        """Tip lever by which the accelerometer shows the arm."""
        return self.lever_m * math.exp(x[LEVER])

    def left(self, x: Real) -> list[Complex]:
        """Residuals of each kind in standard deviations, E|e|² = 1: of the torque, of the law and of the tip."""
        of_torque, of_angle, of_tip, foretold = self.images(x)
        angle = self._measured[0] - of_angle
        torque = self.torque(x, self._measured[1], of_torque)
        responses = self._of(x)
        model = responses.angle * self.felt(x)
        size = np.abs(model) * (np.abs(torque) + np.abs(of_torque)) + np.abs(of_angle)
        sigma = self.scatter.deviation(model * self._delays(-float(x[AGE]))[0], MODEL_ERROR * size)
        left = [(angle - model * torque) / sigma]
        if self._folded is not None:
            sigma = np.sqrt(self.scatter.output + (LAW_OPEN * np.abs(foretold)) ** 2)
            left.append((angle - foretold) / sigma)
        if self._tip is not None and self.tip_scatter is not None:
            model = responses.arm * self._lever_m(x) * self._square * self._delays(float(x[DELAY]))[0]
            model = model * np.exp(-1j * float(x[DISPERSION]) * self._tilted_cube) / (1.0 - float(x[TILT]) * self._tilted_square)
            sigma = self.tip_scatter.deviation(model, TIP_ERROR * np.abs(model * angle) + IMAGE_ERROR * np.abs(of_tip))
            left.append(((self._tip - of_tip - model * angle) / sigma)[self._tip_lines])
        return left

    def residual(self, x: Real) -> Real:
        """Residuals in standard deviations, real and imaginary parts."""
        stacked = np.concatenate(self.left(x)) * math.sqrt(2.0)  # σ² = E|e|²: half of it in either part
        priors = [value / deviation for _, value, deviation in self._prior_values(x)]
        # the loss makes squares of these
        return np.concatenate([stacked.real, stacked.imag, [each * math.hypot(1.0, 0.5 * each / FAR_SIGMAS) for each in priors]])

    def slopes(self, x: Real) -> Real:
        """Jacobian of the residual; shape (residuals, unknowns)."""
        of_torque, of_angle, of_tip, foretold = self.images(x)
        by_of_torque, by_of_angle, by_of_tip, by_foretold = self._image_slopes(x)
        angle, torque = self._measured[0] - of_angle, self.torque(x, self._measured[1], of_torque)
        responses, felt, late = self._of(x), self.felt(x), self._delays(-float(x[AGE]))[0]
        (of_angle_shapes, of_arm_shapes), (by_angle, by_arm) = self.shapes(x, self.jw, self.gravity), self.by_shapes(x)
        by_torque = -late * self._flat * by_of_torque
        by_torque[AGE] += self.jw * (torque if self.timing.kind == "reference" else torque - self.excitation * self._held)
        model, by_model = responses.angle * felt, by_angle @ of_angle_shapes * felt
        by_model[LAG] -= self.jw * felt * model
        size = np.abs(model) * (np.abs(torque) + np.abs(of_torque)) + np.abs(of_angle)
        by_size = _rise(model, by_model) * (np.abs(torque) + np.abs(of_torque)) + _rise(of_angle, by_of_angle)
        by_size += np.abs(model) * (_rise(torque, by_torque) + _rise(of_torque, by_of_torque))
        gain, by_gain = model * late, by_model * late
        by_gain[AGE] += self.jw * gain
        sigma, by_sigma = self.scatter.slopes(gain, by_gain, MODEL_ERROR * size, MODEL_ERROR * by_size)
        by_left = [_weighed(angle - model * torque, -by_of_angle - by_model * torque - model * by_torque, sigma, by_sigma)]
        if self._folded is not None:
            sigma = np.sqrt(self.scatter.output + (LAW_OPEN * np.abs(foretold)) ** 2)
            by_sigma = LAW_OPEN**2 * np.real(foretold.conj() * by_foretold) / sigma
            by_left.append(_weighed(angle - foretold, -by_of_angle - by_foretold, sigma, by_sigma))
        if self._tip is not None and self.tip_scatter is not None:
            tilted = 1.0 / (1.0 - float(x[TILT]) * self._tilted_square)
            sensor = self._lever_m(x) * self._square * self._delays(float(x[DELAY]))[0] * tilted
            sensor = sensor * np.exp(-1j * float(x[DISPERSION]) * self._tilted_cube)
            model, by_model = responses.arm * sensor, by_arm @ of_arm_shapes * sensor
            by_model[LEVER] += model
            by_model[DELAY] -= self.jw * model
            by_model[TILT] += self._tilted_square * tilted * model
            by_model[DISPERSION] -= 1j * self._tilted_cube * model
            shown, by_shown = model * angle, by_model * angle - model * by_of_angle
            floor = TIP_ERROR * np.abs(shown) + IMAGE_ERROR * np.abs(of_tip)
            by_floor = TIP_ERROR * _rise(shown, by_shown) + IMAGE_ERROR * _rise(of_tip, by_of_tip)
            sigma, by_sigma = self.tip_scatter.slopes(model, by_model, floor, by_floor)
            by_left.append(_weighed(self._tip - of_tip - shown, -by_of_tip - by_shown, sigma, by_sigma)[:, self._tip_lines])
        stacked = np.concatenate(by_left, axis=1) * math.sqrt(2.0)
        by_priors = np.zeros((len(x), self.priors))
        for row, (unknown, value, deviation) in enumerate(self._prior_values(x)):
            far = 0.5 * value / deviation / FAR_SIGMAS
            by_priors[unknown, row] = (1.0 + 2.0 * far**2) / math.hypot(1.0, far) / deviation
        return np.asarray(np.concatenate([stacked.real, stacked.imag, by_priors], axis=1).T)

    def _prior_values(self, x: Real) -> list[tuple[int, float, float]]:
        """Unknowns that are known beforehand, their distances from what is expected, and standard deviations."""
        middle = 0.5 * self.timing.control_s
        known = [(AGE, float(x[AGE]) - middle, middle or AGE_PRIOR_S), (LAG, float(x[LAG]), LAG_PRIOR_S)]
        if self.data.tip is not None:
            of_tip = (TILT, TILT_PRIOR), (DISPERSION, DISPERSION_PRIOR), (BEYOND, IMAGE_ERROR), (TURNED, IMAGE_ERROR)
            known += [(unknown, float(x[unknown]), deviation) for unknown, deviation in of_tip]
        return known

    @property
    def priors(self) -> int:
        """Number of the last residuals that come from priors, not data."""
        return 2 if self.data.tip is None else 6


def first_guesses(response: Complex, frequency_hz: Real, ratio: float) -> list[Real]:
    """Guess the unknowns from dips and peaks of |P| ω².

    Each guess is (ln J_m, ln J_l, ln K_g, ln D_g, D_m); the likeliest comes first.
    """
    omega = 2.0 * math.pi * frequency_hz
    compliance = np.abs(response) * omega**2
    even = np.exp(np.convolve(np.pad(np.log(compliance), 1, "edge"), np.ones(3) / 3.0, "valid"))
    guesses: list[tuple[float, int, Real]] = []
    for dip in np.argsort(even)[:12].tolist():
        if dip >= len(omega) - 3:
            continue
        peak = dip + 1 + int(np.argmax(even[dip + 1 :]))
        w_a, w_r = omega[dip], omega[peak]
        shape = np.abs((1 - (omega / w_a) ** 2 + 0.06j * omega / w_a) / (1 - (omega / w_r) ** 2 + 0.06j * omega / w_r))
        whole = math.exp(float(np.median(np.log(shape / compliance))))
        error = float(np.median(np.abs(np.log(compliance * whole / shape))))
        motor = whole * (w_a / w_r) ** 2
        arm = ratio**2 * (whole - motor)
        stiffness = w_a**2 * arm
        guess = np.array([math.log(motor), math.log(arm), math.log(stiffness), math.log(0.08 * stiffness / w_a), 0.2 * whole])
        guesses.append((error, dip, guess))
    if not guesses:
        raise UnidentifiableError("number of dips of the response within the band", 0.0, 1.0)
    apart: dict[int, Real] = {}
    for _, dip, guess in sorted(guesses, key=lambda each: each[0]):
        if all(abs(dip - other) > 2 for other in apart):
            apart[dip] = guess
    return list(apart.values())[:GUESSES]


def angle_response(plant: TwoInertia, frequency_hz: Real, gravity_nm_rad: float = 0.0) -> Complex:
    """Motor angle per torque, with gravity as a spring on the arm.

    θ_m/τ = (B' + c)/(A (B' + c) + B' c/N²) with B' = B + k
    """
    a, b, c = plant.terms(2j * math.pi * frequency_hz)
    b = b + gravity_nm_rad
    return np.asarray((b + c) / (a * (b + c) + b * c / plant.reduction_ratio**2))


def arm_response(plant: TwoInertia, frequency_hz: Real, gravity_nm_rad: float = 0.0) -> Complex:
    """Arm angle per motor angle.

    θ_l/θ_m = c/(N (B' + c)), gravity as in `angle_response`
    """
    _, b, c = plant.terms(2j * math.pi * frequency_hz)
    return np.asarray(c / (b + gravity_nm_rad + c) / plant.reduction_ratio)


def slopes_by_terms(plant: TwoInertia, jw: AnyComplex, gravity_nm_rad: float) -> tuple[Complex, Complex]:
    """Slopes of the responses by the coefficients of A, B and c.

    Args:
        jw: jω; shape (…).
        gravity_nm_rad: Gravity as in `angle_response`.

    Returns:
        Slopes of the motor angle per torque by those of s² and s in A, of s² and s in B, and of s and 1 in c, shape (6, …), and
        of the arm angle per motor angle by the last four, shape (4, …).
    """
    a, b, c = plant.terms(jw)
    b = b + gravity_nm_rad
    square, arm, gear = jw**2, c / (b + c), b / (b + c)
    of_a = -1.0 / (a + b * arm / plant.reduction_ratio**2) ** 2
    of_b, of_c = of_a * (arm / plant.reduction_ratio) ** 2, of_a * (gear / plant.reduction_ratio) ** 2
    arm_b, arm_c = -arm / (b + c) / plant.reduction_ratio, gear / (b + c) / plant.reduction_ratio
    return (
        np.stack([of_a * square, of_a * jw, of_b * square, of_b * jw, of_c * jw, of_c]),
        np.stack([arm_b * square, arm_b * jw, arm_c * jw, arm_c]),
    )


def _rise(value: Complex, by: Complex) -> Real:
    """Slopes of |value|."""
    return np.asarray(np.real((value / np.maximum(np.abs(value), 1e-300)).conj() * by))


def _weighed(left: Complex, by_left: Complex, sigma: Real, by_sigma: Real) -> Complex:
    """Slopes of left/σ."""
    per_sigma = 1.0 / sigma
    return np.asarray((by_left - left * per_sigma * by_sigma) * per_sigma)


def tip_response(
    plant: TwoInertia, frequency_hz: Real, lever_m: float, delay_s: float = 0.0, gravity_nm_rad: float = 0.0
) -> Complex:
    """Tip acceleration per motor angle.

        L s² θ_l/θ_m e^{−jωδ}, gravity as in `angle_response`

    Args:
        frequency_hz: Frequencies; shape (m,).
        delay_s: Delay δ of the accelerometer.
        gravity_nm_rad: Spring constant k, dM/dθ_l of the gravity moment.
    """
    jw = 2j * math.pi * frequency_hz
    return np.asarray(lever_m * jw**2 * arm_response(plant, frequency_hz, gravity_nm_rad) * np.exp(-jw * delay_s))


def straight_line(frequency_hz: Real, sync_s: float, control_s: float) -> Complex:
    """Reference of a drive per set-point, with linear interpolation.

        (sin πfT / (n sin πfT_c))² with n T_c = T

    The set-point of a SYNC is reached with the last control period before the next. The line has a step in each control period,
    so that its images are those of its samples; of a line without steps they would be smaller.

    Args:
        frequency_hz: Frequencies; any shape.
        sync_s: T.
        control_s: T_c.
    """
    late = np.exp(-2j * math.pi * frequency_hz * (sync_s - control_s))
    return np.asarray(late * (np.sinc(frequency_hz * sync_s) / np.sinc(frequency_hz * control_s)) ** 2)


def _reference_path(law: Cascade, jw: AnyComplex, control_s: float) -> Complex:
    """Torque per reference angle of the bilinear P-PI, held."""
    delay = np.exp(-jw * control_s)
    s = 2.0 / control_s * (1.0 - delay) / (1.0 + delay)
    pi = law.velocity_gain_nm_s_rad + law.velocity_integral_gain_nm_rad / s
    return np.asarray(pi * law.position_gain_per_s * (1.0 - delay) / (jw * control_s))


@dataclass(frozen=True)
class Scatter:
    """Covariances of the mean output and input over the periods.

    They are smoothed over neighbouring lines; shape (lines,).

    Attributes:
        output: Variance E|Δy|² of the output.
        given: Variance E|Δu|² of the input.
        both: Covariance E[Δy Δu*].
    """

    output: Real
    given: Real
    both: NDArray[Any]

    @classmethod
    def of(cls, output: Complex, given: Complex, waves: Lines | None = None) -> "Scatter":
        """Compute the covariances from spectra of shape (periods, lines).

        What comes back with the wave, as rounding to counts and the distortion by a nonlinear gear do, is the same in all of
        its periods. Where the means of several waves scatter more than their periods do, they count, one value for a wave.

        Args:
            waves: Number of the excitation's wave in each period; shape (periods,); None where all have the same.

        Source: R. Pintelon, J. Schoukens, System Identification, 2nd ed. (2012), section 4.3.1, the robust method.
        """
        out, put, count = output - output.mean(axis=0), given - given.mean(axis=0), len(output)
        found = cls._of(out, put, count * (count - 1))
        if waves is None:
            return found
        held = np.unique(waves)[:, np.newaxis] == waves
        apart = cls._of(held @ out / count, held @ put / count, 1.0 - 1.0 / len(held))
        is_apart = apart.output > found.output
        pairs = ((apart.output, found.output), (apart.given, found.given), (apart.both, found.both))
        return cls(*(np.where(is_apart, *pair) for pair in pairs))

    @classmethod
    def _of(cls, out: Complex, put: Complex, count: float) -> "Scatter":
        """Sum of squares and products over the rows, smoothed, over a count."""
        power, other = np.sum(np.abs(out) ** 2, axis=0), np.sum(np.abs(put) ** 2, axis=0)
        return cls(smooth(power) / count, smooth(other) / count, smooth(np.sum(out * put.conj(), axis=0)) / count)

    def deviation(self, gain: Complex, floor: Real) -> Real:
        """Standard deviation of Δy − G Δu; shape (lines,).

            √(E|Δy − G Δu|² + floor²)

        The deviation must follow the gain while that is fitted: under feedback a smaller G would leave less noise in the
        residual, and would be preferred for it.
        """
        variance = self.output + np.abs(gain) ** 2 * self.given - 2.0 * np.real(gain.conj() * self.both)
        return np.asarray(np.sqrt(np.maximum(variance, 1e-9 * self.output + 1e-300) + floor**2))

    def slopes(self, gain: Complex, by_gain: Complex, floor: Real, by_floor: Real) -> tuple[Real, Real]:
        """Standard deviation, and its slopes by the unknowns, shape (unknowns, lines)."""
        sigma = self.deviation(gain, floor)
        varies = sigma**2 > floor**2 + 2e-9 * self.output
        return sigma, (varies * np.real((gain * self.given - self.both).conj() * by_gain) + floor * by_floor) / sigma


def smooth(values: NDArray[Any]) -> NDArray[Any]:
    """Moving average over neighbouring lines, narrower at the ends."""
    width = min(SMOOTHED_LINES, len(values))
    window = np.ones(width)
    return np.asarray(np.convolve(values, window, "same") / np.convolve(np.ones(len(values)), window, "same"))
