"""Adaptive cancellation: an axis goes to and fro, and what cancels its vibration is learnt from pass to pass, then frozen.

The first pass is without correction: the fit of its two ramps gives arm, sensor delay, A_k and φ_k, with nothing known before but
N, the lever and the motor's inertia. The second has half of the correction, every later one all of it. After each the fit is made
anew from all passes. It takes the motor angle as it was measured, correction and all, so it finds the transmission error itself
and not what is left of it: a good correction does not hide it. Both directions together tell φ_k from the sensor's delay.

How late the motor follows its corrections is measured as well, from its own encoder: a drive that has more delay than its SYNC
period and its interpolation would otherwise turn φ_k by 4.3° for each millisecond at 12 Hz.

Learning is between passes only. A correction that adapted through acceleration phases would follow the motion, not the error.
"""

import datetime
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from hil.analysis import TIP_BAND_HZ, motor_speed_rps
from hil.design.ate_identification import JointEstimate, Sensing, Sweep, identify
from hil.design.inverse import Way
from hil.errors import NotPossibleError
from hil.experiments.ate_checks import check_estimate, check_run
from hil.experiments.ate_motion import END_OVER_RESONANCE, Ramps, end_speed, ramps
from hil.experiments.cancellation import cancellation_on
from hil.experiments.cancellation_trial import CancellationRefusedError, judged_rows, vibration_m_s2
from hil.experiments.identify_ate import sweep_of
from hil.master.bench import TransmissionError
from hil.master.identified import Identified, IdentifiedError, update_file
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import Recording

Real = NDArray[np.float64]

ORDERS = (2, 4)
PASSES = 5
ACCELERATION_RPS_S = 4.0
SECOND_GAIN = 0.5
LEAST_SHARE = 0.5
"""Of a pass' gain by which the vibration must fall."""
LEAST_DELAY_S = 1e-4
"""A smaller one of the motor is not told from what the gear does to it: 0.03 ms on the reference robot, and 0.4° at 12 Hz."""
EDGE_S = 0.3
"""Beginning and end of a ramp that tell nothing of how the motor follows: there the motion itself is in the band."""


@dataclass(frozen=True)
class LearntPass:
    """One pass.

    Attributes:
        gain: Share of the correction that acted.
        vibration_m_s2: Of the tip, both ramps, 6 to 25 Hz, at the speeds that excite the arm.
        estimate: From all passes so far.
        set_point_delay_s: As corrected after this pass.
        following: Motor's motion over the one that was asked for, after a pass with the whole correction; 1 where all is right.
    """

    gain: float
    vibration_m_s2: float
    estimate: JointEstimate
    set_point_delay_s: float
    following: float | None


@dataclass
class Learnt:
    """What the passes of one axis gave; frozen.

    Attributes:
        axis: Which one.
        passes: In their order.
    """

    axis: int
    passes: list[LearntPass] = field(default_factory=list)

    @property
    def estimate(self) -> JointEstimate:
        """From all passes."""
        return self.passes[-1].estimate

    @property
    def fall(self) -> float:
        """By which share the last pass' vibration is below the first's."""
        return 1.0 - self.passes[-1].vibration_m_s2 / max(self.passes[0].vibration_m_s2, 1e-30)

    def part(self, note: str = "", on: datetime.date | None = None) -> IdentifiedError:
        """For the model file.

        Args:
            note: Load, temperature: what the engineer wants to remember.
            on: Date of the passes; today's unless it is given.
        """
        found, last = self.estimate, self.passes[-1]
        errors = {}
        for order in ORDERS:
            errors[f"a{order}_arcsec"] = found.amplitude_error_arcsec[order]
            errors[f"phi{order}_deg"] = found.phase_error_deg[order]
        date = (on or datetime.datetime.now(datetime.UTC).date()).isoformat()
        return IdentifiedError(
            values=TransmissionError(
                a2_arcsec=found.error.amplitude_arcsec[2],
                phi2_deg=found.error.phase_deg[2],
                a4_arcsec=found.error.amplitude_arcsec[4],
                phi4_deg=found.error.phase_deg[4],
            ),
            standard_error=errors,
            arm_hz=found.arm.resonance_hz,
            damping=found.arm.damping,
            accelerometer_delay_s=found.arm.delay_s,
            set_point_delay_s=last.set_point_delay_s,
            learnt_by="adaptive",
            note="; ".join(text for text in (date, f"{len(self.passes)} passes", note) if text),
        )

    def store(self, path: Path, robot: str, note: str = "", on: datetime.date | None = None) -> Identified:
        """Put it into the model file.

        Raises:
            FileError: It is no model file, or cannot be written.
            NotPossibleError: It is another robot's.
        """
        return update_file(path, robot, self.axis, self.part(note, on))

    def record(self, note: str = "", on: datetime.date | None = None) -> dict[str, Any]:
        """As result.json holds it."""
        passes = [
            {
                "gain": each.gain,
                "vibration_m_s2": each.vibration_m_s2,
                "set_point_delay_s": each.set_point_delay_s,
                "following": each.following,
                **{f"a{k}_arcsec": each.estimate.error.amplitude_arcsec[k] for k in ORDERS},
                **{f"phi{k}_deg": each.estimate.error.phase_deg[k] for k in ORDERS},
            }
            for each in self.passes
        ]
        return {"axis": self.axis, "fall": self.fall, "passes": passes, "ate": self.part(note, on).model_dump()}


def learn(
    session: Session,
    axis: int,
    identified: Identified | None = None,
    *,
    passes: int = PASSES,
    acceleration_rps_s: float = ACCELERATION_RPS_S,
    way: Way = "reference",
    keep: Callable[[int, RunResult, Ramps], None] = lambda number, result, motion: None,
    announce: Callable[[str], None] = lambda text: None,
) -> Learnt:
    """Learn what cancels the transmission error of one axis.

    Args:
        session: Brought up.
        axis: Which one.
        identified: The model file, for the motor's inertia; its transmission error is not used. None: the bench file's model.
        passes: To and fro; two at least.
        acceleration_rps_s: Of every ramp.
        way: How the correction is made.
        keep: Called with number, result and motion of every pass, a stopped one included, before it is judged.
        announce: Called with what comes next.

    Raises:
        NotPossibleError: Fewer than two passes, no motor inertia, or limits that keep the motor from the resonance.
        NotIdentifiedError: The runs do not tell the transmission error.
        CancellationRefusedError: A correction did not lower the vibration.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    if passes < 2:
        raise NotPossibleError(f"{passes} pass cannot learn: the first is without correction, so 2 are needed at least")
    bench, period = session.bench, session.bench.bus.sync_period_s
    if axis not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {axis}; it has {', '.join(map(str, bench.axis))}")
    table = bench.axis[axis]
    end = end_speed(bench, axis, acceleration_rps_s, None)
    learnt, sweeps, start, delay_s = Learnt(axis), list[Sweep](), None, 0.0
    for number in range(1, passes + 1):
        gain = (0.0, SECOND_GAIN)[number - 1] if number <= 2 else 1.0
        announce(f"pass {number} of {passes}: axis {axis} to {end:.2f} rps and back, {100.0 * gain:g} % of the correction")
        session.check_interrupt()
        here_rev = session.axes[axis].position_rad() / (2.0 * math.pi)
        motion = ramps(bench, axis, here_rev, acceleration_rps_s, end, period)
        cancellation = None
        if learnt.passes:
            so_far = _with_estimate(session, identified, learnt, delay_s)
            cancellation = cancellation_on(session, so_far, motion.motion, way=way)
        result = session.run(motion.motion, "none", "drive", None if cancellation is None else cancellation.corrector(gain))
        keep(number, result, motion)
        if result.stopped is not None:
            raise result.stopped
        check_run(result, sensorless=False)
        recording, following = result.recording, None
        if cancellation is not None and gain == 1.0:
            following, late_s = motor_following(recording, motion, axis, table.reduction_ratio, learnt.estimate)
            delay_s += late_s if abs(late_s) > LEAST_DELAY_S else 0.0
        sweeps.append(sweep_of(motion, recording, axis, sensorless=False))
        try:
            estimate = identify(sweeps, table.reduction_ratio, Sensing(table.tip_lever_m), start, ORDERS)
        except ValueError as error:
            raise NotPossibleError(f"not learnt: {error}") from error
        check_estimate(estimate, sensorless=False)
        vibration = vibration_m_s2(recording, judged_rows(session.bench, recording) & (motion.direction() != 0))
        learnt.passes.append(LearntPass(gain, vibration, estimate, delay_s, following))
        if learnt.fall < LEAST_SHARE * gain:
            raise CancellationRefusedError(f"what pass {number - 1} has learnt of axis {axis}", learnt.fall, LEAST_SHARE * gain)
        start = estimate.arm
        end = min(end, max(END_OVER_RESONANCE * start.resonance_hz / 2.0, 1.0))
    return learnt


def _with_estimate(session: Session, identified: Identified | None, learnt: Learnt, delay_s: float) -> Identified:
    """The model file with what has been learnt so far."""
    known = Identified(robot=session.bench.name) if identified is None else identified
    part_of = learnt.part().model_copy(update={"set_point_delay_s": delay_s})
    return known.with_part(learnt.axis, part_of)


def motor_following(
    recording: Recording, motion: Ramps, axis: int, reduction_ratio: float, estimate: JointEstimate
) -> tuple[float, float]:
    """By which factor, and how late, a motor made the motion Δθ_m = −N θ_sync(θ_m) that was asked of it.

    Least squares of the measured angle, band-passed from 6 to 25 Hz, on the wanted motion and its derivative: g Δθ_m − g δ Δθ̇_m.

    Args:
        recording: A pass with the whole correction.
        motion: What was asked for.
        axis: Whose.
        reduction_ratio: N.
        estimate: The correction.

    Returns:
        g and δ in s.
    """
    period, angle = recording.period_s, recording.axis(axis, "position_rad")
    asked = -reduction_ratio * estimate.error.angle_rad(angle)
    band = signal.butter(2, TIP_BAND_HZ, "bandpass", fs=1.0 / period, output="sos")
    measured, wanted, rate = signal.sosfiltfilt(band, np.stack([angle, asked, np.gradient(asked, period)]))
    rows = motion.direction(EDGE_S / motion.trajectory.ramp_s) != 0
    rows &= np.roll(rows, -round(EDGE_S / period))  # nor does the end of a ramp tell anything
    rows &= np.abs(motor_speed_rps(recording, axis)) > TIP_BAND_HZ[0] / min(ORDERS)
    columns = np.stack([wanted[rows], rate[rows]], axis=1)
    solution = np.linalg.lstsq(columns, measured[rows], rcond=None)[0]
    gain = float(solution[0])
    return gain, -float(solution[1]) / gain if gain > 0.1 else 0.0
