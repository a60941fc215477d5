"""Treatments side by side: a set of them over a set of experiments and robots, gathered into one result.

Every robot keeps a directory as `hil run` would leave it; `result.json` above them holds the table, a row per experiment and
treatment. What cannot be run is left out with its reason before anything moves.
"""

import datetime
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drive_profiles.address import parse_address
from hil.can.channel import Channel, open_channel
from hil.control.trajectory import UnreachableError
from hil.design.compliance import Compliance, compliance, judged_speeds
from hil.errors import NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.experiments.cancellation import cancellation_for, inside_models
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION
from hil.experiments.plan import Experiment
from hil.experiments.runner import check_band, check_load, run_experiments, write_json
from hil.experiments.treatment import TREATMENTS, Knowledge, Treated, TreatmentName, treated
from hil.master.bench import CHAIN_AXES, Bench
from hil.master.identified import with_identified
from hil.master.request import check_host_loop

SCHEMA, KIND = 1, "compare"

HOST_CLOSED: frozenset[TreatmentName] = frozenset({"fixed-notch"})
"""Those that only the host can do; they are compared with a run without anything that the host closes too."""


@dataclass(frozen=True)
class Selection:
    """What is compared.

    Attributes:
        experiments: Names.
        axes: Of constant-acceleration runs; empty: those with a filter or a model.
        treatments: In their order; without any, `none` is what all others are compared with, so it is always run.
        named: Treatments that were asked for by name; of the others nobody is told twice when they are not possible.
    """

    experiments: tuple[str, ...] = (CONSTANT_ACCELERATION, LINE_MOTION)
    axes: tuple[int, ...] = ()
    treatments: tuple[TreatmentName, ...] = TREATMENTS
    named: frozenset[str] = frozenset()

    def wanted(self, bench: Bench) -> list[Experiment]:
        """Every run, drive-closed ones first: what the host closes may be refused at the last moment."""
        axes = self.axes or tuple(number for number, table in sorted(bench.axis.items()) if table.notch or table.model)
        places: list[tuple[str, int | None]] = []
        if CONSTANT_ACCELERATION in self.experiments:
            places += [(CONSTANT_ACCELERATION, axis) for axis in axes]
        if LINE_MOTION in self.experiments:
            places.append((LINE_MOTION, None))
        inside: list[TreatmentName] = ["none", *(name for name in self.treatments if name not in HOST_CLOSED and name != "none")]
        outside: list[TreatmentName] = [name for name in self.treatments if name in HOST_CLOSED]
        found = [Experiment(name, axis, way) for name, axis in places for way in inside]
        if outside:
            found += [Experiment(name, axis, way, "host") for name, axis in places for way in ("none", *outside)]
        return found


@dataclass(frozen=True)
class Robot:
    """One robot of a comparison.

    Attributes:
        bench: Its bench file.
        knowledge: What else is known of it.
        source: Where the bench file is.
    """

    bench: Bench
    knowledge: Knowledge = field(default_factory=Knowledge)
    source: str = ""


@dataclass(frozen=True)
class LeftOut:
    """A run that is not made, and why."""

    experiment: Experiment
    reason: str


@dataclass(frozen=True)
class Plan:
    """What is run on one robot.

    Attributes:
        robot: With its model replaced by what has been identified.
        ways: Each run with how it is made.
        left_out: What is not run.
    """

    robot: Robot
    ways: Mapping[Experiment, Treated]
    left_out: tuple[LeftOut, ...]

    @property
    def experiments(self) -> list[Experiment]:
        """The runs in their order."""
        return list(self.ways)


@dataclass
class Compared:
    """What came of it.

    Attributes:
        result: What `result.json` holds.
        failure: What ended it early, or None.
        not_restored: What could not be put back in the nodes.
        unmet: What was asked for by name and not compared, was refused, or could not be judged.
    """

    result: dict[str, Any]
    failure: Exception | None
    not_restored: list[str]
    unmet: list[str]


# -- what can be run -------------------------------------------------------------------------------------------------------


def plan(robot: Robot, selection: Selection, *, channel: Channel | None = None, overload: bool = False) -> Plan:
    """Sort what is wanted into what is run and what is left out; nothing is sent.

    Args:
        robot: Which.
        selection: What is wanted.
        channel: Its bus, asked for its bit rate; opened and closed unless it is given.
        overload: Run even what does not fit on the bus.

    Raises:
        NotPossibleError: Nothing is left but runs without any treatment; or the model file is another robot's.
        ChannelError: The bus is not there.
    """
    bench, identified = robot.bench, robot.knowledge.identified
    if identified is not None:
        if identified.robot != bench.name:
            raise NotPossibleError(f"the model file is of {identified.robot!r}, this is {bench.name!r}: choose another")
        robot = replace(robot, bench=with_identified(bench, identified))
    bus = open_channel(parse_address(bench.bus.address)) if channel is None else channel
    ways: dict[Experiment, Treated] = {}
    left_out: list[LeftOut] = []
    try:
        for experiment in selection.wanted(robot.bench):
            try:
                ways[experiment] = _way(robot, experiment, None if overload else bus)
            except (NotPossibleError, UnsafeRequestError, UnreachableError) as error:
                if (experiment.compensation, experiment.loop) != ("none", "host"):  # it is there for the others' sake
                    left_out.append(LeftOut(experiment, str(error)))
    finally:
        if channel is None:
            bus.close()
    needed = {_place(each) for each in ways if each.compensation != "none"}
    kept = {each: way for each, way in ways.items() if _place(each) in needed}
    if not kept:
        reasons = "; ".join(dict.fromkeys(each.reason for each in left_out))
        raise NotPossibleError(f"{bench.name}: there is nothing to compare" + (f": {reasons}" if reasons else ""))
    return Plan(robot, kept, tuple(left_out))


def _place(experiment: Experiment) -> tuple[str, int | None, str]:
    """What runs that are compared with each other share."""
    return experiment.name, experiment.axis, experiment.loop


def _way(robot: Robot, experiment: Experiment, channel: Channel | None) -> Treated:
    """How a run is made.

    Raises:
        NotPossibleError: It lacks something, or the bus does not carry it.
        UnsafeRequestError: It would leave a limit.
        UnreachableError: The line leaves the arm's reach.
    """
    bench, name = robot.bench, experiment.compensation
    motion = experiment.motion(bench)
    check_band([(experiment, motion)])
    way = treated(bench, name, robot.knowledge, motion.period_s, experiment.loop)
    where = "none of its axes" if experiment.axis is None else f"axis {experiment.axis}"
    if way.filters == "notch" and not any(way.bench.axis[number].notch for number in motion.axes):
        raise NotPossibleError(f"{name}: the bench file has no notch for {where}")
    designs = robot.knowledge.designs
    if name == "notch-optimised" and designs is not None and not set(designs.axis) & set(motion.axes):
        raise NotPossibleError(f"{name}: the design file has no filter for {where}")
    if name in HOST_CLOSED and not set(way.fixed) & set(motion.axes):
        raise NotPossibleError(f"{name}: no notch and no model of {where}")
    if way.is_cancelled:
        with_notch = way.filters == "notch"
        cancellation_for(way.bench, way.cancel_with, motion.axes, motion.period_s, with_notch=with_notch).check(way.bench, motion)
    if way.is_inside:
        inside_models(way.bench, way.cancel_with, motion.axes)
    if experiment.loop == "host":
        for number in motion.axes:
            table = way.bench.axis[number]
            check_host_loop(number, table, motion.period_s, with_notch=way.filters == "notch", held=way.fixed.get(number))
    if channel is not None:
        check_load(way.bench, channel, experiment, motion)
    return way


# -- running ---------------------------------------------------------------------------------------------------------------


def compare(
    plans: Sequence[Plan],
    selection: Selection,
    out: Path,
    *,
    overload: bool = False,
    repeat: int = 1,
    more: Mapping[str, Any] | None = None,
    announce: Callable[[Experiment], None] = lambda experiment: None,
    tell: Callable[[str], None] = lambda text: None,
    progress: Callable[[float], None] = lambda share: None,
) -> Compared:
    """Run what has been planned, robot after robot, and gather it.

    A robot that cannot be run does not keep the others from being run; a stop does, and so does Ctrl-C.

    Args:
        plans: One per robot.
        selection: What they were made of.
        out: Directory: one below it per robot, and result.json.
        overload: Run even what does not fit on the bus.
        repeat: How often each motion is run; judged is the mean of the recordings.
        more: What else result.json is to hold.
        announce: Called before each run.
        tell: Called with each step of a trial.
        progress: Called with the share of the present run.
    """
    started = datetime.datetime.now(datetime.UTC)
    robots: list[dict[str, Any]] = []
    failure: Exception | None = None
    for each, directory in zip(plans, _directories(plans), strict=True):
        kept: dict[str, Any] = {"runs": [], "comparisons": []}
        ended = ""
        if isinstance(failure, SafetyStopError):
            ended = "not run: what came before was stopped"
        else:
            try:
                done = run_experiments(
                    each.robot.bench,
                    each.experiments,
                    out / directory,
                    overload=overload,
                    repeat=repeat,
                    knowledge=each.robot.knowledge,
                    announce=announce,
                    tell=tell,
                    progress=progress,
                )
                kept = done.result
                failure, ended = done.stopped or failure, str(done.stopped or "")
            except Exception as error:  # noqa: BLE001 - kept beside what the other robots gave; the caller raises it
                failure, ended = failure or error, str(error)
                kept = _kept(out / directory) or kept
        robots.append(_gathered(each, directory, kept, ended))
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "kind": KIND,
        "started_utc": started.isoformat(timespec="seconds"),
        "asked": {
            "experiments": list(selection.experiments),
            "axes": list(selection.axes),
            "compensations": list(selection.treatments),
            "named": sorted(selection.named),
        },
        "robots": robots,
        **(more or {}),
    }
    write_json(out / "result.json", result)
    not_restored = [what for robot in robots for what in robot["not_restored"]]
    return Compared(result, failure, not_restored, _unmet(robots, selection))


def _kept(directory: Path) -> dict[str, Any] | None:
    """What earlier runs of a session that failed have left."""
    try:
        kept = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return kept if isinstance(kept, dict) else None


def _directories(plans: Sequence[Plan]) -> list[str]:
    """A name for each robot's directory: its own, with a number where several share it."""
    found: list[str] = []
    for each in plans:
        slug = re.sub(r"[^a-z0-9]+", "-", each.robot.bench.name.lower()).strip("-") or "robot"
        same = sum(name == slug or name.startswith(f"{slug}-") for name in found)
        found.append(slug if not same else f"{slug}-{same + 1}")
    return found


# -- the table -------------------------------------------------------------------------------------------------------------


def _gathered(each: Plan, directory: str, kept: Mapping[str, Any], ended: str) -> dict[str, Any]:
    """One robot, as result.json holds it."""
    bench, runs = each.robot.bench, list(kept["runs"])
    found = {(run["experiment"], run["axis"], run["compensation"], run["loop"]): run for run in runs if run["order"] != 4}
    changes = {
        (pair["experiment"], pair["axis"], pair["compensation"], pair["loop"]): pair for pair in kept["comparisons"]
    }  # fmt: skip
    rows = []
    for experiment, way in each.ways.items():
        key = (experiment.name, experiment.axis, experiment.compensation, experiment.loop)
        row = _row(experiment) | _measured(found.get(key), changes.get(key), ended)
        rows.append(row | {"compliance": _factors(bench, experiment, way, found.get(key))})
    rows += [_row(left.experiment) | {"left_out": left.reason} for left in each.left_out]
    robot: dict[str, Any] = {
        "name": bench.name,
        "source": each.robot.source,
        "directory": directory,
        "bus": bench.bus.address,
        "tip_mm": bench.specification.tip_mm,
        "rows": rows,
        "compliance": [entry for number in sorted(bench.axis) for entry in _compliances(each, number, found)],
        "not_restored": list(kept.get("not_restored", [])),
    }
    if "bench" in kept:
        robot["versions"] = kept["bench"]["versions"]
    if ended:
        robot["ended"] = ended
    return robot


def _row(experiment: Experiment) -> dict[str, Any]:
    return {
        "experiment": experiment.name,
        "axis": experiment.axis,
        "compensation": experiment.compensation,
        "loop": experiment.loop,
        "tip_peak_mm": None,
        "tip_peak_change_pct": None,
        "spectrum_area": None,
        "spectrum_area_change_pct": None,
        "within_spec": None,
        "trial": None,
        "compliance": None,
    }


def _measured(run: Mapping[str, Any] | None, change: Mapping[str, Any] | None, ended: str) -> dict[str, Any]:
    """The numbers of a run; a cancellation that was refused has none, since the run was made without it."""
    if run is None:
        return {"not_judged": ended or "not run"}
    told: dict[str, Any] = {"recording": run["recording"]}
    if "trial" in run:
        told["trial"] = "accepted" if run["trial"]["is_good"] else "refused"
    if "invalid" in run or "stopped" in run:
        return told | {"not_judged": run.get("invalid") or run["stopped"]}
    told |= {name: run[name] for name in ("tip_peak_mm", "spectrum_area", "within_spec")}
    if change is not None:
        for name in ("tip_peak", "spectrum_area"):
            told[f"{name}_change_pct"] = round(-change[f"{name}_reduction_pct"], 3)
    return told


def _factors(bench: Bench, experiment: Experiment, way: Treated, run: Mapping[str, Any] | None) -> dict[str, float] | None:
    """How much more compliant the worst of the moved axes is than without the treatment, closed in the same place."""
    if run is None:
        return None
    moved = CHAIN_AXES if experiment.axis is None else (experiment.axis,)
    pairs = [(_compliance(bench, number, None, run), _compliance(way.bench, number, way, run)) for number in moved]
    ratios = [(after.slow / before.slow, after.peak / before.peak) for before, after in pairs if before and after]
    if not ratios:
        return None
    return {"slow": round(max(slow for slow, _ in ratios), 3), "peak": round(max(peak for _, peak in ratios), 3)}


def _compliance(bench: Bench, number: int, way: Treated | None, run: Mapping[str, Any]) -> Compliance | None:
    """Of one axis, at the period of the run; None where it has no model."""
    with_notch = way is not None and way.filters == "notch"
    loop = bench.axis[number].loop(run["control_period_s"], int(run["loop"] == "host"), with_notch=with_notch)
    if loop is None:
        return None
    if way is not None and number in way.fixed:
        loop = replace(loop, fixed=(way.fixed[number],))
    return compliance(loop, judged_speeds(loop))


def _compliances(each: Plan, number: int, found: Mapping[Any, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The compliance of one axis with each treatment that changes gains or filters, as far as it was run."""
    told: dict[tuple[str, str], dict[str, Any]] = {}
    for experiment, way in each.ways.items():
        moved = CHAIN_AXES if experiment.axis is None else (experiment.axis,)
        run = found.get((experiment.name, experiment.axis, experiment.compensation, experiment.loop))
        key = (experiment.compensation, experiment.loop)
        if run is None or number not in moved or way.is_cancelled or way.is_inside or key in told:
            continue
        one = _compliance(way.bench, number, way, run)
        if one is not None:
            told[key] = {"axis": number, "compensation": key[0], "loop": key[1], **asdict(one)}
    return list(told.values())


def _unmet(robots: Sequence[Mapping[str, Any]], selection: Selection) -> list[str]:
    """What the user has to know before believing that everything was compared."""
    unmet = []
    for robot in robots:
        for row in robot["rows"]:
            reason = row.get("not_judged") or (row.get("left_out") if row["compensation"] in selection.named else None)
            if reason:
                where = "line motion" if row["axis"] is None else f"axis {row['axis']}"
                unmet.append(f"{robot['name']}, {where}, {row['compensation']}: {reason}")
    return unmet


def knowledge_by_robot(
    identified: Sequence[Any], designs: Sequence[Any], learnt: Sequence[Any], names: Sequence[str]
) -> dict[str, Knowledge]:
    """Model and design files sorted by the robot that they are of.

    Args:
        identified: Model files of `hil identify`.
        designs: Design files.
        learnt: Model files of `hil learn`.
        names: Of the robots.

    Raises:
        NotPossibleError: A file is of none of them, or two are of the same.
    """
    sorted_: dict[str, dict[str, Any]] = {name: {} for name in names}
    for kind, files in (("identified", identified), ("designs", designs), ("learnt", learnt)):
        for file in files:
            if file.robot not in sorted_:
                raise NotPossibleError(f"a file is of {file.robot!r}; the robots here are {', '.join(map(repr, sorted_))}")
            if kind in sorted_[file.robot]:
                raise NotPossibleError(f"two files of the same kind are of {file.robot!r}: choose one")
            sorted_[file.robot][kind] = file
    return {name: Knowledge(**files) for name, files in sorted_.items()}


def summary(result: Mapping[str, Any]) -> list[str]:
    """The table as text, and what was left out."""
    lines = []
    for robot in result["robots"]:
        lines.append(f"{robot['name']} ({robot['bus']})")
        head = f"{'experiment':<30}{'loop':<7}{'compensation':<17}{'tip mm':<9}{'change':<10}{'area':<9}{'change':<10}"
        lines.append(f"  {head}{'within':<8}compliance at 1 Hz, largest")
        lines += ["  " + _line(row) for row in robot["rows"] if "left_out" not in row]
        reasons: dict[str, list[str]] = {}
        for row in robot["rows"]:
            if "left_out" in row:
                where = "line motion" if row["axis"] is None else f"axis {row['axis']}"
                reasons.setdefault(row["left_out"], []).append(f"{row['compensation']} ({where}, {row['loop']}-closed)")
        lines += [f"  left out: {', '.join(names)}: {reason}" for reason, names in reasons.items()]
    return lines


def _line(row: Mapping[str, Any]) -> str:
    where = row["experiment"] + ("" if row["axis"] is None else f", axis {row['axis']}")
    head = f"{where:<30}{row['loop']:<7}{row['compensation']:<17}"
    if "not_judged" in row:
        return head + f"not judged: {row['not_judged']}"
    factors = row["compliance"]
    told = "-" if factors is None else f"×{factors['slow']:.2f}, ×{factors['peak']:.2f}"
    return (
        f"{head}{row['tip_peak_mm']:<9.4f}{_percent(row['tip_peak_change_pct']):<10}{row['spectrum_area']:<9.3f}"
        f"{_percent(row['spectrum_area_change_pct']):<10}{'yes' if row['within_spec'] else 'no':<8}{told}"
    )


def _percent(change: float | None) -> str:
    return "-" if change is None else f"{change:+.1f} %".replace("-", "−")
