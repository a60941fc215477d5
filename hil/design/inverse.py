"""Inverse of the loop: set-points that make the motor follow a sine.

The sine is chosen so that the gear does not feel its error.

Where Δθ_m = −N θ_sync the torsion ψ = θ_m/N + θ_sync − θ_l is smooth, so neither gear nor arm takes part: the motor moves
as if it were alone, A = J_m s² + D_m s, and the law has to give τ = A Δθ_m. With C_v = K_vp + K_vi/s, filter F_n and hold H

    F_n H C_v (K_pp (Δθ_ref − Δθ_m) − F_lp s Δθ_m) = A Δθ_m
    Δθ_ref/Δθ_m = 1 + (F_lp s + A/(F_n H C_v))/K_pp.

Of the plant only J_m and D_m appear in it; the arm's resonance does not. With a torque offset (60B2h) Δτ = A Δθ_m the law does
not act, and none of its filters matters:

    Δθ_ref/Δθ_m = 1 + F_lp s/K_pp.

At 12 Hz and K_pp = 25/s either is about 3, 70° to 76° ahead. It grows with the frequency, and the speed of the set-points with
its square, up to where the axis' speed limit has no room for it, though the motor itself is hardly faster. The torque offset
alone does the same with no set-point at all, by the torque that the law would have made of it,

    Δτ = K_pp F_n H C_v Δθ_ref = (A + F_n H C_v (K_pp + F_lp s)) Δθ_m.

A gear that transmits with an error reacts with it: beside τ_g/N its torque τ_g loads the motor with τ_g dθ_sync/dθ_m, since what
goes in as power comes out. Vibration makes none of it where the error is cancelled, but gravity and acceleration do: τ_g changes
as slowly as the posture, and its reaction is a sine of each order, which set-point or torque have to hold up against.

The addition turns the very angle at which the error is read, so
there are mixed waves beside the orders (`hil.design.counter_motion`): without them 0.5 % of the error would be left where
N A_k is 3 mrad, and 5 % where it is 30 mrad.
"""

import cmath
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.cancellation_table import ARRAYS, IMAGES, CancellationTable, MotorLoad, WaveLabel
from hil.design.counter_motion import counter_motion
from hil.design.frequency import TIP_HZ, Loop

Actuation = Literal["reference", "torque", "torque alone"]
"""Inputs of the loop that move the motor: the set-point alone, a torque offset with it, or the torque offset alone."""

STEP_RPS = 0.05
"""Accuracy: step of a table's speeds: 0.2 Hz of order 4, a tenth of the width of a resonance of 12 Hz with ζ = 0.08."""
CHIRP_STEP_HZ = 0.1
"""Accuracy: step of the second derivative by the frequency: 6 % of it, and 0.1 % of a correction at 4 rev/s²."""
LEAST_RPS = 1e-4
"""Accuracy: the speed that stands for 0, where 1/s has no value."""
Orders = tuple[tuple[float, float], ...]
"""Pairs of an order and its value."""


@dataclass(frozen=True)
class CyclicTiming:
    """Delays over the bus from measured angle to effect of the addition.

    The angle is sampled at a SYNC; the set-point that follows from it comes into force at the next one and is reached a period T
    later, at the last of the drive's own periods T_c: 2 T − T_c. A torque offset acts at once and stands for T: 1.5 T on average.

    Attributes:
        sync_period_s: SYNC period T.
        control_period_s: Control period T_c of the drive.
        delay_s: Delay of set-points beyond that, where a drive or a bus has more.
    """

    sync_period_s: float
    control_period_s: float
    delay_s: float = 0.0

    def reference(self, frequency_hz: Real) -> Complex:
        """Gain of a linearly interpolated sampled sine at the law's input.

        Shape of `frequency_hz`.
        """
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 2.0 * self.sync_period_s - self.control_period_s + self.delay_s
        # interpolated at m instants: (sin(πfT)/(m sin(πfT/m)))², which is sinc² where m is large
        steps = max(1, round(self.sync_period_s / self.control_period_s))
        shape = (np.sinc(frequency * self.sync_period_s) / np.sinc(frequency * self.sync_period_s / steps)) ** 2
        return np.asarray(shape * np.exp(-2j * math.pi * frequency * late))

    def torque(self, frequency_hz: Real) -> Complex:
        """Gain of a held sampled sine at the motor.

        Shape of `frequency_hz`.
        """
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 1.5 * self.sync_period_s + self.delay_s
        return np.asarray(np.sinc(frequency * self.sync_period_s) * np.exp(-2j * math.pi * frequency * late))


@dataclass(frozen=True)
class InnerTiming:
    """Delays inside a drive that computes the addition itself.

    The addition acts in the control period in which the drive measures the angle.
    """

    control_period_s: float

    def reference(self, frequency_hz: Real) -> Complex:
        """Gain at the law's input, 1; shape of `frequency_hz`."""
        return np.ones_like(np.asarray(frequency_hz, dtype=np.complex128))

    def torque(self, frequency_hz: Real) -> Complex:
        """Gain at the motor: the hold over the control period.

        Shape of `frequency_hz`.
        """
        frequency = np.asarray(frequency_hz, dtype=np.float64) * self.control_period_s
        return np.asarray(np.sinc(frequency) * np.exp(-1j * math.pi * frequency))


def reference_per_motor_angle(
    loop: Loop, frequency_hz: Real, actuation: Actuation = "reference", speed_rps: float = 0.0, torque_lag_s: float = 0.0
) -> Complex:
    """Gain Δθ_ref/Δθ_m at which the gear feels no error.

    The gain is taken at the law's input; shape of `frequency_hz`.

    Args:
        loop: Law and motor.
        frequency_hz: Frequencies above 0; shape (m,).
        actuation: `torque` where an offset gives the motor's torque, so that the law has none to give; otherwise it has.
        speed_rps: Motor speed, for the filters.

    Raises:
        ValueError: The loop has no K_pp, or neither K_vp nor K_vi.
    """
    gains = loop.cascade
    if gains.position_gain_per_s <= 0.0 or gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad <= 0.0:
        raise ValueError("the loop has no position gain or no velocity gain; a cancellation needs both")
    s = _backward(loop, frequency_hz)
    corner = 2.0 * math.pi * gains.lowpass_hz
    moved = 1.0 + corner * s / (s + corner) / gains.position_gain_per_s
    if actuation != "torque":
        torque = _torque_per_motor_angle(loop, frequency_hz, torque_lag_s)
        moved = moved + torque / torque_per_reference(loop, frequency_hz, speed_rps)
    return np.asarray(moved)


def _torque_per_motor_angle(loop: Loop, frequency_hz: Real, torque_lag_s: float) -> Complex:
    """Torque demand per rad if only the motor moves.

    A (1 + λ s)
    """
    jw = 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)
    motor, _, _ = loop.plant.terms(jw)
    return np.asarray(motor * (1.0 + torque_lag_s * jw))


def made_error(loop: Loop, frequency_hz: float, torque_lag_s: float, covariance: Real) -> float:
    """Standard error of the part of a motion that the motor makes, for set-points alone.

    Re d ln(Δθ_ref/Δθ_m) by J_m, D_m and λ, of which `covariance` is that of the errors; shape (3, 3).
    """
    at = np.array([frequency_hz])
    jw = 2j * math.pi * at
    lagged, motor = 1.0 + torque_lag_s * jw, loop.plant.terms(jw)[0]
    by = np.array([jw**2 * lagged, jw * lagged, motor * jw]) / torque_per_reference(loop, at)
    slope = (by / reference_per_motor_angle(loop, at, torque_lag_s=torque_lag_s)).real[:, 0]
    return math.sqrt(max(float(slope @ covariance @ slope), 0.0))


def torque_per_reference(loop: Loop, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
    """Torque at the motor per rad of set-point, K_pp F_n H C_v.

    Shape of `frequency_hz`.

    Args:
        loop: Law and motor.
        frequency_hz: Frequencies above 0; shape (m,).
    """
    gains, jw = loop.cascade, 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)
    delay = np.exp(-jw * loop.period_s)
    hold = (1.0 - delay) / (jw * loop.period_s) * delay**loop.delay_samples
    law = gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad / _backward(loop, frequency_hz)
    return np.asarray(gains.position_gain_per_s * law * loop.notch_response(frequency_hz, speed_rps) * hold)


def _backward(loop: Loop, frequency_hz: Real) -> Complex:
    """Laplace variable s of the sampled law, by the bilinear rule."""
    delay = np.exp(-2j * math.pi * np.asarray(frequency_hz, dtype=np.float64) * loop.period_s)
    return np.asarray(2.0 / loop.period_s * (1.0 - delay) / (1.0 + delay))


class _Image(NamedTuple):
    """Image of a sampled sine: its frequency, and the motor's motion by it for each rad of the sine; shapes (speeds,)."""

    frequency_hz: Real
    motion: Complex


@dataclass(frozen=True)
class Way:
    """Inputs that move the motor, and the demand on each.

    Attributes:
        loop: Law, motor and filters.
        timing: Delays of the additions.
        actuation: `reference`: by the set-point alone; `torque`: with a torque offset; `torque alone`: by it.
        torque_lag_s: Lag of the current loop λ: A (1 + λ s) takes A's place.
        speed_rps: Motor speeds, for the filters; shape (speeds,).
    """

    loop: Loop
    timing: CyclicTiming | InnerTiming
    actuation: Actuation
    torque_lag_s: float
    speed_rps: Real
    _kept: dict[bytes, list[_Image]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def reference_per_motion(self, frequency_hz: Real) -> Complex:
        """Set-point for each rad of the motor; shape (speeds,)."""
        if self.actuation == "torque alone":
            return np.zeros(len(frequency_hz), dtype=np.complex128)
        return np.asarray(self._inverse(frequency_hz) / self.timing.reference(frequency_hz))

    def image_per_motion(self, frequency_hz: Real) -> Complex:
        """Motion by each image of what is sampled, for each rad; shape (`IMAGES`, speeds).

        At a SYNC an image looks like its sine.
        """
        found = [] if self.actuation == "torque" else self._images(frequency_hz)  # where both act nothing is allowed for
        return np.array([each.motion for each in found] or np.zeros((len(IMAGES), len(frequency_hz))), dtype=np.complex128)

    def worth(self, frequency_hz: Real) -> Real:
        """Part of a sine whose cancellation leaves the least at the tip; shape (speeds,).

        With a part w the tip keeps (1 − w) H(f) and the images w r_m H(f_m), H being the arm's response and r_m the motion of an
        image: w = |H|²/(|H|² + Σ |r_m H(f_m)|²).
        """
        shaken = np.abs(self._arm(frequency_hz)) ** 2
        images = [np.abs(each.motion * self._arm(each.frequency_hz)) ** 2 for each in self._images(frequency_hz)]
        return np.asarray(shaken / (shaken + sum(images, np.zeros(len(frequency_hz)))))

    def _arm(self, frequency_hz: Real) -> Complex:
        """Arm angle for each rad at the gear's output."""
        _, arm, gear = self.loop.plant.terms(2j * math.pi * frequency_hz)
        return np.asarray(gear / (arm + gear))

    def _images(self, frequency_hz: Real) -> list[_Image]:
        """Images of a sine that is sampled; waves share frequencies."""
        key = frequency_hz.tobytes()
        if key not in self._kept:
            self._kept[key] = list(self._imaged(frequency_hz))
        return self._kept[key]

    def _imaged(self, frequency_hz: Real) -> Iterator[_Image]:
        """Compute the images.

        Between two SYNCs interpolated set-points, and a held torque, have all frequencies f − m/T too.
        """
        if isinstance(self.timing, InnerTiming):
            return
        ways = [replace(self, actuation="reference"), replace(self, actuation="torque alone")]
        made = [self.reference_per_motion(frequency_hz), self.torque_per_motion(frequency_hz)]
        for image in IMAGES:
            there = frequency_hz - image / self.timing.sync_period_s
            at, motion = np.maximum(np.abs(there), LEAST_RPS), np.zeros(len(frequency_hz), dtype=np.complex128)
            for way, sampled in zip(ways, made, strict=True):
                if np.any(sampled):
                    gain = way.reference_per_motion(at) if way.actuation == "reference" else way.torque_per_motion(at)
                    motion += sampled / np.where(there < 0.0, np.conj(gain), gain)
            yield _Image(at, motion)

    def torque_per_motion(self, frequency_hz: Real) -> Complex:
        """Torque offset for each rad of the motor; shape (speeds,)."""
        if self.actuation == "reference":
            return np.zeros(len(frequency_hz), dtype=np.complex128)
        if self.actuation == "torque":
            wanted = _torque_per_motor_angle(self.loop, frequency_hz, self.torque_lag_s)
        else:
            wanted = self._law(frequency_hz) * self._inverse(frequency_hz)
        return np.asarray(wanted / self.timing.torque(frequency_hz))

    def reference_per_torque(self, frequency_hz: Real) -> Complex:
        """Set-point per N·m at the motor; shape (speeds,).

        It is 0 if a torque offset gives the torque.
        """
        if self.actuation != "reference":
            return np.zeros(len(frequency_hz), dtype=np.complex128)
        return np.asarray(self._lead(frequency_hz) / self._law(frequency_hz) / self.timing.reference(frequency_hz))

    def torque_per_torque(self, frequency_hz: Real) -> Complex:
        """Torque offset per N·m at the motor; shape (speeds,).

        It is 0 if the set-point gives the torque.
        """
        if self.actuation == "reference":
            return np.zeros(len(frequency_hz), dtype=np.complex128)
        return np.asarray(self._lead(frequency_hz) / self.timing.torque(frequency_hz))

    def _lead(self, frequency_hz: Real) -> Complex:
        """Demand on the current loop per N·m."""
        return np.asarray(1.0 + 2j * math.pi * self.torque_lag_s * frequency_hz)

    def _inverse(self, frequency_hz: Real) -> Complex:
        """Δθ_ref/Δθ_m with the filters that act at each speed."""
        loop, way, lag_s = self.loop, self.actuation, self.torque_lag_s
        if way == "torque" or not loop.notches:
            return reference_per_motor_angle(loop, frequency_hz, way, torque_lag_s=lag_s)
        pairs = zip(frequency_hz, self.speed_rps, strict=True)
        return np.array([reference_per_motor_angle(loop, np.array([f]), way, float(v), lag_s)[0] for f, v in pairs])

    def _law(self, frequency_hz: Real) -> Complex:
        """Torque per rad of set-point, with the filters of each speed."""
        if not self.loop.notches:
            return torque_per_reference(self.loop, frequency_hz)
        pairs = zip(frequency_hz, self.speed_rps, strict=True)
        return np.array([torque_per_reference(self.loop, np.array([f]), float(v))[0] for f, v in pairs])


def cancellation_table(
    loop: Loop,
    amplitude_rad: Mapping[float, float],
    phase_rad: Mapping[float, float],
    timing: CyclicTiming | InnerTiming,
    max_rps: float,
    actuation: Actuation = "reference",
    highest_hz: float = TIP_HZ,
    most_rad_s2: float = 0.0,
    torque_lag_s: float = 0.0,
    load: MotorLoad | None = None,
) -> CancellationTable:
    """Compute the cancellation table of one axis.

    Each wave c of Δθ_m has the gain G(f_m) = c (Δθ_ref/Δθ_m)/(gain of the bus); for an order c = −N A_k.

    Args:
        amplitude_rad: Amplitude A_k at the arm, by order.
        phase_rad: Phase φ_k, by order.
        max_rps: Highest motor speed of the table; beyond it the last values stay.
        highest_hz: Highest k f_m at which an order is cancelled.
        most_rad_s2: Largest acceleration of the motor at which its chirp is allowed for.
        load: Gear torque that reacts on the motor; None if it does not.

    Raises:
        ValueError: There is nothing to cancel, or the loop has no gain.
    """
    if not amplitude_rad or not max_rps > 0.0:
        raise ValueError(
            f"there is nothing to cancel: orders {sorted(amplitude_rad)}, up to {max_rps:g} rev/s; at least one order and a "
            "speed above 0 are needed"
        )
    return _table(
        loop, tuple(amplitude_rad.items()), tuple(phase_rad.items()), timing, max_rps, actuation, highest_hz, most_rad_s2,
        torque_lag_s, load,
    )  # fmt: skip


@lru_cache(maxsize=8)
def _table(
    loop: Loop, amplitudes: Orders, phases: Orders, timing: CyclicTiming | InnerTiming, max_rps: float, actuation: Actuation,
    highest_hz: float, most_rad_s2: float, torque_lag_s: float, load: MotorLoad | None,
) -> CancellationTable:  # fmt: skip
    """The table, which a run and its trial ask for again and again."""
    amplitude_rad, phase_rad = dict(amplitudes), dict(phases)
    turning = np.maximum(np.arange(math.ceil(max_rps / STEP_RPS) + 2) * STEP_RPS, LEAST_RPS)
    at_motor = {order: loop.plant.reduction_ratio * size for order, size in amplitude_rad.items()}
    # a filter that follows the motor has no response of its own to a chirp
    bends = float(most_rad_s2 > 0.0 and not loop.notches)
    way = Way(loop, timing, actuation, torque_lag_s, turning)
    # an order fades towards the highest frequency, and where its images shake the arm; so does every wave that comes from it
    faded = {
        k: np.clip((highest_hz - k * turning) / (0.2 * highest_hz), 0.0, 1.0) * way.worth(k * turning) for k in amplitude_rad
    }
    labels: list[WaveLabel] = []
    rows: dict[str, list[Complex]] = {name: [] for name in ARRAYS}
    for wave in counter_motion(at_motor, phase_rad):
        k, frequency = wave.order, wave.order * turning
        left = np.prod([faded[order] for order in wave.sources], axis=0) * (frequency <= highest_hz)
        is_own = wave.degree == 1
        if not is_own:
            left = left * way.worth(frequency)
        size, phase = (-abs(wave.coefficient), phase_rad[k]) if is_own else cmath.polar(wave.coefficient)
        # τ_g dθ_sync/dθ_m for each N·m of τ_g
        slope = left * (1j * k * amplitude_rad[k] if load is not None and is_own else 0.0)
        labels.append(WaveLabel(k, phase, wave.degree, wave.sources))
        made = np.abs(size * left)
        rows["motion"].append(made)
        rows["asked"].append(made)
        rows["image"].append(made * way.image_per_motion(np.maximum(frequency, LEAST_RPS)))
        rows["reference"].append(size * left * way.reference_per_motion(frequency))
        rows["torque"].append(size * left * way.torque_per_motion(frequency))
        rows["bend"].append(bends * size * left * _chirp(way.reference_per_motion, frequency, k))
        rows["torque_bend"].append(bends * size * left * _chirp(way.torque_per_motion, frequency, k))
        rows["load_reference"].append(slope * way.reference_per_torque(frequency))
        rows["load_torque"].append(slope * way.torque_per_torque(frequency))
    arrays: dict[str, Any] = {name: np.stack(given, axis=-2) for name, given in rows.items()}
    return CancellationTable(tuple(labels), STEP_RPS, most_rad_s2=most_rad_s2, motor_load=load, **arrays)


def _chirp(gain: Callable[[Real], Complex], frequency_hz: Real, order: float) -> Complex:
    """Change of a gain per rad/s² of the motor, −(j/2) k d²G/dω².

    Shape of `frequency_hz`.

    The sine e^{jφ(t)} was e^{j(φ − ω τ + k α τ²/2)} a time τ ago, and ∫ g(τ) τ² e^{−jωτ} dτ = −d²G/dω².
    """
    middle = np.maximum(frequency_hz, 2.0 * CHIRP_STEP_HZ)
    bent = gain(middle + CHIRP_STEP_HZ) - 2.0 * gain(middle) + gain(middle - CHIRP_STEP_HZ)
    return np.asarray(-0.5j * order * bent / (2.0 * math.pi * CHIRP_STEP_HZ) ** 2)
