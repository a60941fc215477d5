"""Identification of the transmission error of one axis.

Passes with ramps in both directions go on until the error is known as well as requested.

For the accuracy on the reference robot see docs/theory-transmission-error.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.bench.bench import Bench
from hil.bench.model import Correlation, IdentifiedError
from hil.control.angles import ARCSEC
from hil.control.order_keys import order_keys
from hil.design.ate.gear import GearLaw
from hil.design.ate.gear_fit import on_its_gear
from hil.design.ate.gravity import weight_of
from hil.design.ate.identification import ARM_KEYS, DELAY_KEY, SPRING_MISS, JointEstimate, with_arm
from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.ate.reaction import Reaction, Turning, gear_reaction
from hil.design.estimation import SURE_SIGMAS, EstimatedParameter
from hil.design.ringing import BEYOND_RESONANCE
from hil.design.transmission_error import TransmissionError
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import AteNotIdentifiedError, factor_remark, reached_rps
from hil.experiments.ate.motion import PassKeeper, Ramps, ramps
from hil.experiments.ate.order_scan import OrderScan, OrderWatch, checked, identify_orders
from hil.experiments.ate.ramp import ACCELERATION_AT_HZ, Ramp, plan_ramp, resonance_ramp
from hil.experiments.ate.request import AteRequest, AxisKnowledge, Miss, first_ramp, is_seen, sensing_of
from hil.experiments.ate.sweeps import late_words, run_pass
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.robot_tables import TransmissionErrorTable

LEAST_ACCELERATION_RPS_S = 1.0
"""No pass is slower on an arm of 12 Hz: there the arm is in its steady state all the way, and another pass buys as much."""
SEARCHED_PASSES = 2
"""Accuracy: passes after which the arm is searched for; later ones start from what is known: to search again changes nothing in
three fits."""
WORTH_A_PASS = 0.75
"""A usable standard error that a pass has not brought below this fraction of itself is as good as passes make it."""
SENSORLESS_BIAS = (
    "bias on the reference robot with the true J_l: A_k up to 1.2 %, φ_k up to 0.7°; a gear torque that reacts on the "
    "motor (τ_g dθ_sync/dθ_m, not in the model) adds 1.5 % to A_2 and 4 % to A_4"
)
"""Measured at SYNC 1 and 2 ms on axes 2 and 3; the reaction with the emulator's `gear_reaction`."""
UNIFORM = 1.0 / math.sqrt(12.0)
"""Standard deviation of a number that is anywhere in a range, over the range."""
NOTHING_KNOWN = AxisKnowledge()
SATURATED_TORQUE_FRACTION = 0.99
"""Bound: fraction of the torque limit from which a run counts as held back by it: rounding of the torque, 0.1 %, lies within."""


@dataclass(frozen=True)
class Pass:
    """One completed pass.

    Attributes:
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
        misses: Numbers that are known less well than requested.
        scan: Orders of the vibration; None without an accelerometer.
        reaction: Reaction of the gear on its motor; None if no plant is known, or the ramps do not show it.
    """

    passes: list[Pass] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    misses: list[Miss] = field(default_factory=list)
    scan: OrderScan | None = None
    reaction: Reaction | None = None

    @property
    def estimate(self) -> JointEstimate:
        """Estimate from all passes."""
        return self.passes[-1].estimate

    @property
    def missed(self) -> list[str]:
        """Sentences on the numbers that are known less well than requested."""
        return [miss.sentence for miss in self.misses]

    def is_reached(self, order: float) -> bool:
        """True if the ramps went through the resonance with an order."""
        reached = max(each.ramps.trajectory.end_rps for each in self.passes)
        return reached >= BEYOND_RESONANCE * self.estimate.arm.resonance_hz / order

    @property
    def is_good(self) -> bool:
        """True if what was requested, and is in reach, is known or usable (`Miss`)."""
        return all(miss.is_usable or not self.is_reached(miss.order) for miss in self.misses)


def identify_on(
    session: Session, request: AteRequest, knowledge: AxisKnowledge, keep: PassKeeper | None = None, reporter: Reporter = SILENT
) -> Identification:
    """Run passes until the goal is met or none is left.

    Raises:
        AteNotIdentifiedError: The runs do not identify it; with the number that is wrong and the number needed.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench, axis = session.bench, request.axis
    reduction_ratio = bench.axis[axis].reduction_ratio
    has_gear = not (request.sensorless or bench.accelerometer.from_load_encoders)
    ramp, identification = first_ramp(bench, request, knowledge), Identification()
    for number in range(1, request.passes + 1):
        session.check_interrupt()
        motion = ramps(bench, session.axes[axis].position_rad() / math.tau, ramp)
        words = f"axis {axis} to {ramp.end_rps:.2f} rev/s at {ramp.acceleration_rps_s:.2f} rev/s² and back{ramp.bound}"
        reporter.step(f"pass {number} of at most {request.passes}: {words}")
        recording, sweep = run_pass(session, motion, number, keep, sensorless=request.sensorless)
        sensing = sensing_of(bench, axis, knowledge, sensorless=request.sensorless)
        watch = OrderWatch(reduction_ratio, sensing, ramp, [*(each.sweep for each in identification.passes), sweep])
        start, left = identification.estimate.arm if identification.passes else None, request.passes - number
        try:
            estimate = estimate_of(watch.sweeps, reduction_ratio, sensing, knowledge, start, request.orders)
        except ValueError as error:
            raise NotPossibleError(f"not identified: {error}{ramp.bound}", ("limits",)) from error
        if has_gear:
            estimate = checked_on_gear(watch, estimate, knowledge, passes_left=left)
        else:
            checked(watch, estimate, sensorless=request.sensorless, passes_left=left)
        made = Pass(motion, recording, sweep, estimate)
        identification.passes.append(made)
        is_through = _is_through(axis, made, passes_left=left)
        before, identification.misses = identification.misses, request.goal.missed(made.estimate)
        if is_through and not _curable(identification, before):
            break
        ramp = _next_ramp(identification)
    linear = identification.estimate
    last = identification.passes[-1]
    if has_gear and last.estimate.gear is None:
        reporter.step("fit of all passes, with the arm simulated on its gear")
        estimate = simulated(last.estimate, watch.sweeps, reduction_ratio, watch.sensing, knowledge)
        identification.passes[-1] = replace(last, estimate=estimate)
        identification.misses = request.goal.missed(estimate)
    _remark(identification, bench, request, knowledge)
    if not request.sensorless:
        identification.scan = watch.scan(linear)
        identification.notes += watch.notes(linear, identification.scan)
        identification.reaction = _reaction(identification, axis, knowledge)
    return identification


def _reaction(identification: Identification, axis: int, knowledge: AxisKnowledge) -> Reaction | None:
    """Estimate the gear's reaction on its motor."""
    if knowledge.side is None:
        return None
    made = [each.recording for each in identification.passes]
    turned = [Turning(each.axis(axis, "position_rad"), each.axis(axis, "torque_nm"), each.period_s) for each in made]
    error = identification.estimate.error
    seen = {k: size for k, size in error.amplitude_arcsec.items() if is_seen(identification.estimate, k)}
    return gear_reaction(turned, knowledge.side, TransmissionError(seen, {k: error.phase_deg[k] for k in seen}))


def estimate_of(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    knowledge: AxisKnowledge,
    before: Arm | None,
    orders: Sequence[float],
) -> JointEstimate:
    """Estimate the transmission error from all passes so far.

    `before` is the arm of the estimate from all passes but the last; None for the first pass.

    Raises:
        ValueError: The passes do not carry a fit.
    """
    start = knowledge.start if before is None else before
    estimate = identify_orders(sweeps, reduction_ratio, sensing, start, orders, is_near=len(sweeps) > SEARCHED_PASSES)
    return _with_inertia_error(estimate, knowledge.arm_inertia_fraction)


def checked_on_gear(watch: OrderWatch, estimate: JointEstimate, knowledge: AxisKnowledge, *, passes_left: int) -> JointEstimate:
    """Check an estimate from all passes, on its gear if its linear arm does not explain them.

    Raises:
        AteNotIdentifiedError: Neither explains the passes.
    """
    try:
        checked(watch, estimate, sensorless=False, passes_left=passes_left)
    except AteNotIdentifiedError as refusal:
        if refusal.causes != ("noise",):
            raise
        on_gear = simulated(estimate, watch.sweeps, watch.reduction_ratio, watch.sensing, knowledge)
        if on_gear.gear is None:
            raise
        try:
            # no allowance for more passes: with it, a second fit of noise would often pass
            checked(watch, on_gear, sensorless=False)
        except AteNotIdentifiedError:
            raise refusal from None  # the first names an order that is not in the set and leads both fits astray
        return on_gear
    return estimate


def simulated(
    estimate: JointEstimate, sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, knowledge: AxisKnowledge
) -> JointEstimate:
    """Estimate from all passes with the arm simulated on its gear.

    The fit starts from the linear arm; if no gear near it explains the vibration well, it starts from the identified plant, and
    the gear that misses less is taken. The motor tells a soft gear's f_a and ζ where the vibration is so far from a linear arm's
    that its fit takes another arm for true.
    """
    weight = weight_of(sweeps, reduction_ratio, knowledge.arm_inertia)
    found = on_its_gear(estimate, sweeps, reduction_ratio, sensing, weight)
    is_good = found.gear is not None and found.miss <= SPRING_MISS
    if is_good or weight is None or knowledge.start is None or knowledge.resonance_error_hz is None:
        return found
    known = with_arm(estimate, sweeps, reduction_ratio, sensing, knowledge.start)
    error = Arm(knowledge.resonance_error_hz, knowledge.damping_error or 0.0, estimate.arm_error.delay_s)
    other = on_its_gear(replace(known, arm_error=error), sweeps, reduction_ratio, sensing, weight)
    return min((each for each in (found, other) if each.gear is not None), key=lambda each: each.miss, default=found)


def _is_through(axis: int, made: Pass, passes_left: int) -> bool:
    """True if the ramps passed f_m2; False if the next ones can."""
    arm_hz, direction = made.estimate.arm.resonance_hz, made.ramps.direction()
    needed = BEYOND_RESONANCE * arm_hz / 2.0
    ends = [int(np.flatnonzero(direction == sign)[-1]) for sign in (1, -1)]
    angle, period = made.recording.axis(axis, "position_rad"), made.recording.period_s
    reached = min(reached_rps(angle, period, end) for end in ends)
    if reached >= needed:
        return True
    last, further = made.ramps.ramp, resonance_ramp(made.ramps.ramp.limits, arm_hz, _slower(made), is_raised=True)
    if further.end_rps >= needed and further.end_rps > last.end_rps and passes_left:
        return False
    short = (further if further.end_rps < needed else last).short_of(needed)
    if last.end_rps >= needed:
        short = f"the ramps went to {last.end_rps:.2f} rev/s, so the motor did not follow its set-points"
    what, why = f"the speed that the ramps reached, to pass f_a/2 = {arm_hz / 2.0:.2f} rev/s", short or "allow another pass"
    raise AteNotIdentifiedError(what, reached, needed, "rev/s", why, causes=("limits",))


def _curable(identification: Identification, before: list[Miss]) -> list[Miss]:
    """Select the misses that another pass may cure.

    These are orders that can yet pass the resonance, and misses by noise, not by the gear. A usable number that the last pass
    hardly improved is not among them.
    """
    made, misses = identification.passes[-1], identification.misses
    unseen_yet = [m for m in misses if not identification.is_reached(m.order) and _low_order_end(made, m.order)]
    if not identification.estimate.is_spring:
        return unseen_yet
    last = {miss.name: miss.over for miss in before}
    return unseen_yet + [
        miss
        for miss in misses
        if identification.is_reached(miss.order)
        and not (miss.is_usable and miss.over > WORTH_A_PASS * last.get(miss.name, math.inf))
    ]


def _next_ramp(identification: Identification) -> Ramp:
    """Plan the ramp of the next pass.

    It has half the acceleration of the last, and goes through f_m2, or through f_a if order 1 needs it.
    """
    made = identification.passes[-1]
    limits, arm_hz, slower = made.ramps.ramp.limits, made.estimate.arm.resonance_hz, _slower(made)
    end = max((_low_order_end(made, miss.order) for miss in identification.misses if miss.order < 2.0), default=0.0)
    if end:
        return plan_ramp(limits, slower, end, end)
    return resonance_ramp(limits, arm_hz, slower, is_raised=True).beyond(arm_hz)


def _low_order_end(made: Pass, order: float) -> float:
    """End speed of a next ramp through a low order's resonance, or 0."""
    return made.ramps.ramp.limits.low_order_end(made.estimate.arm.resonance_hz, order, _slower(made))


def _slower(made: Pass) -> float:
    """Acceleration of the pass after another, where travel suffices."""
    last = made.ramps.ramp.acceleration_rps_s
    least = LEAST_ACCELERATION_RPS_S * (made.estimate.arm.resonance_hz / ACCELERATION_AT_HZ) ** 2
    return min(last, max(0.5 * last, least))


def _with_inertia_error(estimate: JointEstimate, fraction: float) -> JointEstimate:
    """Widen the errors of A_k by that of J_l, on which it depends."""
    by_inertia = fraction * estimate.values.mean
    by_inertia[1::2] = 0.0
    covariance = estimate.values.covariance + np.outer(by_inertia, by_inertia)
    return replace(estimate, values=replace(estimate.values, covariance=covariance))


def _remark(identification: Identification, bench: Bench, request: AteRequest, knowledge: AxisKnowledge) -> None:
    """Add notes for the engineer to a result that passed."""
    estimate, table = identification.estimate, bench.axis[request.axis]
    apart = [each for each in estimate.agreement if each.sigma > SURE_SIGMAS and estimate.gear is None]
    identification.notes += [
        f"{each.words}, {each.sigma:.1f} times what noise explains; the model misses {100.0 * estimate.miss:.2g} % of the "
        "vibration, which the standard errors contain"
        for each in apart
    ]
    identification.notes += [note for note in (None if request.sensorless else factor_remark(estimate),) if note is not None]
    for order, amplitude in estimate.error.amplitude_arcsec.items():
        if not is_seen(estimate, order):
            sigma = estimate.amplitude_error_arcsec[order]
            identification.notes.append(f"A_{order:g} is not significant ({amplitude:.2g} ± {sigma:.2g}″): not in the model file")
    peak = max(float(np.max(np.abs(each.recording.axis(request.axis, "torque_nm")))) for each in identification.passes)
    identification.notes += late_words([each.sweep for each in identification.passes])
    if peak >= SATURATED_TORQUE_FRACTION * table.limits.torque_nm:
        identification.notes.append(
            f"the motor torque reached {peak:.3g} N·m of at most {table.limits.torque_nm:g} N·m: a slower ramp is better"
        )
    if request.sensorless:
        fraction = knowledge.arm_inertia_fraction
        error = f"±{100.0 * fraction:.2g} %, contained in the standard error of A_k" if fraction else "whose error is not stated"
        identification.notes.append(
            f"sensorless: A_k has the relative error of J_l, which comes from {knowledge.source}, {error}; {SENSORLESS_BIAS}"
        )
    shown = [miss for miss in identification.misses if identification.is_reached(miss.order)]
    identification.notes += [miss.sentence for miss in shown]
    if estimate.is_spring:
        return
    if estimate.gear is not None:
        identification.notes.append(_gear_words(estimate.gear))
    else:
        identification.notes.append(
            f"the arm is not one on a linear spring: a model of that misses {100.0 * estimate.miss:.2g} % of the vibration "
            "(hysteresis or a soft wind-up of the gear, gravity that gives another resonance in each posture, friction or "
            "backlash of the arm); the standard errors contain it, and more passes do not change it"
        )


def _gear_words(gear: GearLaw) -> str:
    """Describe the gear on which the arm was simulated."""
    return (
        f"the gear is nonlinear: {100.0 * gear.softness:.2g} % softer at torsions below {gear.wind_up_rad / ARCSEC:.0f}″, and "
        f"its friction holds a torsion of {gear.hysteresis_rad / ARCSEC:.2g}″; the fit simulates this gear, "
        "so A_k and φ_k hold for any amplitude"
    )


def standard_errors(estimate: JointEstimate) -> dict[str, float]:
    """Standard errors of A_k and φ_k, by the model file's names."""
    return {key: estimate.values.standard_error(key) for key in order_keys(estimate.orders)}


def delay_of(estimate: JointEstimate, gear_fraction_error: float, plant_damping: float | None = None) -> EstimatedParameter:
    """Estimate the sensor's delay with its standard error.

    The error contains noise, the uncertainty of the gear's part of the damping, and the blur of a gear that is not a spring.

    The gear's part of the damping leads by 2 ζ_g/ω, which no ramp tells from a sensor that is quicker by as much. A gear that is
    no spring rings at another frequency at each instant of a ramp, which looks like damping and leads by nothing: what the fit
    has of ζ beyond the plant's is loss in part and blur in part, and any part is as likely as any other.

    `gear_fraction_error` is the standard error of ζ_g/ζ, `plant_damping` the ζ of the identified plant; None if it is not known.
    """
    if DELAY_KEY in estimate.of_gear:
        return estimate.of_gear[DELAY_KEY]
    lead_s = 2.0 * estimate.arm.damping / (2.0 * math.pi * estimate.arm.resonance_hz)
    blur_s = 0.0
    if plant_damping is not None:
        blur_s = estimate.arm.gear_fraction * lead_s * (1.0 - plant_damping / estimate.arm.damping)
    error_s = math.hypot(estimate.arm_error.delay_s, gear_fraction_error * lead_s, UNIFORM * blur_s)
    return EstimatedParameter(estimate.arm.delay_s - 0.5 * blur_s, error_s)


def arm_of(estimate: JointEstimate, plant: Arm) -> tuple[EstimatedParameter, EstimatedParameter]:
    """Estimate f_a and ζ of the ramps' largest vibration.

    They follow from the simulated gear. A linear arm blurs as the resonance moves (`delay_of`): its f_a and ζ may be anywhere
    between those of the ramps and of the plant's excitation.
    """
    if estimate.of_gear:
        hz, damping = (estimate.of_gear[name] for name in ARM_KEYS)
        return hz, damping
    arm, error = estimate.arm, estimate.arm_error
    return (
        EstimatedParameter(arm.resonance_hz, math.hypot(error.resonance_hz, UNIFORM * (arm.resonance_hz - plant.resonance_hz))),
        EstimatedParameter(arm.damping, math.hypot(error.damping, UNIFORM * (arm.damping - plant.damping))),
    )


def as_part(
    estimate: JointEstimate,
    request: AteRequest,
    note: str = "",
    knowledge: AxisKnowledge = NOTHING_KNOWN,
    reaction: Reaction | None = None,
) -> IdentifiedError:
    """Convert an estimate to an entry of the model file.

    An order that is not seen has the amplitude 0 in it.
    """
    plant = knowledge.start or estimate.arm
    delay = delay_of(estimate, knowledge.gear_fraction_error, plant.damping)
    seen = {order: size for order, size in estimate.error.amplitude_arcsec.items() if is_seen(estimate, order)}
    errors = standard_errors(estimate)
    arm_hz, damping = arm_of(estimate, plant)
    errors |= {"arm_hz": arm_hz.standard_error, "damping": damping.standard_error}
    if not request.sensorless:
        errors["accelerometer_delay_s"] = delay.standard_error
    reacts = None if reaction is None else reaction.posterior()
    if reacts is not None:
        errors["gear_reaction"] = reacts.standard_error
    return IdentifiedError(
        values=TransmissionErrorTable.of(seen, {order: estimate.error.phase_deg[order] for order in seen}),
        standard_error=errors,
        correlation=Correlation.of(estimate.values),
        arm_hz=arm_hz.value,
        damping=damping.value,
        torsion_arcsec=None if estimate.torsion_rad is None else estimate.torsion_rad / ARCSEC,
        accelerometer_delay_s=0.0 if request.sensorless else delay.value,
        gear_reaction=0.0 if reacts is None else reacts.value,
        learnt_by="sensorless" if request.sensorless else "identify",
        note=note,
    )
