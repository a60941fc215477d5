"""Cancellation of the transmission error in a run: from the model file to a corrector, or into drives that cancel by themselves.

The correction is bounded by its table, and checked with the motion against every limit before anything moves. None is trusted
before its trial on the accelerometer: `hil.experiments.cancellation_trial`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drive_profiles.profile import Profile
from hil.control.compensation import Compensation, Correction
from hil.design.frequency import ARCSEC
from hil.design.inverse import CyclicTiming, Way, correction
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.master.bench import Bench, Model, TransmissionError
from hil.master.identified import Identified, with_identified
from hil.master.motion import Motion
from hil.master.session import Session

CONTROL_PERIOD_S = 250e-6
"""T_c of a drive that does not state its own."""
MAX_REFERENCE_REV = 0.02
"""Largest correction of a set-point, motor side: 120″ on a gear of 120 at 12 Hz. What asks for more is no transmission error."""
MAX_TORQUE_SHARE = 0.1
"""Of the torque limit, for torque offsets."""


@dataclass
class Canceller:
    """A `hil.master.correction.Corrector`: good for one run.

    Attributes:
        uses_torque: Whether torque offsets (60B2h) are mapped.
    """

    uses_torque: bool
    _laws: Compensation

    def step(self, references_rad: Sequence[float], positions_rad: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
        """The corrections of the next cycle, from the measured angles of the last."""
        return self._laws.step(positions_rad)


@dataclass(frozen=True)
class Cancellation:
    """What is to be added to the set-points of some axes.

    Attributes:
        axes: In the order of the motion.
        corrections: By axis; an axis without is left alone.
        period_s: SYNC period.
        way: By the set-point alone, or with a torque offset.
        torque_steps_nm: What torque offsets are rounded to, by axis.
    """

    axes: tuple[int, ...]
    corrections: Mapping[int, Correction]
    period_s: float
    way: Way = "reference"
    torque_steps_nm: Mapping[int, float] = field(default_factory=dict)

    def corrector(self, gain: float = 1.0, only: int | None = None) -> Canceller:
        """For one run.

        Args:
            gain: Share of the correction.
            only: Correct this axis alone.
        """
        wanted = [self.corrections[n].scaled(gain) if n in self.corrections and only in {None, n} else None for n in self.axes]
        steps = [self.torque_steps_nm.get(number, 0.0) for number in self.axes]
        return Canceller(self.way == "torque", Compensation(wanted, self.period_s, steps))

    def check(self, bench: Bench, motion: Motion, starts_rad: Sequence[float] | None = None) -> None:
        """Hold the motion, and the way to its start, with the largest possible correction against the limits.

        Raises:
            UnsafeRequestError: It could leave one.
        """
        turn = 2.0 * math.pi
        for column, number in enumerate(self.axes):
            if number not in self.corrections:
                continue
            limits, name, own = bench.axis[number].limits, f"axis {number}", self.corrections[number]
            angle = motion.motor_angle_rad[:, column] + (0.0 if starts_rad is None else starts_rad[column])
            peak_rps = max(float(np.max(np.abs(np.diff(angle)))) / motion.period_s / turn, bench.approach_rps)
            reach_rev = own.largest_reference_rad(peak_rps) / turn
            remedy = "is this its transmission error?"
            if reach_rev > MAX_REFERENCE_REV:
                raise UnsafeRequestError(f"the correction of {name}", reach_rev, MAX_REFERENCE_REV, "rev", remedy)
            torque, allowed = own.largest_torque_nm(peak_rps), MAX_TORQUE_SHARE * limits.torque_nm
            if torque > allowed:
                raise UnsafeRequestError(f"the torque offset of {name}", torque, allowed, "N·m", remedy)
            speed = peak_rps + own.largest_rate_rps(peak_rps)
            if speed > limits.speed_rps:
                raise UnsafeRequestError(f"the speed of {name} with its correction", speed, limits.speed_rps, "rps")
            high, low = float(angle.max()) / turn + reach_rev, float(angle.min()) / turn - reach_rev
            if high > limits.position_max_rev:
                raise UnsafeRequestError(f"the position of {name} with its correction", high, limits.position_max_rev, "rev")
            if low < limits.position_min_rev:
                raise UnsafeRequestError(f"the position of {name} with its correction", low, limits.position_min_rev, "rev")


def cancellation_for(
    bench: Bench,
    identified: Identified | None,
    axes: Sequence[int],
    period_s: float,
    *,
    way: Way = "reference",
    with_notch: bool = False,
    control_periods_s: Mapping[int, float] | None = None,
    torque_steps_nm: Mapping[int, float] | None = None,
    delay_s: float = 0.0,
) -> Cancellation:
    """The cancellation of some axes, from what is known of them.

    By the set-point alone (607Ah) needs no more of a drive than CSP, and no room on the bus. With a torque offset (60B2h, two
    more bytes for each axis) the law has nothing to do for the correction, so no filter in it matters. Both do equally well at
    SYNC periods of 1 and 2 ms without a filter; on 1 Mbit/s three axes with torque offsets need 2 ms.

    Args:
        bench: The bench file.
        identified: The model file; None: what the bench file believes.
        axes: Of the motion, in its order.
        period_s: SYNC period.
        way: By the set-point alone, or with a torque offset.
        with_notch: Whether the drives' filters act.
        control_periods_s: T_c by axis; 250 µs where it is not given.
        torque_steps_nm: What the drives round torque offsets to, by axis.
        delay_s: Of set-points, beyond the SYNC period, the interpolation, and what the model file says.

    Raises:
        NotPossibleError: The model file is another robot's, or nothing is known of any of the axes.
    """
    found: dict[int, Correction] = {}
    for number in axes:
        model = _model(bench, identified, number)
        if model is None:
            continue
        table = bench.axis[number].model_copy(update={"model": model})
        phases = {order: math.radians(degrees) for order, degrees in _phases_deg(model.ate).items()}
        period = (control_periods_s or {}).get(number) or CONTROL_PERIOD_S
        loop = table.loop(period, with_notch=with_notch)
        assert loop is not None  # noqa: S101 - it has a model
        try:
            timing = CyclicTiming(period_s, period, delay_s + measured_delay_s(identified, number))
            found[number] = correction(loop, _amplitudes(model.ate), phases, timing, table.limits.speed_rps, way)
        except ValueError as error:
            raise NotPossibleError(f"axis {number}: {error}") from error
    if not found:
        raise NotPossibleError(_nothing_known(axes))
    return Cancellation(tuple(axes), found, period_s, way, torque_steps_nm or {})


def measured_delay_s(identified: Identified | None, number: int) -> float:
    """What the model file says of the set-points' delay of an axis."""
    part = None if identified is None or number not in identified.axis else identified.axis[number].ate
    return 0.0 if part is None else part.set_point_delay_s


def corrector_for(
    bench: Bench, identified: Identified | None, axes: Sequence[int], period_s: float, *, gain: float = 1.0, **options: Any
) -> Canceller:
    """`cancellation_for` and its corrector in one."""
    return cancellation_for(bench, identified, axes, period_s, **options).corrector(gain)


def cancellation_on(
    session: Session,
    identified: Identified | None,
    motion: Motion,
    *,
    way: Way = "reference",
    with_notch: bool = False,
    delay_s: float = 0.0,
) -> Cancellation:
    """The cancellation of a motion on a session that has been brought up: periods and scales from the drives, limits checked.

    Raises:
        NotPossibleError: As `cancellation_for`.
        UnsafeRequestError: The motion with its correction could leave a limit.
        HilError: A drive does not answer.
    """
    axes = {number: session.axes[number] for number in motion.axes}
    found = cancellation_for(
        session.bench,
        identified,
        motion.axes,
        motion.period_s,
        way=way,
        with_notch=with_notch,
        control_periods_s={number: axis.control_period_s() for number, axis in axes.items()},
        torque_steps_nm={number: axis.scaling.torque_nm(1) for number, axis in axes.items()},
        delay_s=delay_s,
    )
    starts = None if motion.starts_at_home else [axis.position_rad() for axis in axes.values()]
    found.check(session.bench, motion, starts)
    return found


def cancel_inside(session: Session, identified: Identified | None, axes: Sequence[int], gain: float = 1.0) -> tuple[int, ...]:
    """Let the drives cancel the error in their own loops, where their family can, in the next run; it puts everything back.

    Nothing more goes over the bus in a cycle, and no delay has to be known.

    Args:
        session: Brought up.
        identified: The model file; None: what the bench file believes.
        axes: Of the motion.
        gain: Share of the correction.

    Returns:
        The axes that do.

    Raises:
        NotPossibleError: A drive that should cannot, a correction is beyond what it takes, or nothing is known of any axis.
        HilError: A drive does not answer, or refuses.
    """
    models = inside_models(session.bench, identified, axes)
    for number, model in models.items():
        axis, amplitudes = session.axes[number], _amplitudes(model.ate)
        motor = {f"a{order}_rad": gain * axis.table.reduction_ratio * size for order, size in amplitudes.items()}
        turns = {f"phi{order}_rad": math.radians(degrees) for order, degrees in _phases_deg(model.ate).items()}
        values = {f"a{order}_rad": 0.0 for order in (2, 4)} | motor | turns
        values |= {"motor_inertia_kg_m2": model.motor_inertia_kg_m2, "motor_damping_nm_s_rad": model.motor_damping_nm_s_rad}
        for name, value in values.items():
            axis.write_parameter(f"cancellation.{name}", value)
        axis.write_parameter("cancellation.mode", 1)
    return tuple(models)


def inside_models(bench: Bench, identified: Identified | None, axes: Sequence[int]) -> dict[int, Model]:
    """What is known of those of the axes whose drives are to cancel the error by themselves.

    Raises:
        NotPossibleError: A drive family that cannot, or nothing is known of any axis.
    """
    found = {number: model for number in axes if (model := _model(bench, identified, number)) is not None}
    for number in found:
        profile = Profile.load(bench.axis[number].profile)
        if "cancellation.mode" not in profile.parameters:
            raise NotPossibleError(f"axis {number}: drive family {profile.name} cancels nothing by itself")
    if not found:
        raise NotPossibleError(_nothing_known(axes))
    return found


def _model(bench: Bench, identified: Identified | None, number: int) -> Model | None:
    """What is known of an axis; None where that is too little to correct it.

    Raises:
        NotPossibleError: The model file is another robot's, or the bench has no such axis.
    """
    if identified is not None and identified.robot != bench.name:
        raise NotPossibleError(f"the model file is of {identified.robot!r}, this is {bench.name!r}: choose another")
    if number not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {number}")
    model = (bench if identified is None else with_identified(bench, identified)).axis[number].model
    return model if model is not None and _amplitudes(model.ate) else None


def _amplitudes(ate: TransmissionError) -> dict[int, float]:
    """A_k in rad, of the orders that there are."""
    return {order: a * ARCSEC for order, a in ((2, ate.a2_arcsec), (4, ate.a4_arcsec)) if a > 0.0}


def _phases_deg(ate: TransmissionError) -> dict[int, float]:
    """φ_k from 0 to 360°."""
    return {2: ate.phi2_deg % 360.0, 4: ate.phi4_deg % 360.0}


def _nothing_known(axes: Sequence[int]) -> str:
    names = " or ".join(map(str, axes))
    return f"no transmission error, or no motor inertia, is known of axis {names}: hil identify, or a model in the bench file"
