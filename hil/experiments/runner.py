"""Runs experiments on a bench and keeps what they give: recordings, the bus log, `result.json` and the report."""

import datetime
import json
import os
import platform
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from drive_profiles.address import parse_address
from hil.analysis import TIP_BAND_HZ
from hil.can.channel import Channel, open_channel
from hil.errors import NotPossibleError, SafetyStopError
from hil.experiments.cancellation import cancel_inside, cancellation_on
from hil.experiments.cancellation_trial import averaged, choose, choose_inside
from hil.experiments.plan import Experiment, claims, comparisons, entries
from hil.experiments.treatment import FILTERING, Knowledge, Treated, treated
from hil.master.bench import Bench
from hil.master.motion import Motion, RunResult
from hil.master.session import Session
from hil.recording import BusLog

SCHEMA = 1

ClockName = Literal["lock-step", "wall"]


class Outcome:
    """What a bench session gave.

    Attributes:
        result: What `result.json` holds.
        stopped: The stop that ended it early, or None.
        failed_claims: Claims that do not hold.
        not_restored: What could not be put back in the nodes.
        invalid: Why windows could not be judged.
    """

    def __init__(self, result: dict[str, Any], stopped: SafetyStopError | None) -> None:
        """Keep both."""
        self.result, self.stopped = result, stopped
        self.not_restored: list[str] = result.get("not_restored", [])
        self.invalid = [run["invalid"] for run in result["runs"] if "invalid" in run]
        self.failed_claims = [claim for claim in result["paper"] if not claim["holds"]]


def run_experiments(
    bench: Bench,
    experiments: list[Experiment],
    out: Path,
    *,
    is_paper: bool = False,
    reset_faults: bool = False,
    clock: ClockName | None = None,
    overload: bool = False,
    knowledge: Knowledge | None = None,
    repeat: int = 1,
    announce: Callable[[Experiment], None] = lambda experiment: None,
    tell: Callable[[str], None] = lambda text: None,
    progress: Callable[[float], None] = lambda share: None,
) -> Outcome:
    """Run experiments one after the other on one bus.

    `out/runs/*.csv`, `out/bus.log` and `out/result.json` are written whatever happens once the nodes have been found: a run
    that is stopped keeps what it recorded, and ends the session.

    Args:
        bench: The bench file.
        experiments: In their order.
        out: Directory for what is kept; made if it is not there.
        is_paper: Judge all of the paper's claims, its tables included; else only that a notch keeps the specification.
        reset_faults: Reset drives that are in fault before anything else.
        clock: The clock that the bus must have; None for whichever it has.
        overload: Run even what does not fit on the bus.
        knowledge: What some treatments need beside the bench file.
        repeat: How often each motion is run; judged is the mean of the recordings, in which the sensor's noise is less.
        announce: Called before each run.
        tell: Called with each step of a trial.
        progress: Called with the share of the present run.

    Raises:
        NotPossibleError: The bus has another clock, or does not carry a run, or what a treatment needs is not known; nothing has
            been sent.
        HilError: Nodes, limits or set-up do not allow a run; what was changed is put back, what earlier runs gave is kept.
        ChannelError: The bus is not there, or was lost before anything was enabled.
    """
    motions = [(experiment, experiment.motion(bench)) for experiment in experiments]
    ways = [
        treated(bench, experiment.compensation, knowledge or Knowledge(), motion.period_s, experiment.loop)
        for experiment, motion in motions
    ]
    (out / "runs").mkdir(parents=True, exist_ok=True)  # before anything moves: a recording needs a place
    address = parse_address(bench.bus.address)
    channel = open_channel(address)
    runs: list[dict[str, Any]] = []
    stopped: SafetyStopError | None = None
    failure: Exception | None = None
    not_restored: list[str] = []
    started = datetime.datetime.now(datetime.UTC)
    try:
        _check_clock(channel, clock)
        check_band(motions)
        rooms = [overload or check_load(bench, channel, experiment, motion) for experiment, motion in motions]
        log = BusLog(out / "bus.log", log_channel(channel))
        with Session(bench, channel, log, progress) as session:
            not_restored = session.not_restored
            session.bring_up(reset_faults=reset_faults)
            for (experiment, motion), way, room in zip(motions, ways, rooms, strict=True):
                announce(experiment)
                session.check_interrupt()
                session.adopt(way.bench)
                results, told = _run(session, experiment, motion, replace(way, shows_filter=room), repeat, tell)
                result, path = _save(results, out / "runs" / experiment.file_name)
                runs += [entry | told for entry in entries(bench, experiment, result, path.relative_to(out).as_posix())]
                if result.stopped is not None:
                    stopped = result.stopped
                    break
    except SafetyStopError as stop:
        stopped = stop
    except Exception as error:
        if not runs:
            raise
        failure = error  # raised again below, when what earlier runs gave is on disk
    finally:
        channel.close()
    ended = stopped or failure
    compared = comparisons(runs)
    kept: dict[str, Any] = {
        "schema": SCHEMA,
        "bench": bench_record(bench, started, lock_step=channel.is_lock_step),
        "runs": runs,
        "comparisons": compared,
        "paper": claims(bench, runs, compared, is_paper=is_paper) if ended is None else [],
    }
    if ended is not None:
        kept["stopped"] = str(ended)
    if not_restored:
        kept["not_restored"] = not_restored
    write_json(out / "result.json", kept)
    if failure is not None:
        raise failure
    return Outcome(kept, stopped)


def _run(
    session: Session, experiment: Experiment, motion: Motion, way: Treated, repeat: int, tell: Callable[[str], None]
) -> tuple[list[RunResult], dict[str, Any]]:
    """Runs as their treatment wants them, up to the first that was stopped; and what is to be told of a trial before them."""
    cancellation, filters, told = None, way.filters, dict[str, Any]()
    if way.is_cancelled:
        with_notch = way.filters == "notch"
        cancellation = cancellation_on(session, way.cancel_with, motion, with_notch=with_notch)
        choice = choose(session, cancellation, motion, with_notch=with_notch, shows_filter=way.shows_filter, announce=tell)
        filters, told = choice.compensation, {"trial": choice.verification.record()}
        if choice.refusal is not None:
            cancellation, told = None, told | {"invalid": str(choice.refusal), "within_spec": False}
    is_inside = way.is_inside
    if is_inside:
        choice = choose_inside(session, way.cancel_with, motion, announce=tell)
        filters, told = choice.compensation, {"trial": choice.verification.record()}
        if choice.refusal is not None:
            is_inside, told = False, told | {"invalid": str(choice.refusal), "within_spec": False}
    results: list[RunResult] = []
    for number in range(1, repeat + 1):
        if repeat > 1:
            tell(f"run {number} of {repeat}")
        corrector = None if cancellation is None else cancellation.corrector()
        if is_inside:
            cancel_inside(session, way.cancel_with, motion.axes)
        result = session.run(motion, filters, experiment.loop, corrector, way.fixed, shows_filter=way.shows_filter)
        results.append(result)
        if number > 1:
            told["repeated"] = number
        if results[-1].stopped is not None:
            return [results[-1]], told
        session.check_interrupt()
    return results, told


def _save(results: list[RunResult], path: Path) -> tuple[RunResult, Path]:
    """What is judged of the runs of one motion, and where it is; of several each is kept beside it."""
    result = results[0] if len(results) == 1 else mean_of(results)
    for number, each in enumerate(results if len(results) > 1 else (), start=1):
        each.recording.save(path.with_name(f"{path.stem}-{number}.csv"))
    result.recording.save(path)
    return result, path


def mean_of(results: list[RunResult]) -> RunResult:
    """One result of several runs of the same motion: the mean of the recordings, and the worst of what can go wrong."""
    return replace(
        results[-1],
        recording=averaged([result.recording for result in results]),
        missed_cycles=max(result.missed_cycles for result in results),
        sensor_missed=max(result.sensor_missed for result in results),
        dropped_cycles=max(result.dropped_cycles for result in results),
        discarded=max(result.discarded for result in results),
    )


def _check_clock(channel: Channel, wanted: ClockName | None) -> None:
    if wanted == "wall" and channel.is_lock_step:
        raise NotPossibleError(
            f"time on {channel.address} is counted in SYNCs, so --clock wall is not possible there: start its emulator "
            "with the wall clock (plant-emulator serve --wall)"
        )
    if wanted == "lock-step" and not channel.is_lock_step:
        raise NotPossibleError(
            f"time on {channel.address} is the wall clock's, so --clock lock-step is not possible there: what is on it "
            "does not wait for SYNC"
        )


def check_band(motions: list[tuple[Experiment, Motion]]) -> None:
    """Refuse a SYNC period at which the vibration could not be judged afterwards."""
    for experiment, motion in motions:
        period_s = float(motion.time_s[1] - motion.time_s[0])
        if 0.5 / period_s <= TIP_BAND_HZ[1]:
            what = f"{experiment.title} at a SYNC period of {1e3 * period_s:g} ms"
            raise NotPossibleError(f"{what}: vibrations up to {TIP_BAND_HZ[1]:g} Hz need less than {500.0 / TIP_BAND_HZ[1]:g} ms")


def check_load(bench: Bench, channel: Channel, experiment: Experiment, motion: Motion) -> bool:
    """Refuse a run whose frames do not fit between two SYNCs, where the bit rate is known.

    Returns:
        Whether there is room for what the drives tell of their filters as well.

    Raises:
        NotPossibleError: They do not.
    """
    if channel.address.bitrate is None:
        return True
    from hil.master.plan_check import check  # noqa: PLC0415 - a bus without bit times does not need it

    where = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": str(channel.address)})})
    with_notch, period_s = experiment.compensation in FILTERING, motion.period_s
    for shows in (True, False) if with_notch and experiment.loop == "drive" else (False,):
        offset = motion.torque_offset_nm is not None
        verdict = check(
            where, motion.axes, experiment.loop, period_s, notch_state=shows, with_notch=with_notch, torque_offset=offset
        )
        if verdict.fits is not False:
            return shows
    raise NotPossibleError(f"{experiment.title} at a SYNC period of {1e3 * period_s:g} ms: {verdict.sentence} (--overload)")


def log_channel(channel: Channel) -> str:
    """The bus' name in its log."""
    return channel.address.channel if channel.address.interface == "socketcan" else channel.address.interface


def bench_record(bench: Bench, started: datetime.datetime, *, lock_step: bool) -> dict[str, Any]:
    """`bench` of result.json: which one, when, with what."""
    versions = {"python": platform.python_version()}
    for package in ("hil-bench", "python-can", "canopen", "numpy", "scipy", "numba"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "name": bench.name,
        "bus": bench.bus.address,
        "clock": "lock-step" if lock_step else "wall",
        "started_utc": started.isoformat(timespec="seconds"),
        "versions": versions,
        "file": bench.model_dump(mode="json"),
    }


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(temporary, path)
