"""Passes as they are run, and as input of the fit."""

from collections.abc import Sequence

from hil.control.arrays import Real
from hil.design.ate.model import Signs, Sweep, resolution_rad
from hil.design.late_samples import on_time
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import check_accelerometer, check_moved, check_run
from hil.experiments.ate.motion import PassKeeper, Ramps
from hil.master.session import Session
from hil.master.set_point_adder import SetPointAdder
from hil.recording import Recording
from hil.robot_tables import ORDERS

SKIP_TORQUE = 0.12
"""Fraction of a ramp, from its beginning, that does not count without an accelerometer, since the torque is friction's there. A
factor of 2 changes 1.0, and takes two more passes on one of four drawn robots."""


def run_pass(
    session: Session,
    motion: Ramps,
    number: int,
    keep: PassKeeper | None = None,
    adder: SetPointAdder | None = None,
    *,
    sensorless: bool = False,
) -> tuple[Recording, Sweep]:
    """Run a pass; return its recording, also as input of the fit.

    The pass is kept, a stopped one too, before it is checked. `sensorless` takes the motor torque instead of the tip's
    acceleration.

    Raises:
        AteNotIdentifiedError: The motor did not move, the pass is incomplete, or the sensor is dead or saturated.
        NotPossibleError: The sensor is not mounted as in the bench file.
        SafetyStopError: The run was stopped.
        HilError: Limits or nodes do not allow the run.
    """
    bench, axis = session.bench, motion.ramp.limits.axis
    result, sensor = session.run(motion.motion, "none", "drive", adder), bench.accelerometer.title
    if keep is not None:
        keep(number, result, motion)
    check_moved(motion, result, axis, bench.axis[axis].limits)
    if result.stopped is not None:
        raise result.stopped
    check_run(result, sensorless=sensorless, sensor=sensor)
    return result.recording, _sweep_of(motion, result.recording, axis, sensor, sensorless=sensorless)


def _sweep_of(motion: Ramps, recording: Recording, axis: int, sensor: str, *, sensorless: bool) -> Sweep:
    if sensorless:
        torque = recording.axis(axis, "torque_nm")
        return sweep_on_time(recording, axis, torque, motion.direction(SKIP_TORQUE))
    if recording.doubt is not None:
        raise NotPossibleError(f"not identified: {recording.doubt}", ("wrong axis or wiring",))
    tip = recording.felt_m_s2
    check_accelerometer(tip, sensor)
    return sweep_on_time(recording, axis, tip, motion.direction(), recording.axis(axis, "torque_nm"))


def sweep_on_time(recording: Recording, axis: int, signal: Real, direction: Signs, torque_nm: Real | None = None) -> Sweep:
    """Input of the fit; late motor angles are moved back in time.

    The torque is that of the motor beside a tip acceleration.
    """
    angle = recording.axis(axis, "position_rad")
    found = on_time(angle, recording.period_s, resolution_rad(angle), max(ORDERS))
    return Sweep(found.angle_rad, signal, recording.period_s, direction, torque_nm, found.count, found.delay_s)


def late_words(sweeps: Sequence[Sweep]) -> list[str]:
    """Sentence on late samples of the motor angle; empty without any."""
    late = sum(each.late for each in sweeps)
    if not late:
        return []
    late_ms = 1e3 * max(each.late_s for each in sweeps)
    return [
        f"{late} of {sum(len(each.signal) for each in sweeps)} motor angles were sampled late, by about {late_ms:.2f} ms, "
        "and were moved back in time: other frames delay SYNC; `hil plan` shows the load of the bus"
    ]
