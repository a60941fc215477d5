"""Axis and loop in the frequency domain."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_OFF, FixedFilter, Notch, notch_coefficients, notch_weight

AnyComplex = NDArray[np.complexfloating[Any, Any]]

CONTROL_PERIOD_S = 250e-6
"""Bound: sampling time of the loop in the paper's drives: the default where no drive states its own."""
OF_SAMPLING = 0.4
"""Bound: highest frequency over the sampling rate: a held value loses a quarter of it there, and its first image is half as large
as what was asked for."""
LIKELY_DAMPING = 0.03
"""Bound: damping ratio where nothing but the frequency is known: arms on harmonic drives have 0.02 to 0.05."""
TIP_HZ = 60.0
"""Bound: frequency up to which a tip shows anything: arms ring at 4 to 30 Hz, and what filters make beyond has died away at once.
Order 4 is at 40 Hz at 10 rps."""
MOUNTING_HZ = 110.0
"""Accuracy: a sensor's resonance on its mounting, as likely below as above, so its bend at a frequency f is within ±(f/110 Hz)²:
a factor of 2 changes 0.1, errors by 13 %."""
RESONANCE_BAND = (0.4, 2.5)
"""Bound: band, over a resonance f, in which it shows: at 0.4 f the response 1/|1 − r²| is 1.2, at 2.5 f it is 0.2."""


@dataclass(frozen=True)
class TwoInertia:
    """Linear plant of one axis, as in the paper's Fig. 3.

    Gear and arm are on the arm side, the motor is on the motor side.

    Attributes:
        reduction_ratio: Reduction ratio N.
        motor_inertia_kg_m2: Inertia J_m of the motor.
        motor_damping_nm_s_rad: Viscous damping D_m of the motor.
        arm_inertia_kg_m2: Inertia J_l of the arm.
        arm_damping_nm_s_rad: Viscous damping D_l of the arm.
        gear_stiffness_nm_rad: Stiffness K_g of the gear.
        gear_damping_nm_s_rad: Damping D_g of the gear.
    """

    reduction_ratio: float
    motor_inertia_kg_m2: float
    motor_damping_nm_s_rad: float
    arm_inertia_kg_m2: float
    arm_damping_nm_s_rad: float
    gear_stiffness_nm_rad: float
    gear_damping_nm_s_rad: float

    def terms(self, s: AnyComplex) -> tuple[AnyComplex, AnyComplex, AnyComplex]:
        """Terms A, B and c of the equations of motion.

            A = J_m s² + D_m s,    B = J_l s² + D_l s,    c = D_g s + K_g

        Each has the shape of `s`.
        """
        motor = self.motor_inertia_kg_m2 * s**2 + self.motor_damping_nm_s_rad * s
        arm = self.arm_inertia_kg_m2 * s**2 + self.arm_damping_nm_s_rad * s
        return motor, arm, self.gear_damping_nm_s_rad * s + self.gear_stiffness_nm_rad

    def motor_angle_per_torque(self, frequency_hz: Real) -> Complex:
        """Plant P(jω) = θ_m/τ, in rad/(N·m).

        P = (B + c) / (A (B + c) + B c/N²), shape of `frequency_hz`
        """
        a, b, c = self.terms(2j * math.pi * np.asarray(frequency_hz))
        return np.asarray((b + c) / (a * (b + c) + b * c / self.reduction_ratio**2))

    @property
    def antiresonance_hz(self) -> float:
        """Antiresonance f_a of the arm on its gear, motor held, in Hz.

        f_a = √(K_g/J_l)/2π
        """
        return math.sqrt(self.gear_stiffness_nm_rad / self.arm_inertia_kg_m2) / (2.0 * math.pi)

    @property
    def resonance_hz(self) -> float:
        """Resonance f_r = f_a √(1 + J_l/(N² J_m)): motor against arm."""
        return self.antiresonance_hz * math.sqrt(
            1.0 + self.arm_inertia_kg_m2 / (self.reduction_ratio**2 * self.motor_inertia_kg_m2)
        )

    def state_space(self, torque_lag_s: float = 0.0) -> tuple[Real, Real]:
        """Matrices of the state space, from torque to motor and arm.

        ẋ = A x + B τ with A (4, 4) and B (4,)
        x = (θ_m, θ̇_m, N θ_l, N θ̇_l): the arm is referred to the motor.

        Args:
            torque_lag_s: Time constant of the torque behind its demand; if it has one, the torque is a fifth state.
        """
        n2 = self.reduction_ratio**2
        k, d = self.gear_stiffness_nm_rad / n2, self.gear_damping_nm_s_rad / n2
        jm, jl = self.motor_inertia_kg_m2, self.arm_inertia_kg_m2 / n2
        a = np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [-k / jm, -(d + self.motor_damping_nm_s_rad) / jm, k / jm, d / jm],
                [0.0, 0.0, 0.0, 1.0],
                [k / jl, d / jl, -k / jl, -(d + self.arm_damping_nm_s_rad / n2) / jl],
            ]
        )
        b = np.array([0.0, 1.0 / jm, 0.0, 0.0])
        if not torque_lag_s > 0.0:
            return a, b
        lagged = np.zeros((5, 5))
        lagged[:4, :4], lagged[:4, 4], lagged[4, 4] = a, b, -1.0 / torque_lag_s
        return lagged, np.array([0.0, 0.0, 0.0, 0.0, 1.0 / torque_lag_s])


@dataclass(frozen=True)
class Loop:
    """Discrete P-PI loop with its notches around a plant.

    Attributes:
        plant: The axis.
        cascade: The gains.
        notches: The variable filters; which of them act depends on the speed.
        period_s: Sampling time of the loop.
        delay_samples: Whole samples between measurement and torque: 0 inside a drive, 1 over a bus.
        fixed: Filters that act at every speed.
    """

    plant: TwoInertia
    cascade: Cascade
    notches: tuple[Notch, ...] = ()
    period_s: float = CONTROL_PERIOD_S
    delay_samples: int = 0
    fixed: tuple[FixedFilter, ...] = ()

    def filters(self, speed_rps: float) -> list[tuple[float, float, float, float, float]]:
        """Coefficients of the filters that act at a constant motor speed.

        Each filter has (b₀, b₁, b₂, a₁, a₂); the fixed filters come first.
        """
        acting = [(each.b0, each.b1, each.b2, each.a1, each.a2) for each in self.fixed]
        for notch in self.notches:
            if notch.mode == NOTCH_OFF or not notch.start_rps <= speed_rps <= notch.end_rps:
                continue
            weight = notch_weight(notch.mode, speed_rps, notch.start_rps, notch.end_rps, notch.ramp_rps)
            zero_hz = notch.order * speed_rps
            zeta_rd = notch.zeta_rn + weight * (notch.zeta_rdth - notch.zeta_rn)
            pole_hz = zero_hz + weight * notch.offset_hz
            acting.append(notch_coefficients(zero_hz, pole_hz, notch.zeta_rn, zeta_rd, self.period_s))
        return acting

    def notch_response(self, frequency_hz: Real, speed_rps: float) -> Complex:
        """Filters F_n(e^{jωT}) at a constant motor speed; shape of `frequency_hz`."""
        response = np.ones(np.shape(frequency_hz), np.complex128)
        acting = self.filters(speed_rps)
        if not acting:
            return response
        z = np.exp(-2j * math.pi * np.asarray(frequency_hz) * self.period_s)
        for b0, b1, b2, a1, a2 in acting:
            response = response * (b0 + b1 * z + b2 * z**2) / (1.0 + a1 * z + a2 * z**2)
        return np.asarray(response)

    def controller(self, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
        """Controller C(jω) = −τ/θ_m with hold and delay.

        The law is bilinear, the hold is (1 − e^{−jωT})/(jωT); shape of `frequency_hz`.
        """
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        jw = 2j * math.pi * frequency
        delay = np.exp(-jw * self.period_s)
        s = 2.0 / self.period_s * (1.0 - delay) / (1.0 + delay)
        corner = 2.0 * math.pi * self.cascade.lowpass_hz
        pi = self.cascade.velocity_gain_nm_s_rad + self.cascade.velocity_integral_gain_nm_rad / s
        law = pi * (self.cascade.position_gain_per_s + corner * s / (s + corner))
        hold = (1.0 - delay) / (jw * self.period_s)
        return np.asarray(law * self.notch_response(frequency, speed_rps) * hold * delay**self.delay_samples)

    def open_loop(self, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
        """Open loop L(jω) = P C; shape of `frequency_hz`."""
        return self.plant.motor_angle_per_torque(frequency_hz) * self.controller(frequency_hz, speed_rps)

    def arm_per_transmission_error(self, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
        """Gain X(jω) = θ_l/θ_sync with the loop closed.

        X = c M/(M (B + c) + B c) with M = N² (A + C), shape of `frequency_hz`
        """
        a, b, c = self.plant.terms(2j * math.pi * np.asarray(frequency_hz, dtype=np.float64))
        m = self.plant.reduction_ratio**2 * (a + self.controller(frequency_hz, speed_rps))
        return np.asarray(c * m / (m * (b + c) + b * c))

    def acceleration_per_transmission_error(self, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
        """Gain G_al(jω) = (jω)² X(jω), eq. (4), in 1/s²; shape of `frequency_hz`."""
        s2 = (2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)) ** 2
        return np.asarray(s2 * self.arm_per_transmission_error(frequency_hz, speed_rps))

    def peak_hz(self) -> float:
        """Frequency f_al at which |G_al| without notch peaks, around the anti-resonance.

        A loop that damps the arm out leaves no peak: then it is the anti-resonance, since the arm on its gear is what the
        transmission error shakes. The end of the range, 2.4 f_a, would be no frequency of the robot at all.
        """
        low_hz, high_hz = min(4.0, self.plant.antiresonance_hz / 3.0), max(30.0, 2.4 * self.plant.antiresonance_hz)
        grid = np.linspace(low_hz, high_hz, math.ceil((high_hz - low_hz) / 0.01) + 1)
        bare = Loop(self.plant, self.cascade, (), self.period_s, self.delay_samples)
        gain = np.abs(bare.acceleration_per_transmission_error(grid))
        # the inertia line rises with ω², so only an inner maximum is a resonance
        inner = np.flatnonzero((gain[1:-1] > gain[:-2]) & (gain[1:-1] >= gain[2:])) + 1
        if not inner.size:
            return self.plant.antiresonance_hz
        top = grid[inner[np.argmax(gain[inner])]]
        peak = scipy.optimize.minimize_scalar(
            lambda f: -float(np.abs(bare.acceleration_per_transmission_error(np.array([f])))[0]),
            bounds=(top - 0.02, top + 0.02),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return float(peak.x)

    def closed_loop_poles(self, speed_rps: float = 0.0) -> Complex:
        """Closed-loop poles in z with the filters frozen at a motor speed.

        The loop is stable if all poles lie inside the unit circle.

        The plant is discretised exactly (zero-order hold); the law's blocks are kept apart as state-space blocks, since
        the expanded polynomial has a dozen roots near z = 1 and loses its digits there.
        """
        closed = closed_loop(*_held_plant(self.plant, self.period_s), self.law_block(speed_rps))
        return np.asarray(np.linalg.eigvals(closed), dtype=np.complex128)

    def law_block(self, speed_rps: float = 0.0) -> "Block":
        """Law −τ/θ_m as a discrete system, filters frozen at a motor speed."""
        blocks = [self._integral_block(), *(_biquad(filter_) for filter_ in self.filters(speed_rps))]
        blocks += [(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))] * self.delay_samples
        whole = self._feedback_block()
        for block in blocks:
            whole = _series(whole, block)
        return whole

    def _feedback_block(self) -> "Block":
        """Block K_pp + F_lp s, bilinear, with one state.

        F_lp s alone is y = ((c − w) y₁ + w c (x − x₁))/(c + w).
        """
        c, w = 2.0 / self.period_s, 2.0 * math.pi * self.cascade.lowpass_hz
        pole, gain = (c - w) / (c + w), w * c / (c + w)
        return (
            np.array([[pole]]),
            np.ones((1, 1)),
            np.array([[gain * (pole - 1.0)]]),
            np.array([[gain + self.cascade.position_gain_per_s]]),
        )

    def _integral_block(self) -> "Block":
        """Block K_vp + K_vi/s, bilinear."""
        ki = self.cascade.velocity_integral_gain_nm_rad * self.period_s
        direct = self.cascade.velocity_gain_nm_s_rad + 0.5 * ki
        return np.ones((1, 1)), np.ones((1, 1)), np.array([[ki]]), np.array([[direct]])


@lru_cache(maxsize=64)
def _held_plant(plant: TwoInertia, period_s: float) -> tuple[Real, Real]:
    """Discretise a plant; the same for all speeds and filters of a design."""
    return held(*plant.state_space(), period_s)


Block = tuple[Real, Real, Real, Real]
"""Matrices A, B, C, D of a discrete system with one input and one output."""


def held(a: Real, b: Real, period_s: float) -> tuple[Real, Real]:
    """Discretise ẋ = A x + B u exactly, with u held over each period.

    Args:
        a: A; shape (n, n).
        b: B; shape (n, inputs), or (n,) for one input.

    Returns:
        A (n, n) and B (n, inputs) of the steps.
    """
    n = len(a)
    inputs = np.reshape(b, (n, -1))
    rates = np.zeros((n + inputs.shape[1], n + inputs.shape[1]))
    rates[:n, :n], rates[:n, n:] = a, inputs
    step = exponential(rates * period_s)[:n]
    return step[:, :n], step[:, n:]


def closed_loop(a: Real, b: Real, law: "Block", motor: int = 0) -> Real:
    """Close a loop: the matrix of plant and law together.

    Args:
        a: A of the plant; shape (n, n).
        b: B of the motor's torque; shape (n, 1).
        law: Law −τ/θ_m, or a stack of laws of equal size along leading axes.
        motor: Place of the motor angle in the plant's state.

    Returns:
        Shape (…, n + m, n + m).
    """
    law_a, law_b, law_c, law_d = law
    n, m = len(a), law_a.shape[-1]
    closed = np.zeros((*law_a.shape[:-2], n + m, n + m))
    closed[..., :n, :n] = a
    closed[..., :n, motor : motor + 1] -= b @ law_d
    closed[..., :n, n:] = -b @ law_c
    closed[..., n:, motor : motor + 1], closed[..., n:, n:] = law_b, law_a
    return closed


def exponential(matrix: Real) -> Real:
    """Matrix exponential by its series, with scaling and squaring.

    For small matrices the threads of LAPACK take a hundred times as long.
    """
    halvings = max(0, math.ceil(math.log2(max(1.0, float(np.max(np.sum(np.abs(matrix), axis=1)))))))
    scaled = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for n in range(1, 20):  # 1/20! is beyond double precision
        term = term @ scaled / n
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def _biquad(coefficients: tuple[float, float, float, float, float]) -> Block:
    """Controllable canonical form of a second-order filter."""
    b0, b1, b2, a1, a2 = coefficients
    return (
        np.array([[-a1, -a2], [1.0, 0.0]]),
        np.array([[1.0], [0.0]]),
        np.array([[b1 - a1 * b0, b2 - a2 * b0]]),
        np.array([[b0]]),
    )


def _series(first: Block, second: Block) -> Block:
    """Connect the second block behind the first."""
    (a1, b1, c1, d1), (a2, b2, c2, d2) = first, second
    n = len(a1)
    a = np.zeros((n + len(a2), n + len(a2)))
    a[:n, :n], a[n:, :n], a[n:, n:] = a1, b2 @ c1, a2
    return a, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop.

    Attributes:
        sensitivity_peak: Peak M_s = max |1/(1 + L)| of the sensitivity.
        gain_margin_db: Smallest distance of |L| from 0 dB, up or down, where the phase crosses −180°; inf where it
            never does.
        phase_margin_deg: Smallest distance of the phase from −180°, either way, where |L| crosses 1.
        stable: True if all closed-loop poles lie inside the unit circle.
        pole_radius: Largest |z| of the poles.
    """

    sensitivity_peak: float
    gain_margin_db: float
    phase_margin_deg: float
    stable: bool
    pole_radius: float


def margins(loop: Loop, speed_rps: float = 0.0, points: int = 4000) -> Margins:
    """Compute margins with the filters frozen at a motor speed."""
    grid = np.geomspace(0.5, 0.49 / loop.period_s, points)
    lines = [notch.order * speed_rps for notch in loop.notches if speed_rps > 0.0]
    extra = [np.linspace(0.9 * line, 1.15 * line, 801) for line in lines]
    frequency = np.unique(np.concatenate([grid, *extra]))
    response = loop.open_loop(frequency, speed_rps)
    gain, phase = np.abs(response), np.unwrap(np.angle(response))
    crossing = np.flatnonzero((gain[:-1] - 1.0) * (gain[1:] - 1.0) <= 0.0)
    phase_margin = math.inf
    for i in crossing:
        wrapped = (math.degrees(phase[i]) + 180.0 + 180.0) % 360.0 - 180.0
        phase_margin = min(phase_margin, abs(wrapped))
    # a crossing of the negative real axis: the imaginary part changes sign while the real part is negative
    imaginary, real = response.imag, response.real
    negative = np.flatnonzero((imaginary[:-1] * imaginary[1:] < 0.0) & (real[:-1] < 0.0))
    gain_margin = min((abs(20.0 * math.log10(gain[i])) for i in negative), default=math.inf)
    radius = float(np.abs(loop.closed_loop_poles(speed_rps)).max())
    return Margins(float(np.max(1.0 / np.abs(1.0 + response))), gain_margin, phase_margin, radius < 1.0, radius)


def acceleration_bound(frequency_hz: Real, amplitude_rad: float, lever_m: float, tip_limit_m: float) -> Real:
    """Bound on |G_al| by constraint (5), in 1/s².

        A_acc ω²/(L A_n), shape of `frequency_hz`

    Args:
        frequency_hz: Frequency ω/2π = k f_m; shape (m,).
        amplitude_rad: Amplitude A_n of the transmission error.
        lever_m: Tip lever L, which turns the paper's millimetres at the tip into an angle at the arm.
        tip_limit_m: Limit A_acc of the tip displacement.
    """
    omega = 2.0 * math.pi * np.asarray(frequency_hz, dtype=np.float64)
    return np.asarray(tip_limit_m * omega**2 / (lever_m * amplitude_rad))
