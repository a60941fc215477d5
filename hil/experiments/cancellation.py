"""Cancellation of the transmission error in a run: from the model file to a corrector, and its trial on the accelerometer.

A correction that is wrong by more than 60° makes the vibration worse, so none is trusted before a trial: the motion without it,
then with a small share of it, of all axes and of each. Where the vibration does not fall by at least half of what it should, the
correction is refused, and the notch stays.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.analysis import LINE_WINDOW_S, WINDOWS_RPS, band_passed, motor_speed_rps
from hil.control.compensation import Compensation, Correction
from hil.design.frequency import ARCSEC
from hil.design.inverse import CyclicTiming, Way, correction
from hil.errors import HilError, NotPossibleError, UnsafeRequestError
from hil.master.bench import Bench, Model, TransmissionError
from hil.master.identified import Identified, with_identified
from hil.master.motion import Motion, RunResult
from hil.master.session import Compensation as FilterChoice
from hil.master.session import Session
from hil.recording import Recording

Real = NDArray[np.float64]
Rows = NDArray[np.bool_]

CONTROL_PERIOD_S = 250e-6
"""T_c of a drive that does not state its own."""
MAX_REFERENCE_REV = 0.02
"""Largest correction of a set-point, motor side: 120″ on a gear of 120 at 12 Hz. What asks for more is no transmission error."""
MAX_TORQUE_SHARE = 0.1
"""Of the torque limit, for torque offsets."""
PROBE_GAIN = 0.3
LEAST_SHARE = 0.5
"""Of the fall that a right correction brings: 45° of phase error still pass, 60° do not."""
WORSE = 0.02
"""By how much one axis' share may seem to raise the vibration: noise of the sensor, on an axis that has little part in it."""


class CancellationRefusedError(HilError):
    """The trial on the accelerometer speaks against the correction: it is not used, and the notch stays."""

    exit_code = 9

    def __init__(self, what: str, fall: float, needed: float) -> None:
        """Keep which correction, how far the vibration fell as a share, and how far it should have at least."""
        self.what, self.fall, self.needed = what, fall, needed
        change = f"fell by {100.0 * fall:.1f} %" if fall >= 0.0 else f"rose by {-100.0 * fall:.1f} %"
        super().__init__(
            f"cancellation refused: with {what} the vibration {change}, a fall of at least {100.0 * needed:.1f} % is needed; "
            "the notch stays"
        )


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
    found = []
    for number in axes:
        model = _model(session.bench, identified, number)
        if model is None:
            continue
        axis, amplitudes = session.axes[number], _amplitudes(model.ate)
        if "cancellation.mode" not in axis.profile.parameters:
            raise NotPossibleError(f"axis {number}: drive family {axis.profile.name} cancels nothing by itself")
        motor = {f"a{order}_rad": gain * axis.table.reduction_ratio * size for order, size in amplitudes.items()}
        turns = {f"phi{order}_rad": math.radians(degrees) for order, degrees in _phases_deg(model.ate).items()}
        values = {f"a{order}_rad": 0.0 for order in (2, 4)} | motor | turns
        values |= {"motor_inertia_kg_m2": model.motor_inertia_kg_m2, "motor_damping_nm_s_rad": model.motor_damping_nm_s_rad}
        for name, value in values.items():
            axis.write_parameter(f"cancellation.{name}", value)
        axis.write_parameter("cancellation.mode", 1)
        found.append(number)
    if not found:
        raise NotPossibleError(_nothing_known(axes))
    return tuple(found)


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


# -- the trial -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trial:
    """One run of a trial against the run without correction.

    Attributes:
        what: What was corrected, in words.
        rms_m_s2: Vibration of the tip in the window, 6 to 25 Hz.
        fall: By which share it is below that of the run without.
        needed: By which it had to be.
    """

    what: str
    rms_m_s2: float
    fall: float
    needed: float

    @property
    def is_good(self) -> bool:
        """Whether it fell far enough."""
        return self.fall >= self.needed


@dataclass(frozen=True)
class Verification:
    """What a trial gave.

    Attributes:
        before_m_s2: Vibration without the correction.
        gain: Share of the correction that was tried.
        trials: All axes, then each alone where there are several.
        runs: Recordings by name.
    """

    before_m_s2: float
    gain: float
    trials: tuple[Trial, ...]
    runs: Mapping[str, Recording]

    @property
    def is_good(self) -> bool:
        """Whether the correction may be trusted."""
        return all(trial.is_good for trial in self.trials)

    def record(self) -> dict[str, Any]:
        """As result.json holds it."""
        trials = [{**vars(trial), "is_good": trial.is_good} for trial in self.trials]
        return {"before_m_s2": self.before_m_s2, "gain": self.gain, "is_good": self.is_good, "trials": trials}

    def demand(self) -> None:
        """Go on only with a good one.

        Raises:
            CancellationRefusedError: A trial speaks against it.
        """
        for trial in self.trials:
            if not trial.is_good:
                raise CancellationRefusedError(trial.what, trial.fall, trial.needed)


def judged_rows(bench: Bench, recording: Recording) -> Rows:
    """Rows in which vibration is compared: the line motion's window, or a single axis' speeds at which an order excites the arm.

    Raises:
        NotPossibleError: The motion passes no such speed.
    """
    if len(recording.axes) > 1 and bench.line_motion is not None:
        time, start = recording.time_s, bench.line_motion.dwell_s
        return np.asarray((time >= start + LINE_WINDOW_S[0]) & (time <= start + LINE_WINDOW_S[1]))
    speed = np.abs(motor_speed_rps(recording, recording.axes[0]))
    rows = np.zeros(len(speed), dtype=np.bool_)
    for low, high in WINDOWS_RPS.values():
        rows |= (speed >= low) & (speed <= high)
    if np.count_nonzero(rows) * recording.period_s < 0.1:
        raise NotPossibleError("a motion that does not excite the arm tells nothing of a correction")
    return rows


def vibration_m_s2(recording: Recording, rows: Rows) -> float:
    """Root mean square of the tip's vertical acceleration from 6 to 25 Hz in some rows."""
    return float(np.sqrt(np.mean(band_passed(recording.columns["tip_z_m_s2"], recording.period_s)[rows] ** 2)))


def verify(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    compensation: FilterChoice = "none",
    *,
    gain: float = PROBE_GAIN,
    announce: Callable[[str], None] = lambda text: None,
) -> Verification:
    """Try a small share of a correction on the robot: the motion without, with, and with each axis' alone.

    Args:
        session: Brought up.
        cancellation: For the axes of the motion.
        motion: One that excites the arm: the very motion that is to be run with it.
        compensation: Whether the drives' filters act, in all of these runs.
        gain: The share.
        announce: Called before each run.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    announce("trial of the cancellation: without")
    first = _run(session, motion, compensation, None)
    rows = judged_rows(session.bench, first)
    before = vibration_m_s2(first, rows)
    runs, trials = {"without": first}, []
    several = len(cancellation.corrections) > 1
    for only in (None, *(cancellation.corrections if several else ())):
        what = f"{100.0 * gain:g} % of it" + ("" if only is None else f" on axis {only} alone")
        announce(f"trial of the cancellation: {what}")
        recording = _run(session, motion, compensation, cancellation.corrector(gain, only))
        runs["all" if only is None else f"axis{only}"] = recording
        found = vibration_m_s2(recording, rows[: len(recording.time_s)])
        trials.append(Trial(what, found, 1.0 - found / max(before, 1e-30), LEAST_SHARE * gain if only is None else -WORSE))
    return Verification(before, gain, tuple(trials), runs)


def _run(session: Session, motion: Motion, compensation: FilterChoice, corrector: Canceller | None) -> Recording:
    session.check_interrupt()
    result: RunResult = session.run(motion, compensation, "drive", corrector)
    if result.stopped is not None:
        raise result.stopped
    return result.recording


def averaged(recordings: Sequence[Recording]) -> Recording:
    """The mean of recordings of the same motion, row by row: the sensor's noise falls with the root of their number.

    Raises:
        ValueError: None, or not of the same motion.
    """
    shapes = {(tuple(recording.columns), len(recording.time_s)) for recording in recordings}
    if len(shapes) != 1:
        raise ValueError(f"{len(recordings)} recordings of {len(shapes)} kinds have no mean")
    first = recordings[0].columns
    return Recording({name: np.mean([recording.columns[name] for recording in recordings], axis=0) for name in first})
