"""Poles of an axis and its loop, over the stiffnesses of its gear and the speeds of its filters.

`hil.design.frequency` has the paper's axis; here are soft wind-up, hysteresis and the lag of the current loop.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace

import numpy as np

from hil.control.angles import ARCSEC
from hil.design.frequency import Block, Loop, TwoInertia, closed_loop, held
from plant_emulator.robots.robot import RobotAxis


def linear_plant(axis: RobotAxis) -> TwoInertia:
    """Return the linear part of an axis."""
    return TwoInertia(**{each.name: getattr(axis, each.name) for each in fields(TwoInertia)})


def frozen_laws(loop: Loop, speeds_rps: Iterable[float]) -> list[Block]:
    """Return the law with its filters frozen at each speed."""
    by_size: dict[int, list[Block]] = {}
    for speed in speeds_rps:
        block = loop.law_block(float(speed))
        by_size.setdefault(len(block[0]), []).append(block)
    return [
        (np.stack(a), np.stack(b), np.stack(c), np.stack(d))
        for a, b, c, d in (zip(*each, strict=True) for each in by_size.values())
    ]


def growth_per_s(axis: RobotAxis, laws: Sequence[Block], period_s: float) -> float:
    """Return the closed loop's fastest growth, in 1/s.

    It is the largest ln |z|/T_s of the poles over the laws; below 0 everything decays.

    Friction, gravity and the ATE's own slope are left out. The gear is evaluated at each of its stiffnesses: K_g, K_g less
    soft wind-up near no torsion, and K_g plus the F/ψ_h of hysteresis for small motions.
    """
    full = axis.gear_stiffness_nm_rad
    softest = full * (1.0 - axis.wind_up_softness)
    stiffest = full + axis.hysteresis_torque_nm / (axis.hysteresis_torsion_arcsec * ARCSEC)
    plants = [replace(linear_plant(axis), gear_stiffness_nm_rad=stiffness) for stiffness in {full, softest, stiffest}]
    steps = [held(*plant.state_space(axis.current_time_constant_s), period_s) for plant in plants]
    loops = (np.stack([closed_loop(*step, law) for step in steps]) for law in laws)
    return math.log(max(float(np.max(np.abs(np.linalg.eigvals(each)))) for each in loops)) / period_s
