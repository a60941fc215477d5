"""`hil identify ate`: ramps in both directions until the transmission error is known as well as it is asked for.

Reached on the reference robot over CAN with nothing known (friction, gravity, 17-bit encoder, accelerometer noise 0.05 m/s²,
resolution 0.01 m/s²; axes 2 and 3, SYNC 1 and 2 ms, 20 seeds each, one to three passes at standard errors of a third of what is
asked; the passes go on to a quarter of it): A_2 within 1.9 %, φ_2 0.5°, A_4 2.4 %, φ_4 1.0°, delay 0.21 ms; the standard errors
say as much.

What the linear arm does not know, on the same robot: the gear's reaction on the motor and a current loop of 0.5 ms change
nothing (0.3 %). A wind-up 30 % softer around zero torque puts A_2 of axis 2, whose gear is unloaded on the way, off by 20 % and
φ_2 by 12°; it is refused, since the motor's own motion then does not fit; axis 3, always loaded, is not touched (0.4 %).
Hysteresis makes the gear stiffer for small vibrations: 5 N·m over 20 arcsec raise f_a from 12 to 17 Hz (axis 2), which is then
found, or said to be out of the ramp's reach.
"""

import datetime
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_profiles.address import parse_address
from hil.can.channel import Channel, open_channel
from hil.design.ate_identification import Arm, JointEstimate, Sensing, Sweep, identify
from hil.errors import NotPossibleError, SafetyStopError
from hil.experiments.ate_checks import NotIdentifiedError, check_accelerometer, check_estimate, check_run, reached_rps
from hil.experiments.ate_motion import (
    BEYOND_RESONANCE,
    END_OVER_RESONANCE,
    Ramps,
    deceleration,
    end_speed,
    ramps,
    slowest,
    too_short,
)
from hil.experiments.plan import Experiment
from hil.experiments.runner import bench_record, check_load, log_channel, write_json
from hil.master.bench import Bench, TransmissionError
from hil.master.identified import Identified, IdentifiedError, PlantTable
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog, Recording

Real = NDArray[np.float64]

KIND = "identify-ate"
ORDERS = (2, 4)
LEAST_ACCELERATION_RPS_S = 1.0
"""No pass is slower: below it the arm is in its steady state all the way, and time buys no more than another pass would."""
SKIP_TORQUE = 0.12
"""Share of a ramp's beginning that does not count without an accelerometer: there the torque is friction's."""
SENSORLESS_BIAS = (
    "its bias on the reference robot with J_l right: A_k up to 1.2 %, φ_k up to 0.7°, and where the gear's torque reacts on the "
    "motor (τ_g dθ_sync/dθ_m, which the model leaves out) another 1.5 % of A_2 and 4 % of A_4"
)
"""Measured at SYNC 1 and 2 ms on axes 2 and 3; the reaction with the emulator's `gear_reaction`."""
AGREEMENT_SIGMAS = 4.0
TORQUE_SHARE = 0.99


@dataclass(frozen=True)
class Goal:
    """Standard errors at which the passes end: a quarter of what is asked of A_2 (2 %), φ_2 (2°), A_4 (3 %), φ_4 (3°).

    Attributes:
        amplitude_share: Of A_k itself, by order.
        phase_deg: Of φ_k, by order.
    """

    amplitude_share: dict[int, float] = field(default_factory=lambda: {2: 0.02 / 4.0, 4: 0.03 / 4.0})
    phase_deg: dict[int, float] = field(default_factory=lambda: {2: 0.5, 4: 0.75})

    def missed(self, found: JointEstimate) -> list[str]:
        """What is not known well enough, in words; empty when everything is."""
        missed = []
        for order in ORDERS:
            share = 100.0 * found.amplitude_error_arcsec[order] / max(found.error.amplitude_arcsec[order], 1e-30)
            asked = 100.0 * self.amplitude_share[order]
            if share > asked:
                missed.append(f"A_{order} has a standard error of {share:.2g} %, {asked:.2g} % is asked")
            turn = found.phase_error_deg[order]
            if turn > self.phase_deg[order]:
                missed.append(f"φ_{order} has a standard error of {turn:.2g}°, {self.phase_deg[order]:.2g}° is asked")
        return missed


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        axis: Which one.
        acceleration_rps_s: Of the first pass; later ones are slower.
        passes: How many there may be.
        sensorless: Use motor torque and encoder only.
        goal: When to end.
    """

    axis: int
    acceleration_rps_s: float = 4.0
    passes: int = 6
    sensorless: bool = False
    goal: Goal = field(default_factory=Goal)


@dataclass(frozen=True)
class Pass:
    """One pass that was made.

    Attributes:
        ramps: What was asked.
        recording: What came.
        sweep: As the fit takes it.
        estimate: From all passes so far.
    """

    ramps: Ramps
    recording: Recording
    sweep: Sweep
    estimate: JointEstimate


@dataclass
class Identification:
    """What the passes gave.

    Attributes:
        passes: In their order.
        notes: What the engineer should know, in words.
        missed: What is not known as well as it was asked for.
    """

    passes: list[Pass] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)

    @property
    def estimate(self) -> JointEstimate:
        """From all passes."""
        return self.passes[-1].estimate


@dataclass(frozen=True)
class Known:
    """What is known of the axis before.

    Attributes:
        start: Its arm, to start from; None: it is looked for.
        plant: For the sensorless variant.
        arm_inertia_share: Standard error of J_l as a share of it, 0 where it is only believed.
        source: Where that is from.
    """

    start: Arm | None = None
    plant: PlantTable | None = None
    arm_inertia_share: float = 0.0
    source: str = "nothing"


def what_is_known(bench: Bench, axis: int, identified: Identified | None, *, sensorless: bool) -> Known:
    """From the model file; the bench file's own model only serves the sensorless variant.

    Raises:
        NotPossibleError: The bench has no such axis, the model file is another robot's, or a plant is needed and there is none.
    """
    if axis not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {axis}; it has {', '.join(map(str, bench.axis))}")
    if identified is not None and identified.robot != bench.name:
        raise NotPossibleError(f"the model file is of {identified.robot!r}, this is {bench.name!r}: choose another")
    part_of = None if identified is None or axis not in identified.axis else identified.axis[axis].plant
    if part_of is not None:
        values = part_of.values
        total = values.gear_damping_nm_s_rad + values.arm_damping_nm_s_rad
        start = Arm(part_of.antiresonance_hz, part_of.damping)
        if total > 0.0:
            start = replace(start, gear_share=values.gear_damping_nm_s_rad / total)
        share = part_of.standard_error.get("arm_inertia_kg_m2", 0.0) / values.arm_inertia_kg_m2
        return Known(start, values, share, "the model file")
    model = bench.axis[axis].model
    if not sensorless:
        return Known()
    if model is None:
        raise NotPossibleError(
            f"without an accelerometer J_l and J_m of axis {axis} are needed, and neither the model file nor the bench file has "
            "them: hil identify plant finds them"
        )
    return Known(None, PlantTable(**model.model_dump(exclude={"ate"})), 0.0, "the bench file")


def sensing_of(bench: Bench, axis: int, known: Known, *, sensorless: bool) -> Sensing:
    """What the signal is."""
    table = bench.axis[axis]
    if not sensorless:
        return Sensing(table.tip_lever_m)
    if known.plant is None:
        raise NotPossibleError("without an accelerometer a plant is needed")
    return Sensing(known.plant.arm_inertia_kg_m2 / table.reduction_ratio, known.plant.motor_inertia_kg_m2)


def first_end_speed(bench: Bench, request: Request, known: Known) -> float:
    """Up to which speed the first pass goes.

    Raises:
        NotPossibleError: Limits keep it from passing f_m2.
    """
    if request.passes < 1:
        raise NotPossibleError(f"{request.passes} passes identify nothing; at least 1 is needed")
    arm_hz = None if known.start is None else known.start.resonance_hz
    return end_speed(bench, request.axis, request.acceleration_rps_s, arm_hz)


def identify_on(
    session: Session,
    request: Request,
    known: Known,
    keep: Callable[[int, RunResult, Ramps], None] = lambda number, result, motion: None,
    announce: Callable[[str], None] = lambda text: None,
) -> Identification:
    """Passes on a session whose nodes have been brought up, until the goal is met or no pass is left.

    Args:
        session: Brought up.
        request: What is asked for.
        known: What is known of the axis.
        keep: Called with number, result and motion of every pass, the stopped one included, before it is judged.
        announce: Called with what comes next.

    Raises:
        NotIdentifiedError: The runs do not give it; with the number that is wrong and the number needed.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench, axis, period = session.bench, request.axis, session.bench.bus.sync_period_s
    sensing = sensing_of(bench, axis, known, sensorless=request.sensorless)
    acceleration, end = request.acceleration_rps_s, first_end_speed(bench, request, known)
    found, start = Identification(), known.start
    for number in range(1, request.passes + 1):
        announce(f"pass {number} of at most {request.passes}: axis {axis} to {end:.2f} rps at {acceleration:.2f} rps/s and back")
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
                [*(each.sweep for each in found.passes), sweep],
                bench.axis[axis].reduction_ratio,
                sensing,
                start,
                ORDERS,
            )
        except ValueError as error:
            raise NotPossibleError(f"not identified: {error}") from error
        estimate = _with_inertia_error(estimate, known.arm_inertia_share)
        found.passes.append(Pass(motion, result.recording, sweep, estimate))
        check_estimate(estimate, sensorless=request.sensorless)
        _check_speed(bench, axis, motion, result.recording, estimate.arm.resonance_hz)
        found.missed = request.goal.missed(estimate)
        if not found.missed:
            break
        start = estimate.arm
        acceleration, end = _slower(bench, axis, acceleration, start.resonance_hz)
    _remark(found, bench, request, known)
    return found


def sweep_of(motion: Ramps, recording: Recording, axis: int, *, sensorless: bool) -> Sweep:
    """A recording as the fit takes it.

    Raises:
        NotIdentifiedError: The accelerometer is dead or saturated.
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
            raise NotIdentifiedError(f"the speed that the ramp {name} reached", reached, needed, "rps", why)


def _with_inertia_error(found: JointEstimate, share: float) -> JointEstimate:
    """Without an accelerometer the error of J_l is that of A_k."""
    if share <= 0.0:
        return found
    wider = {k: math.hypot(found.amplitude_error_arcsec[k], share * a) for k, a in found.error.amplitude_arcsec.items()}
    return replace(found, amplitude_error_arcsec=wider)


def _remark(found: Identification, bench: Bench, request: Request, known: Known) -> None:
    """What is worth saying of a result that stands."""
    estimate, table = found.estimate, bench.axis[request.axis]
    apart = [each for each in estimate.agreement if each.sigma > AGREEMENT_SIGMAS]
    found.notes += [
        f"{each.name} is {each.forward:.2f} forwards and {each.backward:.2f} backwards, {each.sigma:.1f} standard errors apart; "
        f"the standard errors have been widened {estimate.widened:.1f} times"
        for each in apart
    ]
    for order in ORDERS:
        sigmas = estimate.error.amplitude_arcsec[order] / max(estimate.amplitude_error_arcsec[order], 1e-30)
        if sigmas < 3.0:
            found.notes.append(f"A_{order} is {sigmas:.1f} standard errors: φ_{order} means nothing")
    peak = max(float(np.max(np.abs(each.recording.axis(request.axis, "torque_nm")))) for each in found.passes)
    if peak >= TORQUE_SHARE * table.limits.torque_nm:
        found.notes.append(
            f"the motor torque reached {peak:.3g} N·m, its limit is {table.limits.torque_nm:g} N·m: a slower ramp is better"
        )
    if request.sensorless:
        share = known.arm_inertia_share
        error = f"whose standard error of {100.0 * share:.2g} % is in A_k's" if share else "whose error nobody has stated"
        found.notes.append(f"sensorless: A_k is as wrong as J_l from {known.source}, {error}; {SENSORLESS_BIAS}")
    found.notes += found.missed


def as_part(found: JointEstimate, request: Request, note: str = "") -> IdentifiedError:
    """The result as the model file holds it."""
    error, errors = found.error, {}
    for order in ORDERS:
        errors[f"a{order}_arcsec"] = found.amplitude_error_arcsec[order]
        errors[f"phi{order}_deg"] = found.phase_error_deg[order]
    errors |= {"arm_hz": found.arm_error.resonance_hz, "damping": found.arm_error.damping}
    if not request.sensorless:
        errors["accelerometer_delay_s"] = found.arm_error.delay_s
    return IdentifiedError(
        values=TransmissionError(
            a2_arcsec=error.amplitude_arcsec[2],
            phi2_deg=error.phase_deg[2],
            a4_arcsec=error.amplitude_arcsec[4],
            phi4_deg=error.phase_deg[4],
        ),
        standard_error=errors,
        arm_hz=found.arm.resonance_hz,
        damping=found.arm.damping,
        accelerometer_delay_s=0.0 if request.sensorless else found.arm.delay_s,
        learnt_by="sensorless" if request.sensorless else "identify",
        note=note,
    )


@dataclass
class Outcome:
    """What a whole identification gave.

    Attributes:
        result: What `result.json` holds.
        part: For the model file; None where nothing was identified.
        failure: Why nothing was, or None.
        not_restored: What could not be put back in the nodes.
    """

    result: dict[str, Any]
    part: IdentifiedError | None
    failure: Exception | None
    not_restored: list[str]


def identify_ate(
    bench: Bench,
    request: Request,
    out: Path,
    identified: Identified | None = None,
    *,
    channel: Channel | None = None,
    overload: bool = False,
    announce: Callable[[str], None] = lambda text: None,
    progress: Callable[[float], None] = lambda share: None,
) -> Outcome:
    """Run passes on the bus, and keep recordings, bus log and result.json, whatever comes of them once something has moved.

    Args:
        bench: The bench file.
        request: What is asked for.
        out: Directory; made if it is not there.
        identified: The model file, if there is one.
        channel: The bus; opened from the bench file's address, and closed, unless it is given.
        overload: Run even what does not fit on the bus.
        announce: Called with what comes next.
        progress: Called with the share of the present pass.

    Raises:
        HilError: Nothing has moved yet: nodes or limits do not allow it.
        ChannelError: The bus is not there, or was lost before anything was recorded.
    """
    known = what_is_known(bench, request.axis, identified, sensorless=request.sensorless)
    first_end_speed(bench, request, known)
    (out / "runs").mkdir(parents=True, exist_ok=True)
    bus = open_channel(parse_address(bench.bus.address)) if channel is None else channel
    started, runs = datetime.datetime.now(datetime.UTC), list[dict[str, Any]]()
    found: Identification | None = None
    failure: Exception | None = None
    not_restored: list[str] = []

    def keep(number: int, result: RunResult, motion: Ramps) -> None:
        runs.append(_kept(out, number, result, motion, request.axis))

    try:
        if not overload:
            end = first_end_speed(bench, request, known)
            motion = ramps(
                bench, request.axis, _middle_rev(bench, request.axis), request.acceleration_rps_s, end, bench.bus.sync_period_s
            )
            check_load(bench, bus, Experiment("identification of the transmission error", request.axis, "none"), motion.motion)
        with Session(bench, bus, BusLog(out / "bus.log", log_channel(bus)), progress) as session:
            not_restored = session.not_restored
            session.bring_up()
            found = identify_on(session, request, known, keep, announce)
    except Exception as error:
        if not runs:
            raise
        failure = error
    finally:
        if channel is None:
            bus.close()
    part_of = None if found is None else as_part(found.estimate, request, started.date().isoformat())
    kept: dict[str, Any] = {
        "schema": 1,
        "kind": KIND,
        "bench": bench_record(bench, started, lock_step=bus.is_lock_step),
        "axis": request.axis,
        "sensorless": request.sensorless,
        "known_before": {"source": known.source, "start": None if known.start is None else asdict(known.start)},
        "sensing": asdict(sensing_of(bench, request.axis, known, sensorless=request.sensorless)),
        "passes": runs,
    }
    if found is not None and part_of is not None:
        kept |= _result(found, part_of)
    if failure is not None:
        kept["stopped" if isinstance(failure, SafetyStopError) else "not_identified"] = str(failure)
    if not_restored:
        kept["not_restored"] = not_restored
    write_json(out / "result.json", kept)
    return Outcome(kept, part_of, failure, not_restored)


def _middle_rev(bench: Bench, axis: int) -> float:
    limits = bench.axis[axis].limits
    return 0.5 * (limits.position_min_rev + limits.position_max_rev)


def _kept(out: Path, number: int, result: RunResult, motion: Ramps, axis: int) -> dict[str, Any]:
    """Save the recordings of a pass; what result.json says of it."""
    path = out / "runs" / f"ate-axis{axis}-pass{number}.csv"
    result.recording.save(path)
    kept: dict[str, Any] = {
        "acceleration_rps_s": motion.trajectory.acceleration_rps_s,
        "end_rps": motion.trajectory.end_rps,
        "ramp_s": motion.trajectory.ramp_s,
        "forward_from_s": motion.forward.start * motion.motion.period_s + motion.trajectory.dwell_s,
        "backward_from_s": motion.backward.start * motion.motion.period_s + motion.trajectory.dwell_s,
        "low_rev": motion.low_rev,
        "high_rev": motion.high_rev,
        "sync_period_s": motion.motion.period_s,
        "cycles": result.cycles,
        "missed_cycles": result.missed_cycles,
        "sensor_missed": result.sensor_missed,
        "motion_s": round(result.motion_s, 6),
        "wall_s": round(result.wall_s, 4),
        "recording": path.relative_to(out).as_posix(),
    }
    if result.timing is not None:
        kept["timing"] = {"dropped_cycles": result.dropped_cycles, **asdict(result.timing)}
    if result.stopped is not None:
        kept["stopped"] = result.stopped.reason
    return kept


def _result(found: Identification, part_of: IdentifiedError) -> dict[str, Any]:
    """What was found, as result.json holds it."""
    estimate = found.estimate
    return {
        "ate": part_of.model_dump(),
        "fit": {
            "delay_s": estimate.arm.delay_s,
            "delay_error_s": estimate.arm_error.delay_s,
            "gear_share": estimate.arm.gear_share,
            "residual": estimate.residual,
            "explained": estimate.explained,
            "explained_by_error": estimate.explained_by_error,
            "motion_scale": estimate.motion_scale,
            "motion_scale_error": estimate.motion_scale_error,
            "widened": estimate.widened,
            "band_hz": list(estimate.band_hz),
            "agreement": [asdict(each) for each in estimate.agreement],
        },
        "history": [_history(each.estimate) for each in found.passes],
        "is_within_goal": not found.missed,
        "notes": found.notes,
    }


def _history(estimate: JointEstimate) -> dict[str, Any]:
    """The standard errors after a pass."""
    return {
        **{f"a{k}_error_arcsec": estimate.amplitude_error_arcsec[k] for k in ORDERS},
        **{f"phi{k}_error_deg": estimate.phase_error_deg[k] for k in ORDERS},
    }
