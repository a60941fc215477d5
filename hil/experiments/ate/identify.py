"""Identification of the transmission error of one axis: ramps in both directions until it is known as well as requested.

For the accuracy on the reference robot see docs/theory.md.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import Bench
from hil.bench.model import IdentifiedError
from hil.design.ate_identification import JointEstimate, identify
from hil.design.ate_model import Sweep
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import AteNotIdentifiedError, check_accelerometer, check_estimate, check_run, reached_rps
from hil.experiments.ate.motion import (
    BEYOND_RESONANCE,
    END_OVER_RESONANCE,
    Ramps,
    deceleration,
    end_speed,
    ramps,
    slowest,
    too_short,
)
from hil.experiments.ate.passes import PassKeeper, keep_nothing
from hil.experiments.ate.request import FITTED_ORDERS, AteRequest, AxisKnowledge, first_end_speed, sensing_of
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.robot_tables import TransmissionErrorTable, amplitude_key, phase_key

Real = NDArray[np.float64]

LEAST_ACCELERATION_RPS_S = 1.0
"""No pass is slower: below it the arm is in its steady state all the way, and time buys no more than another pass would."""
SKIP_TORQUE = 0.12
"""Fraction of a ramp, from its beginning, that does not count without an accelerometer: there the torque is friction's."""
SENSORLESS_BIAS = (
    "its bias on the reference robot with J_l right: A_k up to 1.2 %, φ_k up to 0.7°, and where the gear's torque reacts on the "
    "motor (τ_g dθ_sync/dθ_m, which the model leaves out) another 1.5 % of A_2 and 4 % of A_4"
)
"""Measured at SYNC 1 and 2 ms on axes 2 and 3; the reaction with the emulator's `gear_reaction`."""
AGREEMENT_SIGMAS = 4.0
SATURATED_TORQUE_FRACTION = 0.99
"""Fraction of the torque limit from which a run counts as held back by it."""


@dataclass(frozen=True)
class Pass:
    """One pass that was made.

    Attributes:
        ramps: Motion that was requested.
        recording: Recording of the run.
        sweep: The recording as input of the fit.
        estimate: Estimate from all passes so far.
    """

    ramps: Ramps
    recording: Recording
    sweep: Sweep
    estimate: JointEstimate


@dataclass
class Identification:
    """Passes of an identification, and the notes on its estimate.

    Attributes:
        passes: Passes in their order.
        notes: Sentences for the engineer.
        missed: Sentences on each number that is known less well than requested.
    """

    passes: list[Pass] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)

    @property
    def estimate(self) -> JointEstimate:
        """Estimate from all passes."""
        return self.passes[-1].estimate


def identify_on(
    session: Session,
    request: AteRequest,
    knowledge: AxisKnowledge,
    keep: PassKeeper = keep_nothing,
    reporter: Reporter = SILENT,
) -> Identification:
    """Run passes on a session that has been brought up, until the goal is met or no pass is left.

    Args:
        session: Session that has been brought up.
        request: Axis, passes and goal.
        knowledge: Knowledge of the axis.
        keep: Keeper of every pass, the stopped one included, before it is checked.
        reporter: Listener of each pass.

    Raises:
        AteNotIdentifiedError: The runs do not identify it; with the number that is wrong and the number needed.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench, axis, period = session.bench, request.axis, session.bench.bus.sync_period_s
    sensing = sensing_of(bench, axis, knowledge, sensorless=request.sensorless)
    acceleration, end = request.acceleration_rps_s, first_end_speed(bench, request, knowledge)
    identification, start = Identification(), knowledge.start
    for number in range(1, request.passes + 1):
        reporter.step(
            f"pass {number} of at most {request.passes}: axis {axis} to {end:.2f} rev/s at {acceleration:.2f} rev/s² and back"
        )
        session.check_interrupt()
        here_rev = session.axes[axis].position_rad() / (2.0 * math.pi)
        motion = ramps(bench, axis, here_rev, acceleration, end, period)
        result = session.run(motion.motion, "none", "drive")
        keep(number, result, motion)
        if result.stopped is not None:
            raise result.stopped
        check_run(result, sensorless=request.sensorless)
        sweep = sweep_of(motion, result.recording, axis, sensorless=request.sensorless)
        try:
            estimate = identify(
                [*(each.sweep for each in identification.passes), sweep],
                bench.axis[axis].reduction_ratio,
                sensing,
                start,
                FITTED_ORDERS,
            )
        except ValueError as error:
            raise NotPossibleError(f"not identified: {error}") from error
        estimate = _with_inertia_error(estimate, knowledge.arm_inertia_fraction)
        identification.passes.append(Pass(motion, result.recording, sweep, estimate))
        check_estimate(estimate, sensorless=request.sensorless)
        _check_speed(bench, axis, motion, result.recording, estimate.arm.resonance_hz)
        identification.missed = request.goal.missed(estimate)
        if not identification.missed:
            break
        start = estimate.arm
        acceleration, end = _slower(bench, axis, acceleration, start.resonance_hz)
    _remark(identification, bench, request, knowledge)
    return identification


def sweep_of(motion: Ramps, recording: Recording, axis: int, *, sensorless: bool) -> Sweep:
    """Recording of a pass as input of the fit.

    Args:
        motion: Ramps of the pass.
        recording: Recording of the pass.
        axis: Axis number.
        sensorless: True to fit the motor torque instead of the tip acceleration.

    Raises:
        AteNotIdentifiedError: The accelerometer is dead or saturated.
    """
    angle = recording.axis(axis, "position_rad")
    if sensorless:
        return Sweep(angle, recording.axis(axis, "torque_nm"), recording.period_s, motion.direction(SKIP_TORQUE))
    tip = recording.columns["tip_z_m_s2"]
    check_accelerometer(tip)
    return Sweep(angle, tip, recording.period_s, motion.direction())


def _slower(bench: Bench, axis: int, acceleration_rps_s: float, arm_hz: float) -> tuple[float, float]:
    """Acceleration and end of the next pass: half of the last, as far as there is room."""
    end = min(END_OVER_RESONANCE * arm_hz / 2.0, end_speed(bench, axis, acceleration_rps_s, arm_hz))
    least = max(LEAST_ACCELERATION_RPS_S, 1.001 * slowest(bench.axis[axis], deceleration(bench), end))
    return min(acceleration_rps_s, max(0.5 * acceleration_rps_s, least)), end


def _check_speed(bench: Bench, axis: int, motion: Ramps, recording: Recording, arm_hz: float) -> None:
    needed, direction = BEYOND_RESONANCE * arm_hz / 2.0, motion.direction()
    for sign, name in ((1, "forwards"), (-1, "backwards")):
        last = int(np.flatnonzero(direction == sign)[-1])
        reached = reached_rps(recording.axis(axis, "position_rad"), recording.period_s, last)
        if reached < needed:
            why = too_short(bench, axis, motion.trajectory.acceleration_rps_s, arm_hz, reached)
            raise AteNotIdentifiedError(f"the speed that the ramp {name} reached", reached, needed, "rev/s", why)


def _with_inertia_error(estimate: JointEstimate, fraction: float) -> JointEstimate:
    """Widen the standard errors of A_k by that of J_l, on which they depend without an accelerometer."""
    if fraction <= 0.0:
        return estimate
    wider = {k: math.hypot(estimate.amplitude_error_arcsec[k], fraction * a) for k, a in estimate.error.amplitude_arcsec.items()}
    return replace(estimate, amplitude_error_arcsec=wider)


def _remark(identification: Identification, bench: Bench, request: AteRequest, knowledge: AxisKnowledge) -> None:
    """Note what the engineer should know of a result that passed its checks."""
    estimate, table = identification.estimate, bench.axis[request.axis]
    apart = [each for each in estimate.agreement if each.sigma > AGREEMENT_SIGMAS]
    identification.notes += [
        f"{each.name} is {each.forward:.2f} forwards and {each.backward:.2f} backwards, {each.sigma:.1f} standard errors apart; "
        f"the standard errors have been widened {estimate.widened:.1f} times"
        for each in apart
    ]
    for order, amplitude in estimate.error.amplitude_arcsec.items():
        sigmas = amplitude / max(estimate.amplitude_error_arcsec[order], 1e-30)
        if sigmas < 3.0:
            identification.notes.append(f"A_{order:g} is {sigmas:.1f} standard errors: φ_{order:g} means nothing")
    peak = max(float(np.max(np.abs(each.recording.axis(request.axis, "torque_nm")))) for each in identification.passes)
    if peak >= SATURATED_TORQUE_FRACTION * table.limits.torque_nm:
        identification.notes.append(
            f"the motor torque reached {peak:.3g} N·m, its limit is {table.limits.torque_nm:g} N·m: a slower ramp is better"
        )
    if request.sensorless:
        fraction = knowledge.arm_inertia_fraction
        error = f"whose standard error of {100.0 * fraction:.2g} % is in A_k's" if fraction else "whose error nobody has stated"
        identification.notes.append(f"sensorless: A_k is as wrong as J_l from {knowledge.source}, {error}; {SENSORLESS_BIAS}")
    identification.notes += identification.missed


def standard_errors(estimate: JointEstimate) -> dict[str, float]:
    """Standard errors of A_k and φ_k, by the names that the model file has for them."""
    errors = {}
    for order in estimate.error.amplitude_arcsec:
        errors[amplitude_key(order)] = estimate.amplitude_error_arcsec[order]
        errors[phase_key(order)] = estimate.phase_error_deg[order]
    return errors


def as_part(estimate: JointEstimate, request: AteRequest, note: str = "") -> IdentifiedError:
    """Transmission error as an entry of the model file."""
    errors = standard_errors(estimate) | {"arm_hz": estimate.arm_error.resonance_hz, "damping": estimate.arm_error.damping}
    if not request.sensorless:
        errors["accelerometer_delay_s"] = estimate.arm_error.delay_s
    return IdentifiedError(
        values=TransmissionErrorTable.of(estimate.error.amplitude_arcsec, estimate.error.phase_deg),
        standard_error=errors,
        arm_hz=estimate.arm.resonance_hz,
        damping=estimate.arm.damping,
        accelerometer_delay_s=0.0 if request.sensorless else estimate.arm.delay_s,
        learnt_by="sensorless" if request.sensorless else "identify",
        note=note,
    )
