"""Table of a cancellation over the motor speed.

It says what each sine of the addition asks of set-point and torque.

`hil.design.inverse` makes it, `hil.control.cancellation` reads it in every cycle. Its largest values bound all that is added.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real

FADED_OVER_KEPT = 1.25
"""Frequency over the one up to which a wave is kept, from which it has no more right to the set-point's speed than others."""
LIMIT_USED = 0.95
"""Fraction of a limit up to which set-points go.

Rounding to counts adds to each step: 0.12 rev/s at 4096 counts per revolution and a SYNC of 2 ms."""
FADE_REV = 2.0
"""Motor revolutions in which the first addition is forgotten, to 1/e.

What is added at first is taken off, so that a motor at rest stays where it is: a step of N A_k, and one that is faded in too,
would wind up the velocity loop against friction, and the motor would break away with a jolt."""


@dataclass(frozen=True)
class WaveLabel:
    """One sine of a table.

    Attributes:
        degree: 1 for an order of the error itself; for a mixed wave the number of amplitudes that it grows with.
    """

    order: float
    phase_rad: float
    degree: int
    sources: frozenset[float]

    def turns(self, orders: Sequence[float]) -> tuple[list[int], list[int]]:
        """Return how often phase and amplitude of each order are in it.

        φ = Σ n_k φ_k + …, size ~ Π A_k^m_k.

        A mixed wave is a product of amplitudes, some of them conjugate: as many as its degree, and its order is their sum.
        """
        own = [order for order in orders if order in self.sources]
        found: tuple[int, ...] | None = None
        for turns in product(range(-self.degree, self.degree + 1), repeat=len(own)):
            spare = self.degree - sum(map(abs, turns))
            fits = abs(sum(n * k for n, k in zip(turns, own, strict=True)) - self.order) < SAME_ORDER
            if not fits or spare % 2 or spare < 2 * turns.count(0):
                continue
            if found is None or turns.count(0) < found.count(0):
                found = turns
        if found is None:  # a table that nobody made of products
            return [0] * len(orders), [0] * len(orders)
        sizes = [abs(n) if n else 2 for n in found]
        sizes[0] += self.degree - sum(sizes)
        net, size = dict(zip(own, found, strict=True)), dict(zip(own, sizes, strict=True))
        return [net.get(order, 0) for order in orders], [size.get(order, 0) for order in orders]


SAME_ORDER = 1e-6
"""Orders that differ by less are one."""
IMAGES = (-2, -1, 1, 2)
"""Accuracy: multiples of the SYNC rate at which images count: those beyond are below 1e-4 of an order."""
ARRAYS = ("reference", "torque", "motion", "bend", "torque_bend", "load_reference", "load_torque", "image", "asked")
"""Arrays of a table, which scale alike."""


@dataclass(frozen=True)
class MotorLoad:
    """Relation between a motor's torque and the torque in its gear.

    τ_g = N (τ − J_m θ̈_m − D_m θ̇_m − τ_C sign θ̇_m)

    Attributes:
        reduction_ratio: N.
        motor_inertia_kg_m2: J_m.
        motor_damping_nm_s_rad: D_m.
        coulomb_friction_nm: τ_C.
        reaction: Part of τ_g dθ_sync/dθ_m that loads the motor, 1 where the gear loses no power.
        most_nm: Largest τ_g that counts.
    """

    reduction_ratio: float
    motor_inertia_kg_m2: float
    motor_damping_nm_s_rad: float
    coulomb_friction_nm: float
    reaction: float
    most_nm: float


@dataclass(frozen=True)
class CancellationTable:
    """Additions to the set-points of one axis, by wave and motor speed.

    Attributes:
        waves: The waves, those of the error's own orders first.
        step_rps: Distance of the table's speeds, which begin at 0.
        reference: G by speed, −N A_k included, in rad at the motor; shape (waves, speeds).
        torque: G of the torque offset, in N·m; shape (waves, speeds).
        motion: Amplitude of the motor's part in it, in rad; shape (waves, speeds). Read of the error's own orders.
        bend: What G of the set-point changes by for each rad/s² by which |θ̇_m| grows; shape (waves, speeds). None: nothing.
        torque_bend: The same of the torque offset.
        most_rad_s2: Largest acceleration for which it does.
        load_reference: What the set-point has to add for each N·m of τ_g, with the whole reaction; shape (waves, speeds).
        load_torque: The same of the torque offset.
        motor_load: How τ_g is told; None if it does not react on the motor.
        image: Motion by each of the images of the sampled set-points, in rad; shape (`IMAGES`, waves, speeds). None: nothing.
        asked: `motion` without a speed limit; shape (waves, speeds). None: the same.

    Raises:
        ValueError: The shapes do not fit, or a number is not finite.
    """

    waves: tuple[WaveLabel, ...]
    step_rps: float
    reference: Complex
    torque: Complex
    motion: Real
    bend: Complex | None = None
    torque_bend: Complex | None = None
    most_rad_s2: float = 0.0
    load_reference: Complex | None = None
    load_torque: Complex | None = None
    motor_load: MotorLoad | None = None
    image: Complex | None = None
    asked: Real | None = None

    def __post_init__(self) -> None:
        """Refuse what the law cannot read."""
        shape = np.shape(self.reference)
        fits = len(shape) == 2 and shape[0] == len(self.waves) and shape[1] >= 2
        others = [part for name in ARRAYS[1:] if (part := getattr(self, name)) is not None]
        if not fits or any(np.shape(part)[-2:] != shape for part in others):
            shapes = ", ".join(str(np.shape(part)) for part in (self.reference, *others))
            raise ValueError(
                f"tables of shapes {shapes} do not fit {len(self.waves)} waves; expected one row per wave, and equal shapes"
            )
        if not self.step_rps > 0.0:
            raise ValueError(f"step_rps = {self.step_rps} must be above 0")
        if not all(np.all(np.isfinite(part)) for part in (self.reference, *others)):
            raise ValueError("a table holds values that are not finite")

    @property
    def orders(self) -> tuple[float, ...]:
        """The error's own orders k."""
        return tuple(wave.order for wave in self.waves if wave.degree == 1)

    @property
    def speeds_rps(self) -> NDArray[np.float64]:
        """Motor speeds of the table; shape (speeds,)."""
        return np.arange(np.shape(self.reference)[1], dtype=np.float64) * self.step_rps

    def scaled(self, gain: float) -> "CancellationTable":
        """The table of an error that is `gain` times as large."""
        by_wave = np.array([gain**wave.degree for wave in self.waves])[:, np.newaxis]
        return self._with(lambda part: by_wave * part, self.waves)

    def without(self, orders: Collection[float]) -> "CancellationTable | None":
        """Return the table without some orders; None if no order remains.

        What these orders mix with is left out too.
        """
        out = frozenset(orders)
        kept = [index for index, wave in enumerate(self.waves) if not wave.sources & out]
        if not kept:
            return None
        return self._with(lambda part: part[..., kept, :], tuple(self.waves[index] for index in kept))

    def within_speed(
        self,
        limit_rps: float,
        up_to_rps: float,
        kept_hz: float,
        by_torque: "CancellationTable | None" = None,
        torque_nm: float = 0.0,
    ) -> "CancellationTable":
        """Return the table with set-points no faster than a limit.

        The limit holds where other means for waves of high frequency can reach that.

        The lowest orders come first. What the set-points have no room for is left to the torque, as far as that may go; what
        neither can do is left out.

        Args:
            up_to_rps: Highest motor speed of the motion.
            kept_hz: Frequency k f_m up to which a wave is not left out; above it the lowest orders come first.
            by_torque: The table that does the same by the torque offset alone; None if there is none.
        """
        frequency, own, fast = self._largest_speeds(up_to_rps)
        kept = np.clip((FADED_OVER_KEPT - frequency / kept_hz) / (FADED_OVER_KEPT - 1.0), 0.0, 1.0)
        room = LIMIT_USED * limit_rps - own
        if by_torque is None:
            part = kept + self._fitted(1.0 - kept, fast, room - np.sum(kept * fast, axis=0))
            return replace(self._with(lambda each: part * each, self.waves), asked=self.motion)
        strong, room_nm = by_torque.largest_torques_nm(), torque_nm * (self.speeds_rps <= up_to_rps + self.step_rps)
        part, other = np.zeros_like(fast), np.zeros_like(fast)
        for wanted in (kept, np.ones_like(kept)):
            part = part + self._fitted(wanted - part - other, fast, room - np.sum(part * fast, axis=0))
            other = other + self._fitted(wanted - part - other, strong, room_nm - np.sum(other * strong, axis=0))
        part = np.maximum(part, kept - other)
        return replace(self._with(lambda each: part * each, self.waves)._added(by_torque, other), asked=self.motion)

    def _fitted(self, wanted: Real, size: Real, room: Real) -> Real:
        """Return the fraction of each wave for which there is room.

        It is of a size and no more than wanted; shape (waves, speeds).
        """
        part = np.zeros_like(wanted)
        for row in np.argsort([wave.order for wave in self.waves], kind="stable"):
            part[row] = np.clip(room / np.maximum(size[row], 1e-12), 0.0, wanted[row])
            room = room - part[row] * size[row]
        return part

    def _with(self, change: Callable[[Any], Any], waves: tuple[WaveLabel, ...]) -> "CancellationTable":
        """The table with all its arrays changed alike."""
        given: dict[str, Any] = {name: getattr(self, name) for name in ARRAYS}
        changed: dict[str, Any] = {name: None if part is None else change(part) for name, part in given.items()}
        return replace(self, waves=waves, **changed)

    def _added(self, other: "CancellationTable", part: Real) -> "CancellationTable":
        """Return the table plus a part, shape (waves, speeds), of another table."""
        sums: dict[str, Any] = {}
        for name in ARRAYS:
            mine, more = getattr(self, name), getattr(other, name)
            sums[name] = mine if more is None else part * more + (0.0 if mine is None else mine)
        return replace(self, **sums)

    def largest_reference_rad(self, up_to_rps: float = math.inf) -> float:
        """The largest addition to the set-point up to a motor speed."""
        return self._largest(self._largest_gains(), up_to_rps) + self._first_rad()

    def largest_torque_nm(self, up_to_rps: float = math.inf) -> float:
        """The largest torque offset up to a motor speed."""
        return self._largest(self.largest_torques_nm(), up_to_rps)

    def largest_torques_nm(self) -> Real:
        """Return |G| of the torque offset at any load; shape (waves, speeds)."""
        return self._at_most(self.torque, self.torque_bend, self.load_torque)

    def largest_speed_rps(self, up_to_rps: float) -> float:
        """Return the fastest set-point up to a motor speed, in rev/s.

        It is the speed of the motion plus the change of the addition.
        """
        _, own, fast = self._largest_speeds(up_to_rps)
        inside = self.speeds_rps <= up_to_rps + self.step_rps
        return float(np.max((own + np.sum(fast, axis=0))[inside]))

    def _largest_speeds(self, up_to_rps: float) -> tuple[Real, Real, Real]:
        """Return the frequency and the set-point speeds of each wave.

        Frequency k f_m in Hz; set-points' speed without the waves, and how much faster each wave makes them, in rev/s.

        Without them it is the motor's own speed, and that at which the first addition is forgotten. Shapes (waves, speeds),
        (speeds,) and (waves, speeds).
        """
        speeds = np.minimum(self.speeds_rps, up_to_rps)
        frequency = np.array([wave.order for wave in self.waves])[:, np.newaxis] * speeds
        own = speeds + speeds * self._first_rad() / (2.0 * math.pi * FADE_REV)
        return frequency, own, frequency * self._largest_gains()

    def _first_rad(self) -> float:
        """The largest first addition, at rest, which is taken off."""
        return float(np.sum(np.abs(self.reference[:, 0])))

    def _largest_gains(self) -> Real:
        """Return |G| of the set-points at any load; shape (waves, speeds)."""
        return self._at_most(self.reference, self.bend, self.load_reference)

    def _at_most(self, gain: Complex, bend: Complex | None, load: Complex | None) -> Real:
        """Return the largest effect of each wave; shape (waves, speeds).

        It holds at any acceleration and any load for which G changes.
        """
        most = np.abs(gain) + (0.0 if bend is None else self.most_rad_s2 * np.abs(bend))
        if load is not None and self.motor_load is not None:
            most = most + abs(self.motor_load.reaction) * self.motor_load.most_nm * np.abs(load)
        return np.asarray(most)

    def _largest(self, table: Complex | Real, up_to_rps: float) -> float:
        inside = self.speeds_rps <= up_to_rps + self.step_rps  # between two speeds it is between their values
        return float(np.max(np.sum(np.abs(table[:, inside]), axis=0)))
