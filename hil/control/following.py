"""Cancellation that follows a changing transmission error.

An observer estimates what the cancellation leaves, as sines of the motor angle, and changes the cancellation.

Of an order k the cancellation leaves d_k c_k e^{j k θ_m}, where c_k is what was identified and d_k a complex number, 0 where the
cancellation is right. What is left shakes the tip through the arm on its gear,

    ẍ + a₁ ẋ + a₀ x = v̈,   v = Σ Re(d_k c_k e^{j k θ_m}),   tip's acceleration = L (b₀ x + b₁ ẋ),

v̈ = −Σ Re((k θ̇_m)² d_k c_k e^{j k θ_m}). The states x, ẋ of each axis and the d_k, which walk at random, are observed together by
a Kalman filter from the tip's acceleration: a disturbance observer whose disturbance repeats with the motor's angle, however the
speed changes. Acceleration and sines go through the same band-pass, so it costs no phase.

The cancellation of an order is multiplied by w_k, 1 at first. Where d_k is told from nothing and more than a tip may shake,
w_k goes towards w_k + d_k, in a time that is given. It is frozen elsewhere, never leaves its bounds, and an order that
wants to is taken back to what was identified for good.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from hil.core.library import CORE


@dataclass(frozen=True)
class FollowingSettings:
    """Settings of a cancellation that follows.

    Attributes:
        model_error: Part of the vibration that the arm's model explains wrongly.
        correlated_s: Time over which that is alike.
        walk_per_root_s: Walk of d per root of a second.
        most_error: Largest standard error of d.
        follow_s: Time in which w follows d; twelve samples where that is more.
        begin_sigmas: Standard errors of d from which on w follows.
        end_sigmas: Standard errors below which it stops.
        begin_m: Amplitude at the tip from which on w follows.
        end_m: Amplitude below which it stops.
        least_gain: Least |w|.
        most_gain: Largest |w|.
        most_angle_rad: Largest angle of w.
        low_ratio: Lowest k f_m over f_al at which an order is followed.
        high_ratio: Highest.
        slowest_rad_s: Slowest motor.
        least_noise_m_s2: Noise that every accelerometer has.
        speed_lowpass_hz: Corner of the low-pass that gives the speed.
        quick: Times by which d walks faster, beside 1, when w has just begun to follow.
        quick_s: Time in which that is over.
        jolt_part: Part of an order's vibration beside which the motion's own may shake the tip and w follows.
        wander: Way of w that is too long.
        wander_per_s: Way that is forgotten per second.
        likely: Deviation d that is likely before anything is seen.
        begin_part: Part of an order, |d|, from which on w follows.
        end_s: Time that little must have been left before it stops.
        steady: Times by which d walks faster as long as w follows.
    """

    model_error: float = 0.15
    correlated_s: float = 0.03
    walk_per_root_s: float = 0.06
    most_error: float = 0.6
    follow_s: float = 0.07
    begin_sigmas: float = 4.0
    end_sigmas: float = 1.0
    begin_m: float = 1e-6
    end_m: float = 0.3e-6
    least_gain: float = 0.5
    most_gain: float = 1.5
    most_angle_rad: float = math.radians(60.0)
    low_ratio: float = 0.6
    high_ratio: float = 2.2
    slowest_rad_s: float = 1.5
    least_noise_m_s2: float = 2e-3
    speed_lowpass_hz: float = 20.0
    quick: float = 20.0
    quick_s: float = 0.4
    jolt_part: float = 0.3
    wander: float = 3.0
    wander_per_s: float = 0.5
    likely: float = 0.1
    begin_part: float = 0.06
    end_s: float = 0.4
    steady: float = 2.0


@dataclass(frozen=True)
class ArmModel:
    """The arm of an axis as one resonance, sampled.

    Attributes:
        a: State matrix of x and ẋ, row by row.
        b: Input of the mean of two samples of v̈.
        stiff: a₀, a₁, b₀, b₁ of the resonance itself.
        f_al_hz: Frequency at which it rings most.
        delay_s: Delay of the acceleration, the sampling's own included.
    """

    a: tuple[float, float, float, float]
    b: tuple[float, float]
    stiff: tuple[float, float, float, float]
    f_al_hz: float
    reduction_ratio: float
    delay_s: float

    def row(self) -> tuple[float, ...]:
        """Its numbers in the order of `struct following_arm`."""
        a0, a1, b0, b1 = self.stiff
        omega = 2.0 * math.pi * self.f_al_hz
        return (*self.a, *self.b, a0, a1, b0, b1, omega, self.reduction_ratio, self.delay_s)


class Followed(NamedTuple):
    """An order that is followed.

    Attributes:
        phase_rad: φ_k as identified.
        amplitude_rad: A_k as identified, at the arm.
        begin_part: Part of it, |d|, from which on w follows, where that is more than the settings' own.
    """

    order: float
    phase_rad: float
    amplitude_rad: float
    begin_part: float = 0.0


class SecondDifference:
    """Acceleration of a tip from its joint's angle, one period late.

    It is causal, unlike that of a recording.

    The second difference is (2 sin(ωT/2)/(ωT))² of the second derivative, which is put right at f_al.

    Args:
        f_al_hz: Frequency at which the arm rings most.
        period_s: SYNC period.
    """

    def __init__(self, lever_m: float, f_al_hz: float, period_s: float) -> None:
        half = math.pi * f_al_hz * period_s
        self._scale = lever_m / period_s**2 * (half / math.sin(half)) ** 2
        self._last: tuple[float, ...] = ()

    def __call__(self, angle_rad: float | None) -> float | None:
        """Return the tip's acceleration of one period ago.

        None until three angles have come one after the other.

        Args:
            angle_rad: The joint's angle; None if it was not measured.
        """
        self._last = () if angle_rad is None else (*self._last[-2:], angle_rad)
        if len(self._last) < 3:
            return None
        first, second, third = self._last
        return self._scale * (first - 2.0 * second + third)


class FollowingLaw:
    """Observer of all axes of a motion, with their factors w."""

    def __init__(
        self,
        arms: Sequence[ArmModel],
        orders: Sequence[Sequence[Followed]],
        band: tuple[float, float, float, float, float],
        period_s: float,
        settings: FollowingSettings | None = None,
    ) -> None:
        """Lay out the arrays.

        Args:
            band: Section of the band-pass.

        Raises:
            ValueError: There is no axis, or no order.
        """
        count, most = len(arms), max((len(each) for each in orders), default=0)
        if count == 0 or count != len(orders) or most == 0:
            raise ValueError(
                f"{count} arms, {len(orders)} sets of up to {most} orders; expected one set of at least 1 order for each arm"
            )
        self._orders = [tuple(each) for each in orders]
        config = np.zeros(1, CORE.dtype("following_config"))
        config[0] = (period_s, *astuple(settings or FollowingSettings()))
        rows, of = np.zeros((count, most), CORE.dtype("following_order")), np.zeros(count, CORE.dtype("following_arm"))
        for row, (arm, each) in enumerate(zip(arms, orders, strict=True)):
            of[row] = arm.row()
            rows[row, : len(each)] = [tuple(order) for order in each]
        size, memory = 2 * count * (1 + most), CORE.call.BAND_MEMORY
        self._axes, self._common = np.zeros(count, CORE.dtype("following_axis")), np.zeros(1, CORE.dtype("following_common"))
        self._filters = np.zeros((1 + 2 * count * most + count, memory))
        self._states, self._covariance = np.zeros(size), np.zeros((size, size))
        self._factors, self._order_states = (
            np.zeros((count, most, 2)),
            np.zeros((count, most), CORE.dtype("following_order_state")),
        )
        self._likely = float(config["likely"][0])
        self._samples, self._heard = np.zeros((3, count)), np.zeros(2)
        arrays = {
            "config": config, "arms": of, "orders": rows, "band": np.array(band), "axes": self._axes, "common": self._common,
            "filters": self._filters, "states": self._states, "covariance": self._covariance, "factors": self._factors,
            "order_states": self._order_states, "room": np.zeros(CORE.call.following_room(count, most)),
        }  # fmt: skip
        kinds = {"config": "following_config", "arms": "following_arm", "orders": "following_order", "axes": "following_axis"}
        kinds |= {"common": "following_common", "order_states": "following_order_state"}
        self._kept = {name: CORE.pointer(array, kinds.get(name, "double")) for name, array in arrays.items()}
        self._observer = CORE.new("following")
        for name, pointer in self._kept.items():
            setattr(self._observer, name, pointer)
        self._observer.n_axes, self._observer.n_orders = count, most
        self._shared = CORE.pointer(self._samples), CORE.pointer(self._heard)
        self.reset()

    def reset(self) -> None:
        """Forget all; the factors are 1."""
        for array in (self._filters, self._states, self._covariance):
            array[:] = 0.0
        for records in (self._axes, self._common, self._order_states):
            records[:] = np.zeros((), records.dtype)
        self._factors[:, :, 0], self._factors[:, :, 1] = 1.0, 0.0
        for index in range(2 * len(self._axes), len(self._states)):
            self._covariance[index, index] = self._likely**2

    def step(
        self,
        angles_rad: Sequence[float],
        references_rad: Sequence[float],
        levers_m: Sequence[float],
        acceleration_m_s2: float | None,
    ) -> None:
        """Take one sample.

        Args:
            references_rad: Set-points of the motion alone, whose jolts ring.
        """
        samples = self._samples
        samples[0], samples[1], samples[2] = angles_rad, references_rad, levers_m
        self._heard[0] = self._heard[0] if acceleration_m_s2 is None else acceleration_m_s2
        self._heard[1] = 0.0 if acceleration_m_s2 is None else 1.0
        CORE.call.follow_step(self._observer, *self._shared)

    def factors(self, row: int) -> dict[float, complex]:
        """W of each order of an axis."""
        return {each.order: complex(*self._factors[row, m]) for m, each in enumerate(self._orders[row])}

    def left(self, row: int) -> Mapping[float, tuple[complex, float]]:
        """Return d of each order of an axis with its standard error."""
        own, most = 2 * len(self._axes), self._order_states.shape[1]
        found = {}
        for m, each in enumerate(self._orders[row]):
            at = own + 2 * (row * most + m)
            sigma = math.sqrt(max(self._covariance[at, at], self._covariance[at + 1, at + 1]))
            found[each.order] = complex(self._states[at], self._states[at + 1]), sigma
        return found

    def nearest(self, row: int) -> dict[float, float]:
        """Return the largest |d| of each order near which w followed.

        It followed, nearly did, or would have with a lower `begin_part`.
        """
        return {each.order: float(self._order_states["nearest"][row, m]) for m, each in enumerate(self._orders[row])}

    def given_up(self, row: int) -> tuple[float, ...]:
        """Return the orders of an axis that were taken back."""
        return tuple(each.order for m, each in enumerate(self._orders[row]) if self._order_states["given_up"][row, m] > 0.0)
