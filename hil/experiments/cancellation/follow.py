"""Cancellation that follows the vibration in a run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.analysis import DIRECTIONS
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.cancellation import CancellationLaw
from hil.control.following import ArmModel, Followed, FollowingLaw, FollowingSettings, SecondDifference
from hil.design.following import arm_model, band_pass, resonance_of, rounding_noise_m_s2
from hil.errors import NotPossibleError
from hil.experiments.cancellation.cancellation import Cancellation, amplitudes_rad, phases_deg, treated_model
from hil.experiments.cancellation.follow_trial import BeginParts, HeardOrder
from hil.experiments.cancellation.waves import planned_levers
from hil.experiments.treatment import NO_FOLLOWING_BY_ENCODERS, NO_FOLLOWING_ON_ARM
from hil.master.motion import Motion
from hil.master.set_point_adder import Sensed
from hil.results.following import FollowedOrder

LEAST_CHANGE = 1e-3
"""Accuracy: change of a factor from which on the law is told of it."""
NEVER = 1e9
"""Accuracy: part of an order that is never left of it: any that is far above 1."""
MOST_SHOWN = 200
"""Bound: rows of a track, as many as a figure shows."""


@dataclass(frozen=True)
class FollowingSetUp:
    """Set-up of a cancellation that follows.

    Attributes:
        axes: Axis numbers that are cancelled, in the order of the rows of the observer.
        orders: Orders of each axis as they were identified.
        levers_m: Lever of the tip at each, by row of the motion; shape (n, axes).
        count_rad: Step of the joint's own encoder, which takes the accelerometer's place; None with an accelerometer.
    """

    cancellation: Cancellation
    axes: tuple[int, ...]
    arms: tuple[ArmModel, ...]
    orders: tuple[tuple[Followed, ...], ...]
    band: tuple[float, float, float, float, float]
    levers_m: Real
    count_rad: float | None = None

    def adder(self) -> "FollowingAdder":
        """Adder for one run."""
        plain = self.cancellation.adder()
        period_s, settings, difference = self.cancellation.period_s, FollowingSettings(), None
        if self.count_rad is not None:
            lever = float(self.levers_m[0, 0])
            rounding = rounding_noise_m_s2(self.count_rad, lever, self.band, period_s)
            settings = replace(settings, least_noise_m_s2=max(settings.least_noise_m_s2, rounding))
            difference = SecondDifference(lever, self.arms[0].f_al_hz, period_s)
        law = FollowingLaw(self.arms, self.orders, self.band, period_s, settings)
        return FollowingAdder(plain.uses_torque, plain.laws, law, self, difference)

    def beginning(self, parts: BeginParts) -> "FollowingSetUp":
        """Copy with the part at which each order begins; 0 if not named."""
        orders = tuple(
            tuple(each._replace(begin_part=parts.get((number, each.order), 0.0)) for each in own)
            for number, own in zip(self.axes, self.orders, strict=True)
        )
        return replace(self, orders=orders)

    def listening(self) -> "FollowingSetUp":
        """Copy of the set-up that observes and never follows."""
        return self.beginning(
            {(number, each.order): NEVER for number, own in zip(self.axes, self.orders, strict=True) for each in own}
        )


@dataclass
class FollowingAdder:
    """Set-point adder of a cancellation that follows."""

    uses_torque: bool
    _cancellation: CancellationLaw
    _law: FollowingLaw
    _set_up: FollowingSetUp
    _difference: SecondDifference | None = None
    _sensed: Sensed = Sensed(None, None)  # noqa: RUF009 - a tuple of nothing
    _row: int = 0
    _told: list[complex] = field(default_factory=list)
    _rows: list[list[complex]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Find the columns of the axes that follow."""
        self._columns = [self._set_up.cancellation.axes.index(number) for number in self._set_up.axes]

    def sense(self, sensed: Sensed) -> None:
        """Take the measured values of the last cycle."""
        self._sensed = sensed

    def step(
        self, references_rad: Sequence[float], positions_rad: Sequence[float], torques_nm: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        """Compute the additions of the next cycle.

        They follow from the measured angles and torques of the last cycle, and from the tip's acceleration.

        Returns:
            Additions to the references in rad at the motor, and torque offsets in N·m.
        """
        row, felt = self._sensed.row, self._felt_m_s2()
        self._row = self._row if row is None else row
        angles = [positions_rad[column] for column in self._columns]
        references = [references_rad[column] for column in self._columns]
        self._law.step(angles, references, self._set_up.levers_m[self._row], felt)
        self._tell()
        if row is not None:
            self._rows.append(self._told)
        return self._cancellation.step(positions_rad, torques_nm)

    def _felt_m_s2(self) -> float | None:
        """Acceleration of the tip, as a lever or a line's chain moves it, by sensor or the joint's encoder; None if unknown."""
        tip, turned = self._sensed.tip_m_s2, self._sensed.load_rad
        if self._difference is not None:
            return self._difference(None if turned is None else turned[self._columns[0]])
        return None if tip is None else tip[DIRECTIONS.index("z")]

    def _tell(self) -> None:
        """Multiply the cancellation by the present factors."""
        by_axis = [self._law.factors(row) for row in range(len(self._columns))]
        now = [factor for factors in by_axis for factor in factors.values()]
        if self._told and max(abs(new - old) for new, old in zip(now, self._told, strict=True)) < LEAST_CHANGE:
            return
        self._told = now
        for column, factors in zip(self._columns, by_axis, strict=True):
            self._cancellation.multiply(column, factors)

    def watched(self) -> tuple[HeardOrder, ...]:
        """Observation of each order so far."""
        found, at = [], 0
        for row, (number, orders) in enumerate(zip(self._set_up.axes, self._set_up.orders, strict=True)):
            nearest = self._law.nearest(row)
            for each in orders:
                has_moved = any(factors[at] != 1.0 for factors in self._rows)
                found.append(HeardOrder(number, each.order, nearest[each.order], has_moved))
                at += 1
        return tuple(found)

    def followed(self) -> tuple[FollowedOrder, ...]:
        """List how each order of each axis changed; empty before the motion began."""
        if not self._rows:
            return ()
        found, at, set_up = [], 0, self._set_up
        step = max(1, math.ceil(len(self._rows) / MOST_SHOWN))
        times = tuple(round(row * set_up.cancellation.period_s, 6) for row in range(0, len(self._rows), step))
        for row, (number, orders) in enumerate(zip(set_up.axes, set_up.orders, strict=True)):
            for each in orders:
                factors = np.array([factors[at] for factors in self._rows])
                at += 1
                size = each.amplitude_rad / ARCSEC * np.abs(factors)
                turn = math.degrees(each.phase_rad) + np.degrees(np.angle(factors))
                found.append(
                    FollowedOrder(
                        axis=number, order=each.order,
                        amplitude_start_arcsec=float(size[0]), amplitude_end_arcsec=float(size[-1]),
                        phase_start_deg=float(turn[0]) % 360.0, phase_end_deg=float(turn[-1]) % 360.0,
                        turned_deg=float(np.degrees(np.angle(factors[-1]))), was_taken_back=each.order in self._law.given_up(row),
                        time_s=times, amplitude_arcsec=tuple(size[::step].round(4).tolist()),
                        phase_deg=tuple(turn[::step].round(3).tolist()),
                    )
                )  # fmt: skip
        return tuple(found)


def following_of(bench: Bench, identified: Identified | None, cancellation: Cancellation, motion: Motion) -> FollowingSetUp:
    """Make the set-up of following a motion with what has passed its trial.

    Raises:
        NotPossibleError: The links of an arm move the tip, the arm of an axis is not known, or several axes move and only
            their own encoders tell of the tip.
    """
    if bench.arm is not None:
        raise NotPossibleError(NO_FOLLOWING_ON_ARM)
    numbers = tuple(number for number in motion.axes if number in cancellation.tables)
    by_encoder, late_s, count_rad = bench.accelerometer.from_load_encoders, 0.0, None
    if by_encoder and len(motion.axes) > 1:
        raise NotPossibleError(NO_FOLLOWING_BY_ENCODERS)
    if by_encoder:
        encoder, late_s = bench.axis[motion.axes[0]].load_encoder, motion.period_s  # a second difference is a period late
        count_rad = None if encoder is None else encoder.rad_per_count
    arms, orders = [], []
    for number in numbers:
        response, scale, table = cancellation.responses.get(number), cancellation.scales.get(number), bench.axis[number]
        model = treated_model(bench, identified, number)
        if response is None or scale is None or model is None:
            raise NotPossibleError(
                f"cancellation-following needs the arm of axis {number}, which is not known; give a model file of hil "
                "identify ate with --model"
            )
        try:
            resonance = resonance_of(replace(response, delay_s=0.0).at, scale.f_al_hz)
        except ValueError as error:
            raise NotPossibleError(f"axis {number}: {error}; measure it again with hil identify plant") from error
        arms.append(arm_model(resonance, table.reduction_ratio, motion.period_s, response.delay_s + late_s))
        sizes, phases = amplitudes_rad(model.ate), phases_deg(model.ate)
        own = [order for order in cancellation.tables[number].orders if order in sizes]
        orders.append(tuple(Followed(order, math.radians(phases[order]), sizes[order]) for order in own))
    f_al = [arm.f_al_hz for arm in arms]
    columns = [motion.axes.index(number) for number in numbers]
    return FollowingSetUp(
        cancellation, numbers, tuple(arms), tuple(orders), band_pass(min(f_al), max(f_al), motion.period_s),
        planned_levers(bench, motion)[:, columns], count_rad,
    )  # fmt: skip
