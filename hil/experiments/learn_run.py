"""`hil learn`: adaptive cancellation of some axes on the bus, its passes kept, its estimates in the model file."""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drive_profiles.address import parse_address
from hil.can.channel import Channel, open_channel
from hil.design.inverse import Way
from hil.errors import NotPossibleError, SafetyStopError
from hil.experiments.ate_motion import Ramps, end_speed, ramps
from hil.experiments.learning import ACCELERATION_RPS_S, PASSES, Learnt, learn
from hil.experiments.plan import Experiment
from hil.experiments.runner import bench_record, check_load, log_channel, write_json
from hil.master.bench import Bench
from hil.master.identified import load_identified
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog

KIND = "learn"


@dataclass(frozen=True)
class LearnRequest:
    """What is asked for.

    Attributes:
        axes: One after the other.
        passes: Of each.
        acceleration_rps_s: Of every ramp.
        way: How corrections are made.
        note: Load, temperature: goes into the model file beside the date.
    """

    axes: tuple[int, ...]
    passes: int = PASSES
    acceleration_rps_s: float = ACCELERATION_RPS_S
    way: Way = "reference"
    note: str = ""


@dataclass
class LearnOutcome:
    """What came of it.

    Attributes:
        result: What `result.json` holds.
        learnt: By axis; those that are in the model file.
        failure: Why not all are, or None.
        not_restored: What could not be put back in the nodes.
    """

    result: dict[str, Any]
    learnt: dict[int, Learnt]
    failure: Exception | None
    not_restored: list[str]


def learn_on_bus(
    bench: Bench,
    request: LearnRequest,
    out: Path,
    model: Path,
    *,
    channel: Channel | None = None,
    overload: bool = False,
    announce: Callable[[str], None] = lambda text: None,
    progress: Callable[[float], None] = lambda share: None,
) -> LearnOutcome:
    """Learn axis by axis; each that has learnt is in the model file at once, whatever becomes of the next.

    Args:
        bench: The bench file.
        request: What is asked for.
        out: Directory for recordings, bus log and result.json; made if it is not there.
        model: The model file: read where it is there, for the motors' inertia, and written.
        channel: The bus; opened from the bench file's address, and closed, unless it is given.
        overload: Run even what does not fit on the bus.
        announce: Called with what comes next.
        progress: Called with the share of the present pass.

    Raises:
        HilError: Nothing has moved yet: nodes, limits or files do not allow it.
        ChannelError: The bus is not there, or was lost before anything was recorded.
    """
    identified = load_identified(model) if model.exists() else None
    if identified is not None and identified.robot != bench.name:
        raise NotPossibleError(f"{model} is of {identified.robot!r}, this is {bench.name!r}: choose another")
    ends = {axis: end_speed(bench, axis, request.acceleration_rps_s, None) for axis in request.axes if axis in bench.axis}
    (out / "runs").mkdir(parents=True, exist_ok=True)
    bus = open_channel(parse_address(bench.bus.address)) if channel is None else channel
    started, runs, learnt = datetime.datetime.now(datetime.UTC), list[dict[str, Any]](), dict[int, Learnt]()
    failure: Exception | None = None
    not_restored: list[str] = []
    try:
        if not overload:
            for axis, end in ends.items():
                limits = bench.axis[axis].limits
                middle = 0.5 * (limits.position_min_rev + limits.position_max_rev)
                motion = ramps(bench, axis, middle, request.acceleration_rps_s, end, bench.bus.sync_period_s)
                check_load(bench, bus, Experiment("learning", axis, "none"), motion.motion)
        with Session(bench, bus, BusLog(out / "bus.log", log_channel(bus)), progress) as session:
            not_restored = session.not_restored
            session.bring_up()
            for axis in request.axes:
                learnt[axis] = learn(
                    session,
                    axis,
                    identified,
                    passes=request.passes,
                    acceleration_rps_s=request.acceleration_rps_s,
                    way=request.way,
                    keep=_keeper(out, axis, runs),
                    announce=announce,
                )
                identified = learnt[axis].store(model, bench.name, request.note, started.date())
    except Exception as error:
        if not runs:
            raise
        failure = error
    finally:
        if channel is None:
            bus.close()
    kept: dict[str, Any] = {
        "schema": 1,
        "kind": KIND,
        "bench": bench_record(bench, started, lock_step=bus.is_lock_step),
        "model": str(model),
        "runs": runs,
        "learnt": [each.record(request.note, started.date()) for each in learnt.values()],
    }
    if failure is not None:
        kept["stopped" if isinstance(failure, SafetyStopError) else "not_learnt"] = str(failure)
    if not_restored:
        kept["not_restored"] = not_restored
    write_json(out / "result.json", kept)
    return LearnOutcome(kept, learnt, failure, not_restored)


def _keeper(out: Path, axis: int, runs: list[dict[str, Any]]) -> Callable[[int, RunResult, Ramps], None]:
    """Saves each pass of an axis, and notes it for result.json."""

    def keep(number: int, result: RunResult, motion: Ramps) -> None:
        path = out / "runs" / f"learn-axis{axis}-pass{number}.csv"
        result.recording.save(path)
        noted: dict[str, Any] = {
            "axis": axis,
            "pass": number,
            "acceleration_rps_s": motion.trajectory.acceleration_rps_s,
            "end_rps": motion.trajectory.end_rps,
            "cycles": result.cycles,
            "missed_cycles": result.missed_cycles,
            "wall_s": round(result.wall_s, 4),
            "recording": path.relative_to(out).as_posix(),
        }
        if result.stopped is not None:
            noted["stopped"] = result.stopped.reason
        runs.append(noted)

    return keep


def summary(outcome: LearnOutcome) -> Sequence[str]:
    """What came of it, a line per axis."""
    lines = []
    for axis, learnt in outcome.learnt.items():
        error, delay_ms = learnt.estimate.error, 1e3 * learnt.passes[-1].set_point_delay_s
        orders = ", ".join(
            f"A_{k} = {error.amplitude_arcsec[k]:.2f}″ ± {learnt.estimate.amplitude_error_arcsec[k]:.2f}″, "
            f"φ_{k} = {error.phase_deg[k]:.1f}° ± {learnt.estimate.phase_error_deg[k]:.1f}°"
            for k in error.amplitude_arcsec
        )
        late = f"; the motor follows {delay_ms:.2f} ms later than known" if delay_ms else ""
        lines.append(f"axis {axis}: {orders}; vibration −{100.0 * learnt.fall:.0f} % after {len(learnt.passes)} passes{late}")
    return lines
