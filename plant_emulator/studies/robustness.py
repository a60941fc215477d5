"""Plants drawn from the unknowns, and their judged runs, closed-loop."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, islice, product
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis import (
    LINE_BAND_HZ,
    amplitude_spectrum,
    area,
    line_window_s,
    order_window_rps,
    rising_within,
    speed_of,
    tip_displacement_mm,
    tip_scale,
    without_phase,
)
from hil.control.arrays import Real
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.design.frequency import Block, Loop
from hil.robot_tables import Control
from plant_emulator.motion.axes import Axes, FollowedRun, response_of, tip_sensor
from plant_emulator.physics.axis import hang_at_rest
from plant_emulator.robots.robot import Robot
from plant_emulator.studies.closed_loop import frozen_laws, growth_per_s, linear_plant
from plant_emulator.studies.simulate import LawOfAxis, as_uploaded, follow, gains_as_uploaded, references
from plant_emulator.studies.spread import (
    AXIS_UNKNOWNS,
    SENSOR_UNKNOWNS,
    PlantSpread,
    Unknown,
    drawn,
    drawn_axis,
    drawn_sensor,
    nominal,
)
from plant_emulator.trials.executors import CRASHED_WORDS, Executors, run_all
from plant_emulator.trials.rows import Row, numbers

WINDOW_SAMPLES = 16
"""Fewer samples in the window than this are not a run through it."""

HIGHEST_F_AL = 1.3
"""Highest f_al of a plant, in units of the robot file's, for which the SYNC period has to do."""

JUDGED_ORDER = 2
"""Order of the transmission error by whose crossing of f_al a ramp is judged."""
TAIL_S = 0.5
"""Rest of the axes after it in s: in its second half the residual vibration must be decaying."""
FOLLOWING_REACH = 2.0
"""The following error may be this many times what the fastest set-points alone make of it, v/K_pp …"""
FOLLOWING_REST_REV = 0.05
"""… and this much more, for friction at low speed."""
RIPPLE_FRACTION = 0.1
"""The torque's standard deviation at rest, of the torque limit, above which the motor oscillates."""
DECAY = 0.9
"""Largest ratio of the vibration in the last quarter of a second to that in the quarter before, where it can be seen."""
SEEN_FRACTION = 0.1
"""A residual vibration below this fraction of the specification is rest."""
SPEED_STEP_RPS = 0.25
"""Grid of motor speeds at which the closed loop's poles are looked at, filters frozen."""


RESULTS = (
    "index", "tip_peak_mm", "tip_rms_mm", "area_reduction_percent", "following_error_rev", "residual_mm", "growth_per_s",
    "faults", "meets",
)  # fmt: skip
"""Columns of a plant's row before its drawn values.

- `index`: number of the draw; −1 for the robot of the file.
- `tip_peak_mm`: largest tip displacement in the window as measured; infinite where the run does not pass through it.
- `tip_rms_mm`: its root mean square there.
- `area_reduction_percent`: reduction of the spectrum's area by the filters, in a line motion with filters; else None.
- `following_error_rev`: largest distance of a motor from its set-point.
- `residual_mm`: largest true tip displacement above f_al/2 in the last quarter of a second.
- `growth_per_s`: that of `closed_loop`, of the worst axis.
- `faults`: why it is not stable, with spaces between: `diverged`, `following`, `vibration`, `torque`, `poles`.
- `meets`: true if it is stable and within the specification.
"""


class SimulatedMotion(NamedTuple):
    """One run, and how it is judged.

    Attributes:
        run: True motion at each SYNC.
        measured_m_s2: The accelerometer's reading of the tip's vertical acceleration; shape (n,).
        f_al_hz: Peak of |G_al| of this plant, by which it is judged; of axis 2 in the line motion.
    """

    run: FollowedRun
    measured_m_s2: Real
    f_al_hz: float

    @property
    def is_finite(self) -> bool:
        """True if the simulation has stayed within the finite numbers."""
        return all(bool(np.all(np.isfinite(each))) for each in self.run)


@dataclass(frozen=True)
class DrawnPlant:
    """A drawn plant: its unknowns, and the robot, encoders and accelerometer among it."""

    values: dict[str, float]
    robot: Robot


Drawn = tuple[DrawnPlant, np.random.Generator]
"""A plant, and the source of its runs' noise."""


@dataclass(frozen=True)
class Study:
    """Runs of one experiment over many plants.

    Attributes:
        axis: The axis of a constant-acceleration run, or None for the line motion.
        notches: Filters by axis; none for an axis that is left out.
        seed: Equal seeds give equal plants, whatever the number of processes.
        tip_mm: The specification of a constant-acceleration run, and of a line motion without filters.
        area_reduction_percent: The specification of a line motion with filters.

    Raises:
        ValueError: The robot lacks the motion, an axis, gains, or periods that fit; or a loop without a position gain.
    """

    robot: Robot
    axis: int | None
    controls: Mapping[int, Control]
    notches: Mapping[int, tuple[Notch, ...]]
    spread: PlantSpread = field(default_factory=PlantSpread)
    seed: int = 1
    tip_mm: float = 0.05
    area_reduction_percent: float = 26.0

    def __post_init__(self) -> None:
        """Refuse a study that cannot be run."""
        if self.robot.links is not None:
            raise ValueError(f"robot {self.robot.name!r} has an [arm]; a study needs axes that are not coupled")
        period = self.robot.control_period_s
        if not math.isclose(self.periods * period, self.robot.sync_period_s, rel_tol=1e-9):
            raise ValueError(f"{self.robot.sync_period_s} s is not a whole number of control periods of {period} s")
        response_of(self.robot)
        self._targets()
        for number in self.axes:
            if number not in self.controls:
                raise ValueError(f"axis {number} has no gains: no control table")
            if not self.controls[number].position_gain_per_s > 0.0:
                raise ValueError(f"axis {number}: a position_gain_per_s of 0 closes no loop")
            softness = self.robot.axis[number].wind_up_softness + self.spread.wind_up_softness
            if softness >= 1.0:
                raise ValueError(f"axis {number}: wind_up_softness {softness:g} leaves no stiffness; expected less than 1")
        top_hz = tip_scale(HIGHEST_F_AL * self.f_al_hz).band_hz[1]
        if 0.5 / self.robot.sync_period_s <= top_hz:
            raise ValueError(f"a SYNC period of {self.robot.sync_period_s} s does not show vibrations up to {top_hz:.3g} Hz")

    @property
    def periods(self) -> int:
        """Control periods per SYNC."""
        return max(1, round(self.robot.sync_period_s / self.robot.control_period_s))

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes that move."""
        return self.robot.chain_axes if self.axis is None else (self.axis,)

    @property
    def name(self) -> str:
        """Name in files: `line`, or the axis."""
        return "line" if self.axis is None else f"axis{self.axis}"

    @property
    def words(self) -> str:
        """The motion in words."""
        return "line motion" if self.axis is None else f"axis {self.axis}, constant acceleration"

    @property
    def is_by_area(self) -> bool:
        """True for a line motion with filters, judged by the spectrum's area."""
        return self.axis is None and any(self.notches.get(number) for number in self.axes)

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """All unknowns, by the names of their columns."""
        found = []
        for number in self.axes:
            before = f"axis{number}_" if len(self.axes) > 1 else ""
            said = f"axis {number}: " if before else ""
            found += [Unknown(before + each.name, each.key, each.kind, said + each.label) for each in AXIS_UNKNOWNS]
        return (*found, *SENSOR_UNKNOWNS)

    def _targets(self) -> tuple[Real, Real]:
        """Return times and set-points in counts, shape (n, axes)."""
        robot = self.robot
        for name in ("constant_acceleration", "line_motion"):
            motion = getattr(robot, name)
            if motion is not None and motion.tail_s < TAIL_S:
                robot = robot.model_copy(update={name: motion.model_copy(update={"tail_s": TAIL_S})})
        _, times, angles = references(robot, self.axis, robot.sync_period_s)
        per_rad = np.array([robot.axis[number].encoder_counts_per_rev / (2.0 * math.pi) for number in self.axes])
        return times, np.round(angles * per_rad)

    @cached_property
    def times(self) -> Real:
        """Times of the set-points, shape (n,)."""
        return self._targets()[0]

    @cached_property
    def set_points(self) -> Real:
        """Set-points in counts from the beginning of the motion; shape (n, axes)."""
        return self._targets()[1]

    @cached_property
    def cascades(self) -> dict[int, Cascade]:
        """Return the gains as rounded by the bus."""
        return {number: gains_as_uploaded(self.controls[number]) for number in self.axes}

    @cached_property
    def filters(self) -> dict[int, tuple[Notch, ...]]:
        """Return the filters as rounded by the bus."""
        return {number: tuple(as_uploaded(notch) for notch in self.notches.get(number, ())) for number in self.axes}

    @cached_property
    def f_al_hz(self) -> float:
        """Peak of the file's |G_al| in Hz; in line motion, axis 2's."""
        return self._f_al_of(self.robot)

    def _f_al_of(self, robot: Robot) -> float:
        number = self.axes[0]
        return Loop(linear_plant(robot.axis[number]), self.cascades[number], (), robot.control_period_s).peak_hz()

    @cached_property
    def _laws(self) -> dict[int, list[Block]]:
        """Laws of each axis, their filters frozen at all speeds at which they act."""
        found = {}
        for number in self.axes:
            filters, plant = self.filters[number], linear_plant(self.robot.axis[number])
            ends = [each.end_rps for each in filters]
            inner = [speed for each in filters for speed in np.arange(each.start_rps, each.end_rps, SPEED_STEP_RPS)]
            loop = Loop(plant, self.cascades[number], filters, self.robot.control_period_s)
            found[number] = frozen_laws(loop, np.unique([0.0, *inner, *ends]))
        return found

    @cached_property
    def _following_reach_rev(self) -> Real:
        """Largest distance of each motor from its set-point in revolutions; shape (axes,)."""
        counts = np.array([self.robot.axis[number].encoder_counts_per_rev for number in self.axes])
        fastest = np.max(np.abs(np.diff(self.set_points, axis=0)), axis=0) / counts / self.robot.sync_period_s
        gains = np.array([self.cascades[number].position_gain_per_s for number in self.axes])
        return np.asarray(FOLLOWING_REACH * fastest / gains + FOLLOWING_REST_REV)

    def draw(self, index: int) -> Drawn:
        """Draw a plant, and the source of its runs' noise.

        Index −1 is the robot of the file.

        Each axis and the accelerometer have a source of their own, `SeedSequence(seed, spawn_key=(axis or 0, index))`: axis
        2 in the line motion is the plant of the same index of axis 2 alone.
        """
        values: dict[str, float] = {}
        axes = {}
        for number in self.axes:
            source = self._source(number, index)
            mine = drawn(AXIS_UNKNOWNS, self.spread, source) if index >= 0 else nominal(AXIS_UNKNOWNS)
            before = f"axis{number}_" if len(self.axes) > 1 else ""
            values |= {before + name: value for name, value in mine.items()}
            axes[number] = axis = drawn_axis(self.robot.axis[number], mine)
            if axis.current_time_constant_s < self.robot.control_period_s / self.robot.plant_substeps:  # it settles too fast
                axes[number] = axis.model_copy(update={"current_time_constant_s": 0.0})
        source = self._source(0, index)
        mine = drawn(SENSOR_UNKNOWNS, self.spread, source) if index >= 0 else nominal(SENSOR_UNKNOWNS)
        changed = {
            "axis": axes,
            "accelerometer": drawn_sensor(self.robot.accelerometer, mine),
            "seed": int(source.integers(2**62)),
        }
        if self.axis is not None:  # axes that rest are left out: nothing of them reaches those that move
            changed |= {"geometry": None, "line_motion": None}
        robot = self.robot.model_copy(update=changed)
        return DrawnPlant(values | mine, robot), source

    def _source(self, number: int, index: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number, index) if index >= 0 else (number,)))

    def runs(self, plants: Sequence[Drawn], filters: Mapping[int, tuple[Notch, ...]] | None = None) -> list[SimulatedMotion]:
        """Simulate a closed-loop run of each plant; `filters` replace the study's own."""
        robots = [Axes(plant.robot) for plant, _ in plants]
        for axes in robots:
            for row, number in enumerate(axes.numbers):
                axes.plant[row]["home_angle_rad"] = self.robot.home_angle(number)
                hang_at_rest(axes.plant[row], axes.plant_state[row])
        chosen = self.filters if filters is None else filters
        laws = {number: LawOfAxis(self.cascades[number], chosen.get(number, ())) for number in self.axes}
        found = []
        for (plant, source), run in zip(plants, follow(robots, laws, self.set_points, self.periods), strict=True):
            measured = tip_sensor(plant.robot.accelerometer, source).samples(run.sensed_m_s2)[:, 2]
            found.append(SimulatedMotion(run, measured, self._f_al_of(plant.robot)))
        return found

    def run(self, plant: DrawnPlant, source: np.random.Generator) -> SimulatedMotion:
        """Simulate one closed-loop run."""
        return self.runs([(plant, source)])[0]

    def judge(self, index: int) -> Row:
        """Draw a plant, run it, judge it; return its row."""
        return self.judge_some([index])[0]

    def judge_some(self, indices: Sequence[int]) -> list[Row]:
        """Draw plants, run them in lock-step, judge each; return their rows."""
        drawn = [self.draw(index) for index in indices]
        motions = self.runs(drawn)
        bare = self.runs([self.draw(index) for index in indices], {}) if self.is_by_area else motions  # the same noise too
        plants = [plant for plant, _ in drawn]
        return [self._judged(*each) for each in zip(indices, plants, motions, bare, strict=True)]

    def _judged(self, index: int, plant: DrawnPlant, motion: SimulatedMotion, bare: SimulatedMotion) -> Row:
        period_s, axes = self.robot.control_period_s, plant.robot.axis
        growth = max(growth_per_s(axes[number], self._laws[number], period_s) for number in self.axes)
        faults = ["poles"] if growth >= 0.0 else []
        if not motion.is_finite:
            results = math.inf, math.inf, None, math.inf, math.inf, growth, " ".join(("diverged", *faults)), False
            return dict(zip(RESULTS, (index, *results), strict=True)) | plant.values
        peak, rms = self._tip_in_window(motion)
        residual = self._residual(motion, faults)
        following = self._following_error_rev(motion)
        if np.any(following > self._following_reach_rev):
            faults.append("following")
        reduction = None
        if self.is_by_area:
            reduction = 100.0 * (1.0 - self._area(motion) / self._area(bare))
        is_within = peak <= self.tip_mm if reduction is None else reduction >= self.area_reduction_percent
        errors = float(np.max(following)), residual, growth, " ".join(sorted(faults))
        return dict(zip(RESULTS, (index, peak, rms, reduction, *errors, is_within and not faults), strict=True)) | plant.values

    def result(self, row: Row) -> float:
        """Return the number by which a plant is judged: its tip peak in mm, or the reduction of the area in percent.

        It is infinitely bad if it could not be measured.
        """
        found = row["area_reduction_percent" if self.is_by_area else "tip_peak_mm"]
        return found if isinstance(found, float) else -math.inf

    def _tip_in_window(self, motion: SimulatedMotion) -> tuple[float, float]:
        """Return the window's largest and mean square tip displacement, as measured."""
        scale = tip_scale(motion.f_al_hz)
        displacement = tip_displacement_mm(motion.measured_m_s2, self.robot.sync_period_s, scale)[self._window(motion)]
        if len(displacement) < WINDOW_SAMPLES:
            return math.inf, math.inf
        return float(np.max(np.abs(displacement))), float(np.sqrt(np.mean(displacement**2)))

    def _window(self, motion: SimulatedMotion) -> NDArray[np.bool_]:
        """Return the rows in which the tip is judged."""
        if self.axis is None:
            start, (begin_s, end_s) = self._line_start_s(), line_window_s(self._line_s())
            return np.asarray((self.times >= start + begin_s) & (self.times <= start + end_s))
        angle, period_s = (
            motion.run.position_counts[:, 0] / self.robot.axis[self.axis].encoder_counts_per_rev,
            self.robot.sync_period_s,
        )
        return rising_within(np.abs(speed_of(angle, period_s)), period_s, order_window_rps(motion.f_al_hz, JUDGED_ORDER))

    def _line_start_s(self) -> float:
        return 0.0 if self.robot.line_motion is None else self.robot.line_motion.dwell_s

    def _line_s(self) -> float:
        return 0.0 if self.robot.line_motion is None else self.robot.line_motion.duration_s

    def _area(self, motion: SimulatedMotion) -> float:
        """Return the area of a line motion's amplitude spectrum."""
        start = self._line_start_s()
        inside = (self.times >= start) & (self.times <= start + self._line_s())
        return area(*amplitude_spectrum(motion.measured_m_s2[inside], self.robot.sync_period_s, "boxcar"), LINE_BAND_HZ)

    def _following_error_rev(self, motion: SimulatedMotion) -> Real:
        """Return each motor's largest distance from its set-point, shape (axes,).

        It is in revolutions, and measured from the set-point that the motor should have reached.
        """
        counts = np.array([self.robot.axis[number].encoder_counts_per_rev for number in self.axes])
        reached = np.concatenate([self.set_points[:1], self.set_points[:-1]])
        return np.asarray(np.max(np.abs(reached - motion.run.position_counts), axis=0) / counts)

    def _residual(self, motion: SimulatedMotion, faults: list[str]) -> float:
        """Return the true vibration at the end, in mm."""
        quarter = round(0.5 * TAIL_S / self.robot.sync_period_s)
        f_al, period_s = motion.f_al_hz, self.robot.sync_period_s
        swing = 1e3 * without_phase(motion.run.tip_m_s2[:, 2], period_s, "highpass", tip_scale(f_al).band_hz[0])
        swing /= (2.0 * math.pi * f_al) ** 2
        before, last = swing[-2 * quarter : -quarter], swing[-quarter:]
        residual = float(np.max(np.abs(last)))
        if residual > SEEN_FRACTION * self.tip_mm and np.std(last) > DECAY * np.std(before):
            faults.append("vibration")
        limits = np.array([self.robot.axis[number].torque_limit_nm for number in self.axes])
        if np.any(np.std(motion.run.torque_nm[-quarter:], axis=0) > RIPPLE_FRACTION * limits):
            faults.append("torque")
        return residual


IN_STEP = 4
"""Plants that are simulated in lock-step."""
MOST_TOGETHER = 12 * IN_STEP
"""Most plants of a bundle.

Each bundle prepares its study anew: 1 ms with a filter; a plant takes 9 to 14 ms (one core of a two-core machine).
"""

Plant = tuple[int, int]
"""Number of a study, and index of a plant."""


def judge_all(
    studies: Sequence[Study], runs: int, executors: Executors, on_done: Callable[[int], None] = lambda count: None
) -> list[list[Row]]:
    """Judge plants 0, 1, … of each study.

    Raises:
        ValueError: No runs.
        RuntimeError: A process died twice at the same plant.
        ExecutorsLostError: All executors are lost.
    """
    if runs < 1:
        raise ValueError(f"{runs} runs; at least 1 is needed")
    found: list[list[Row]] = [[] for _ in studies]

    def keep(judged: tuple[int, Row]) -> None:
        found[judged[0]].append(judged[1])
        on_done(1)

    plants = product(range(len(studies)), range(runs))
    with executors:
        run_all(plants, _judge, (tuple(studies),), executors, keep, _crashed, MOST_TOGETHER, takes_bundles=True)
    return [sorted(each, key=lambda row: numbers([row], "index")) for each in found]


def _judge(plants: Sequence[Plant], studies: Sequence[Study]) -> list[tuple[int, Row]]:
    found: list[tuple[int, Row]] = []
    for number, of_study in groupby(plants, key=itemgetter(0)):
        while indices := [index for _, index in islice(of_study, IN_STEP)]:
            found += [(number, row) for row in studies[number].judge_some(indices)]
    return found


def _crashed(plant: Plant) -> tuple[int, Row]:
    raise RuntimeError(f"plant {plant[1]}: {CRASHED_WORDS}")
