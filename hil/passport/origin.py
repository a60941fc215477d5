"""Origin of an order: the motor or its gear.

A motor with p pole pairs and Z slots cogs at multiples of lcm(Z, 2p) of its turn, an offset of its currents acts at p, unequal
phases at 2p, its harmonics at 6p. A gear's transmission error is an angle, cogging is a torque. That makes a difference, whatever
the numbers:

- Signals beside the measured motion of the motor (tip or joint against motor angle) contain no torque of the motor: the motion
  that such a torque causes is measured too. Their orders are the gear's.
- In an identification from the motor's torque, cogging appears as an apparent error, through the arm's resonance, whose lag
  counts to φ_k with the sign of the direction: φ_k differs between the directions, and A_k does not. An angle keeps φ_k.
- A gear's error under strain changes with the load, and with the direction, which loads other flanks. A constant A_k proves
  nothing: that of a stiff gear is constant as well.

Without any of this, the numbers can only exclude the motor; otherwise the origin is unknown.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.bench.model import SIGNIFICANT_SIGMAS
from hil.design.estimation import SURE_SIGMAS
from hil.passport.store import OrderSides

OriginName = Literal["gear", "motor", "motor or gear"]

LEAST_LOADS = 3
"""Different loads from which a change with the load is told."""
MOTOR_TURN_DEG = 45.0
"""Turn of φ_k between the directions from which a torque is behind it; gears' flanks differ by some degrees."""
GEAR_TURN_DEG = 20.0
"""Turn below which, two standard errors counted in, it is an angle."""
COGGING_LEAK = 0.1
"""Part of the largest order up to which cogging may show beside the motor's motion all the same; 0.03 was seen."""
LIKE = 1.5
"""Ratio of the amplitudes in both directions up to which they are alike."""
NEAR_ORDER = 1e-6


@dataclass(frozen=True)
class Motor:
    """Poles and slots of a motor.

    Attributes:
        pole_pairs: Pole pairs p; None if they are not known.
        slots: Slots Z, likewise.
    """

    pole_pairs: int | None = None
    slots: int | None = None

    def makes(self, order: float) -> str | None:
        """Return how the motor can make an order, in words, or None."""
        p, z = self.pole_pairs, self.slots
        whole = abs(order - round(order)) < NEAR_ORDER
        if p is not None and z is not None and whole and round(order) % math.lcm(z, 2 * p) == 0:
            return f"cogging, a multiple of lcm({z}, {2 * p}) = {math.lcm(z, 2 * p)}"
        if p is not None:
            for factor, words in ((1, "an offset of the currents, p"), (2, "unequal phases, 2p"), (6, "torque ripple, 6p")):
                if abs(order - factor * p) < NEAR_ORDER:
                    return words
        return None


@dataclass(frozen=True)
class Conditions:
    """An amplitude of an order with its conditions.

    Attributes:
        direction: Direction of the motor; None for both.
        over_largest: Its fraction of the run's largest amplitude.
    """

    a_arcsec: float
    error_arcsec: float
    load_kg: float | None
    direction: str | None
    seen_by: str | None = None
    over_largest: float = 1.0


def origin_of_order(
    order: float, motor: Motor, found: Sequence[Conditions], sides: Sequence[OrderSides] = ()
) -> tuple[OriginName, str]:
    """Origin of an order, and the reason for it."""
    how, change, turn = motor.makes(order), _change(found), _turn(sides)
    gears = []
    significant = [each for each in found if each.a_arcsec >= SIGNIFICANT_SIGMAS * each.error_arcsec]
    there = [each for each in significant if each.over_largest >= COGGING_LEAK]
    if any(each.seen_by == "motion" for each in there):
        gears.append("seen in addition to the motor's measured motion, which contains all of its torques")
    if change is not None and change[1]:
        gears.append(f"A changes {change[0]}")
    if turn is not None and turn[0] == "gear":
        gears.append(turn[1])
    if turn is not None and turn[0] == "motor":
        return ("motor or gear", f"{turn[1]}; but {gears[0]}") if gears else ("motor", f"{turn[1]}{f'; {how}' if how else ''}")
    if gears:
        return "gear", gears[0]
    if how is None and motor.pole_pairs is not None and motor.slots is not None:
        return "gear", "no order of this motor"
    reason = how or "poles and slots are not given"
    return (
        "motor or gear",
        f"{reason}; a run with an accelerometer or a load encoder would tell, as would runs with {LEAST_LOADS} loads",
    )


def _turn(sides: Sequence[OrderSides]) -> tuple[OriginName, str] | None:
    """Return the origin that both directions' phases show, or None."""
    known = [each for each in sides if each.phi_sigmas > 0.0]
    if not known:
        return None
    turns = np.array([each.phi_turn_deg for each in known])
    errors = np.maximum(np.abs(turns) / np.array([each.phi_sigmas for each in known]), 1e-3)
    weights = errors**-2.0
    turn = math.degrees(np.angle(weights @ np.exp(1j * np.radians(turns))))
    error = float(np.sum(weights) ** -0.5)
    forward = float(weights @ np.array([each.a_forward_arcsec for each in known]))
    backward = float(weights @ np.array([each.a_backward_arcsec for each in known]))
    if abs(turn) + 2.0 * error < GEAR_TURN_DEG:
        return "gear", f"φ does not change with the direction ({turn:+.0f} ± {error:.0f}°), so it is an error of angle"
    if abs(turn) > max(MOTOR_TURN_DEG, SURE_SIGMAS * error) and max(forward, backward) < LIKE * min(forward, backward):
        return "motor", f"φ turns by {turn:+.0f} ± {error:.0f}° with the direction, and A does not change, so it is a torque"
    return None


def _change(found: Sequence[Conditions]) -> tuple[str, bool] | None:
    """Return a varied condition, and whether it changes A; else None."""
    sides = [[each for each in found if each.direction == name] for name in ("forward", "backward")]
    if all(len(side) >= LEAST_LOADS for side in sides):
        means = [float(np.mean([each.a_arcsec for each in side])) for side in sides]
        spread = math.hypot(*(_error(side) for side in sides))
        return "with the direction", bool(abs(means[0] - means[1]) > SURE_SIGMAS * spread)
    loaded = [each for each in found if each.load_kg is not None]
    loads = np.array([each.load_kg for each in loaded], dtype=np.float64)
    if len(np.unique(loads)) < LEAST_LOADS:
        return None
    amplitudes = np.array([each.a_arcsec for each in loaded])
    about = loads - loads.mean()
    slope = float(about @ amplitudes / (about @ about))
    rest = amplitudes - amplitudes.mean() - slope * about
    own = float(np.mean([each.error_arcsec**2 for each in loaded]))
    variance = max(float(rest @ rest) / max(1, len(loaded) - 2), own)
    return "with the load", bool(abs(slope) > SURE_SIGMAS * math.sqrt(variance / float(about @ about)))


def _error(side: Sequence[Conditions]) -> float:
    values = [each.a_arcsec for each in side]
    own = float(np.mean([each.error_arcsec**2 for each in side]))
    return math.sqrt(max(float(np.var(values, ddof=1)), own) / len(side))
