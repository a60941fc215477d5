"""Input shapers of a run, and their cost.

A shaper is fitted to the modes that ring while the loops hold the motors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.arm.kinematics import Kinematics
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.control.arrays import Complex, Real
from hil.control.shapers import EI_TOLERANCE, Shaper, SwingingMode, shaper_for
from hil.control.treatments import LoopName, ShaperName, treatment
from hil.design.frequency import CONTROL_PERIOD_S
from hil.design.modes.problem import ArmMode
from hil.design.modes.ring_down import closed_loop_rates, modes_of
from hil.errors import NotPossibleError
from hil.master.motion import Motion
from hil.results.runs import ShaperEntry

MOST_MODES = 2
"""Modes that a shaper is convolved for: each makes the motion longer."""


def rates_of(bench: Bench, axis: int, identified: Identified | None) -> Complex:
    """Rates of an axis whose loop holds the motor; see `closed_loop_rates`.

    Raises:
        NotPossibleError: The plant or the gains of the axis are not known.
    """
    loop = bench.axis[axis].loop(CONTROL_PERIOD_S, with_notch=False)
    if loop is None:
        raise NotPossibleError(
            f"axis {axis} has no model or no gains, so its modes after a stop are not known; run hil identify plant --bench … "
            f"--axis {axis} --model model.toml, then give --model model.toml"
        )
    known = None if identified is None else identified.axis.get(axis)
    several = () if known is None or known.plant is None else known.plant.modes
    modes = [ArmMode(each.inertia_kg_m2, each.antiresonance_hz, each.damping, each.tip_part) for each in several]
    return closed_loop_rates(loop, modes)


@dataclass(frozen=True)
class FittedShaper:
    """Shaper that is fitted to a robot.

    Attributes:
        modes: Modes that it is for, the first one's impulses first.
        left: Modes that it leaves alone, beyond what EI allows.
    """

    name: ShaperName
    modes: tuple[SwingingMode, ...]
    shaper: Shaper
    left: tuple[SwingingMode, ...] = ()

    def shaped(self, motion: Motion) -> Motion:
        """Shape the set-points of a motion, which adds the shaper's duration."""
        rows = self.shaper.shaped(motion.motor_angle_rad, motion.period_s)
        times = motion.time_s[0] + (motion.time_s[1] - motion.time_s[0]) * np.arange(len(rows), dtype=np.float64)
        return replace(motion, time_s=times, motor_angle_rad=rows)

    def remaining(self, factor: float) -> float:
        """Largest remaining vibration if the frequencies are off by a factor."""
        return max(float(self.shaper.remaining(factor * mode.frequency_hz, mode.damping)) for mode in self.modes)

    def entry(self, path_error_mm: float | None) -> ShaperEntry:
        """Entry of the shaper for the result file."""
        return ShaperEntry(
            name=self.name,
            modes=self.modes,
            left=self.left,
            amplitudes=self.shaper.amplitudes,
            times_s=self.shaper.times_s,
            duration_s=self.shaper.duration_s,
            delay_s=self.shaper.delay_s,
            remaining_fraction=self.remaining(1.0),
            remaining_low_fraction=self.remaining(0.9),
            remaining_high_fraction=self.remaining(1.1),
            path_error_mm=path_error_mm,
        )


def fitted_shaper(name: ShaperName, bench: Bench, axes: Sequence[int], identified: Identified | None) -> FittedShaper:
    """Fit a shaper to the modes of the axes that move.

    The modes count from the lowest; a shaper for a lower one may remove a higher one too.

    Raises:
        NotPossibleError: No axis that moves has a model, or none of them rings.
    """
    known = [axis for axis in axes if bench.axis[axis].has_loop]
    modes: list[SwingingMode] = []
    for axis in known or axes[:1]:
        modes += modes_of(rates_of(bench, axis, identified))
    if not modes:
        held = ", ".join(f"axis {axis}" for axis in axes)
        raise NotPossibleError(f"{name}: no mode rings while the loops hold {held}, so a stop needs no shaper; leave it out")
    modes.sort(key=lambda mode: mode.frequency_hz)
    chosen = modes[:1]
    for mode in modes[1:]:
        if len(chosen) < MOST_MODES and _leaves(shaper_for(name, chosen), mode):
            chosen.append(mode)
    made = shaper_for(name, chosen)
    return FittedShaper(name, tuple(chosen), made, tuple(mode for mode in modes if mode not in chosen and _leaves(made, mode)))


def _leaves(made: Shaper, mode: SwingingMode) -> bool:
    return float(made.remaining(mode.frequency_hz, mode.damping)) > EI_TOLERANCE


def shaped_motion(bench: Bench, name: str, motion: Motion, identified: Identified | None) -> tuple[Motion, ShaperEntry | None]:
    """Shape a motion by a treatment, with the shaper's entry.

    A treatment without a shaper leaves the motion as it is, and has no entry.

    Raises:
        NotPossibleError: The shaper cannot be fitted.
    """
    kind = treatment(name).shaper
    if kind is None:
        return motion, None
    made = fitted_shaper(kind, bench, motion.axes, identified)
    shaped = made.shaped(motion)
    return shaped, made.entry(path_error_mm(bench, motion, shaped))


def check_stop(is_stop: bool, name: str, loop: LoopName) -> None:
    """Refuse a treatment or loop that cannot act on a stop.

    Raises:
        NotPossibleError: The treatment acts on a motor that turns, or the host closes the loop.
    """
    if not is_stop:
        return
    if name != "none" and treatment(name).shaper is None:
        raise NotPossibleError(
            f"{name} acts only while a motor turns, but the arm rings after the stop; choose a shaper, alone or "
            "beside a cancellation (cancellation+shaper-ei)"
        )
    if loop == "host":
        raise NotPossibleError("a point-to-point move is judged only with loops that the drives close; choose --loop drive")


def path_error_mm(bench: Bench, motion: Motion, shaped: Motion) -> float | None:
    """Largest distance of a shaped line from the path without shaper.

    It is in mm at the tip; None if a single axis moves, whose path stays the same.

    A mean of earlier points of a curved path in the joints lies inside the curve.
    """
    if len(motion.axes) == 1:
        return None
    plain, found = tip_m(bench, motion), tip_m(bench, shaped)
    begin, along = plain[0], plain[-1] - plain[0]
    length = float(np.linalg.norm(along))
    if length == 0.0:
        return 1e3 * float(np.max(np.linalg.norm(found - begin, axis=1)))
    unit = along / length
    way = np.clip((found - begin) @ unit, 0.0, length)
    return 1e3 * float(np.max(np.linalg.norm(found - begin - way[:, np.newaxis] * unit, axis=1)))


def tip_m(bench: Bench, motion: Motion) -> Real:
    """Positions of the tip on a line motion's set-points.

    Shape (n, 2) for a planar chain, (n, 3) for an arm.
    """
    ratios = np.array([bench.axis[axis].reduction_ratio for axis in motion.axes])
    turned = motion.motor_angle_rad / ratios
    if bench.arm is not None:
        angles = np.tile(bench.arm.home_rad(), (len(turned), 1))
        for column, axis in enumerate(motion.axes):
            angles[:, bench.arm.axes.index(axis)] += turned[:, column]
        points, _ = Kinematics.of(bench.arm).pose(angles)
        return np.asarray(points)
    assert bench.geometry is not None and bench.line_motion is not None  # noqa: S101, PT018 - the motion was made from them
    chain = bench.geometry.chain()
    start = bench.line_motion.line(chain).joints(np.zeros(1))[0]
    return chain.tip(start + turned)
