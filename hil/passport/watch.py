"""Trends of a passport: orders over dates, with alarms."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.bench.model import SIGNIFICANT_SIGMAS
from hil.control.arrays import Real
from hil.passport.alarm import AlarmLimits, Watched, unwound_deg, watched
from hil.passport.conditions import RunCondition, design_of
from hil.passport.origin import Conditions, Motor, OriginName, origin_of_order
from hil.passport.regression import FEWEST_BEFORE
from hil.passport.store import OrderLine, PassportRun

FALSE_ALARMS = 1e-3
"""False alarms in one run of a gear, of all its orders together."""
DIRECTIONS = {"forward": 1, "backward": -1}
LEAST_TOLD = 0.05
"""Fraction of a scatter from which it is said that a condition explains it."""


@dataclass(frozen=True, eq=False)
class Trend:
    """One order of one gear over its dates.

    Attributes:
        values: Amplitudes in arcsec, or phases in degrees, unwound.
    """

    robot: str
    axis: int
    order: float
    dates: tuple[str, ...]
    values: Real
    errors: Real
    is_phase: bool
    watch: Watched
    origin: OriginName
    why: str

    @property
    def is_alarmed(self) -> bool:
        """True from the run with the first alarm on."""
        return self.watch.first is not None

    @property
    def is_watched(self) -> bool:
        """True if there are enough runs."""
        return len(self.values) > FEWEST_BEFORE

    @property
    def symbol(self) -> str:
        """Its quantity: `A_2` or `φ_2`."""
        return f"{'φ' if self.is_phase else 'A'}_{self.order:g}"

    @property
    def unit(self) -> str:
        """Its unit."""
        return "°" if self.is_phase else "arcsec"

    @property
    def words(self) -> str:
        """The alarm as a line; empty without one."""
        first = self.watch.first
        if first is None:
            return ""
        now, before = float(self.values[-1]), self.watch.expected
        change = f"{now - before:+.1f}°" if self.is_phase or before <= 0.0 else f"{100.0 * (now / before - 1.0):+.0f} %"
        return (
            f"{self.robot}, axis {self.axis}: {self.symbol} = {now:.2f} {self.unit} on {self.dates[-1][:10]}, {before:.2f} ± "
            f"{self.watch.scatter:.2f} expected from the {first} runs before the alarm of {self.dates[first][:10]} ({change})"
        )

    @property
    def explained_words(self) -> str:
        """Fractions of the scatter that conditions explain: `temperature 82 %`."""
        found = self.watch.explained.items()
        return ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in found if part >= LEAST_TOLD)


@dataclass(frozen=True)
class OrderOrigin:
    """Origin of an order of a gear."""

    robot: str
    axis: int
    order: float
    name: OriginName
    why: str


def gears_of(runs: Sequence[PassportRun], since: str = "") -> dict[tuple[str, int], list[PassportRun]]:
    """Return the runs of each gear from a date on."""
    gears: dict[tuple[str, int], list[PassportRun]] = {}
    for run in sorted(runs, key=lambda each: (each.measured_utc, each.content)):
        if run.measured_utc >= since:
            gears.setdefault((run.robot, run.axis), []).append(run)
    return dict(sorted(gears.items()))


def origins(runs: Sequence[PassportRun], motors: Mapping[int, Motor], since: str = "") -> list[OrderOrigin]:
    """Return the origins of all orders.

    The orders of the model files, and those that runs in either direction show beside them. Poles and slots of the runs' bench
    files replace missing ones; runs count from `since` on, ISO 8601.
    """
    made = []
    for (robot, axis), own in gears_of(runs, since).items():
        motor = _motor(own, motors.get(axis, Motor()))
        orders = {line.order for run in own for line in run.lines}
        torques = [run for run in own if run.seen_by == "torque"]
        for order in sorted(orders | {side.order for run in torques for side in run.sides}):
            found = [_conditions(run, line) for run in own for line in run.lines if line.order == order]
            sides = [side for run in torques for side in run.sides if side.order == order]
            name, why = origin_of_order(order, motor, found, sides)
            if order in orders or name == "motor":
                made.append(OrderOrigin(robot, axis, order, name, why))
    return made


def _motor(runs: Sequence[PassportRun], given: Motor) -> Motor:
    """Poles and slots: as given, else from the last bench file."""
    poles = [run.pole_pairs for run in runs if run.pole_pairs is not None]
    slots = [run.slots for run in runs if run.slots is not None]
    return Motor(given.pole_pairs or (poles[-1] if poles else None), given.slots or (slots[-1] if slots else None))


def trends(runs: Sequence[PassportRun], motors: Mapping[int, Motor], since: str = "") -> list[Trend]:
    """Trends of all gears, amplitude and phase of each order.

    Runs count from `since` on, ISO 8601: the date of a new gear, or of a change that is known.
    """
    made = []
    told = {(each.robot, each.axis, each.order): (each.name, each.why) for each in origins(runs, motors, since)}
    for (robot, axis), own in gears_of(runs, since).items():
        orders = sorted({line.order for run in own for line in run.lines})
        limits = AlarmLimits.of(FALSE_ALARMS, 2 * len(orders)) if orders else None
        for order in orders if limits is not None else ():
            found = [(run, line) for run in own for line in run.lines if line.order == order]
            for is_phase in (False, True):
                kept = [pair for pair in found if not is_phase or pair[1].a_arcsec >= SIGNIFICANT_SIGMAS * pair[1].a_error_arcsec]
                if kept and limits is not None:
                    made.append(_trend(robot, axis, order, kept, limits, told[robot, axis, order], is_phase=is_phase))
    return made


def _conditions(run: PassportRun, line: OrderLine) -> Conditions:
    largest = max(each.a_arcsec for each in run.lines)
    over = line.a_arcsec / largest if largest > 0.0 else 0.0
    return Conditions(line.a_arcsec, line.a_error_arcsec, run.load_kg, run.direction, run.seen_by, over)


def _condition(run: PassportRun) -> RunCondition:
    low, high = run.joint_low_deg, run.joint_high_deg
    middle = None if low is None or high is None else 0.5 * (low + high)
    return RunCondition(
        run.temperature_c, run.load_kg, run.top_rps, DIRECTIONS.get(run.direction or "", 0), middle,
        run.seen_by == "torque",
    )  # fmt: skip


def _trend(
    robot: str, axis: int, order: float, found: Sequence[tuple[PassportRun, OrderLine]], limits: AlarmLimits,
    origin: tuple[OriginName, str], *, is_phase: bool,
) -> Trend:  # fmt: skip
    lines = [line for _, line in found]
    values = unwound_deg(np.array([line.phi_deg for line in lines])) if is_phase else np.array([line.a_arcsec for line in lines])
    errors = np.array([line.phi_error_deg if is_phase else line.a_error_arcsec for line in lines])
    dates = tuple(run.measured_utc for run, _ in found)
    size = math.degrees(1.0) if is_phase else None
    watch = watched(values, errors, limits, design_of([_condition(run) for run, _ in found]), size)
    return Trend(robot, axis, order, dates, values, errors, is_phase, watch, *origin)
