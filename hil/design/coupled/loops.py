"""Loop of one axis on an arm, with its margins by posture.

The motors of the other axes are held, or are under their own loops.

A margin belongs to one loop, cut at its motor's torque, while the others stay closed: 1 + L = det(1 + P C)/det(1 + P C'), C'
without this axis. No scale of torques enters, as it would into the largest singular value of the whole sensitivity. While an axis
moves alone, the others hold their motors by brakes: that is looked at as well, and is the harder case, since their loops damp.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.notch import Notch
from hil.design.coupled.structure import Structure, closed
from hil.design.frequency import Loop
from hil.design.speed_margins import OpenLoops, SpeedMargins, looked_at_hz, widened

FINE_HZ = 45.0
"""Accuracy: frequency up to which an arm is looked at finely: on the reference arm M_s is the same from 30 to 120 Hz."""
POLE_SPEEDS = 8
"""Accuracy: speeds of closed-loop poles in each filter's range: on the reference arm 3 to 32 give the same largest |z|."""


@dataclass(frozen=True, eq=False)
class Other:
    """Another axis whose loop is closed.

    Attributes:
        motor: Its motor in the structure.
        loop: Its law, filters included; its plant does not count.
        speed_rps: Motor speed at which its filters are frozen; 0 if none acts.
    """

    motor: int
    loop: Loop
    speed_rps: float = 0.0


@dataclass(frozen=True, eq=False)
class ArmCase:
    """Posture, with the state of the other axes.

    Attributes:
        label: Both in words: `at the end of the line, other motors held`.
        own: The motor whose loop is judged.
        others: Axes whose loops are closed; those that are neither here nor the own one have their motors held.
    """

    label: str
    structure: Structure
    own: int
    others: tuple[Other, ...] = ()

    def pole_radius(self, law: Loop, speed_rps: float) -> float:
        """Largest |z| with all loops closed."""
        laws = {other.motor: other.loop.law_block(other.speed_rps) for other in self.others}
        laws[self.own] = law.law_block(speed_rps)
        free = {row: laws[motor] for row, motor in enumerate(sorted(laws))}
        return self.structure.held(self._held).pole_radius(free, law.period_s)

    @property
    def _held(self) -> list[int]:
        turning = {self.own, *(other.motor for other in self.others)}
        return [motor for motor in range(self.structure.motors) if motor not in turning]

    def angle_per_torque(self, frequency_hz: Real, receptance: Complex | None = None) -> Complex:
        """Angle of the own motor per torque.

        Args:
            frequency_hz: Frequencies; shape (m,).
            receptance: The structure's there, where it is known already.
        """
        found = self.structure.receptance(frequency_hz) if receptance is None else receptance
        for motor in self._held:
            found = closed(found, motor, None)
        for other in self.others:
            found = closed(found, other.motor, other.loop.controller(frequency_hz, other.speed_rps))
        return np.asarray(found[self.own, self.own])


@dataclass(frozen=True, eq=False)
class ArmLoops:
    """Loop of one axis on an arm.

    Attributes:
        law: The loop without filters; its plant does not count.
        cases: Postures with motors held and with loops closed, at which a search looks.
        filtered: The same while filters of other axes act, at which a verdict looks as well.
    """

    law: Loop
    cases: tuple[ArmCase, ...]
    filtered: tuple[ArmCase, ...] = ()

    def family(self, step: float, *, with_filtered: bool) -> "ArmFamily":
        """Compute the open loops of the cases.

        Args:
            step: Frequency step where filters act, in units of the lowest mode.
            with_filtered: True to include the cases in which filters of other axes act.
        """
        return ArmFamily(self.law, self.cases + (self.filtered if with_filtered else ()), step)


class ArmFamily:
    """Open loops of some cases.

    Attributes:
        law: The loop without filters.
    """

    def __init__(self, law: Loop, cases: Sequence[ArmCase], step: float) -> None:
        """Compute the open loops; `step` as `ArmLoops.family` has it."""
        self.law, self.cases = law, tuple(cases)
        structures = {id(case.structure): case.structure for case in cases}
        dips = sorted(float(hz) for structure in structures.values() for hz in structure.dips_hz())
        frequency = looked_at_hz(dips, law.period_s, step, high_hz=FINE_HZ)
        free = {key: structure.receptance(frequency) for key, structure in structures.items()}
        angles = [case.angle_per_torque(frequency, free[id(case.structure)]) for case in cases]
        self._open = OpenLoops(law, frequency, law.controller(frequency) * np.array(angles))

    def margins(self, notches: Sequence[Notch], speeds_rps: Real) -> SpeedMargins:
        """Compute the margins of every case."""
        return self._open.margins(notches, speeds_rps)

    def worst_pole(self, notches: Sequence[Notch], limit_rps: float) -> tuple[float, float, str]:
        """Find the largest |z| of all closed loops, its speed and case.

        The speeds are rest, and those within the own filters' ranges in cases without another acting filter.

        Together with the turns of the Nyquist curve, which say whether the own filters change it, this is every speed.

        Args:
            notches: The own filters.
        """
        wide = tuple(widened(notch) for notch in notches)
        inside = [np.linspace(notch.start_rps, min(notch.end_rps, limit_rps), POLE_SPEEDS) for notch in wide]
        speeds = np.unique(np.concatenate([np.zeros(1), *inside]))
        law, found = replace(self.law, notches=wide), []
        for case in self.cases:
            is_filtered = any(other.speed_rps > 0.0 for other in case.others)
            looked_at = (speeds[:1] if is_filtered else speeds[speeds <= limit_rps]).tolist()
            found += [(case.pole_radius(law, speed), speed, case.label) for speed in looked_at]
        return max(found)
