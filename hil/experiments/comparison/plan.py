"""Plan of a comparison of treatments over experiments."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from drive_profiles.address import parse_address
from hil.arm.straight_line import LineError
from hil.bench.bench import Bench
from hil.bench.design import Designs
from hil.bench.model import Identified, with_identified
from hil.can.channel import Channel
from hil.can.opening import open_channel
from hil.control.trajectory import UnreachableError
from hil.control.treatments import TreatmentName, treatment
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.bus_demand import check_load
from hil.experiments.cancellation.cancellation import cancellation_of
from hil.experiments.cancellation.follow import following_of
from hil.experiments.cancellation.inside import inside_models
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT
from hil.experiments.plan import Experiment
from hil.experiments.runner import check_band
from hil.experiments.shaping import check_stop, shaped_motion
from hil.experiments.treatment import HOST_CLOSED, TREATMENTS, Knowledge, TreatmentSetup, arm_remark, treatment_setup
from hil.master.request import check_host_loop


@dataclass(frozen=True)
class ComparisonRequest:
    """Request of a comparison.

    Attributes:
        axes: Axes of constant-acceleration runs; empty for those with a filter or a model.
        treatments: Treatments in their order; `none` is always run, as all others are compared with it.
        named: Treatments that the user has named: only of these it is an error when they are not possible.
    """

    experiments: tuple[str, ...] = (CONSTANT_ACCELERATION, LINE_MOTION)
    axes: tuple[int, ...] = ()
    treatments: tuple[TreatmentName, ...] = TREATMENTS
    named: frozenset[str] = frozenset()

    def wanted(self, bench: Bench) -> list[Experiment]:
        """List every run, drive-closed ones first.

        Host-closed runs may be refused at the last moment.

        Shapers are for stops, and a cancellation that follows is for errors that drift: elsewhere they have to be named.
        """
        axes = self.axes or tuple(number for number, table in sorted(bench.axis.items()) if table.notch or table.model)
        motions: list[tuple[str, int | None]] = []
        if CONSTANT_ACCELERATION in self.experiments:
            motions += [(CONSTANT_ACCELERATION, axis) for axis in axes]
        if LINE_MOTION in self.experiments:
            motions.append((LINE_MOTION, None))
        inside: list[TreatmentName] = ["none", *(name for name in self.treatments if name not in HOST_CLOSED and name != "none")]
        outside: list[TreatmentName] = [name for name in self.treatments if name in HOST_CLOSED]
        inside = [name for name in inside if name in self.named or not (treatment(name).shaper or treatment(name).follows)]
        experiments = [Experiment(name, axis, each) for name, axis in motions for each in inside]
        if POINT_TO_POINT in self.experiments:
            experiments += [Experiment(POINT_TO_POINT, axis, each) for axis in axes for each in self._of_stops()]
        if outside:
            experiments += [
                Experiment(name, axis, treatment, "host") for name, axis in motions for treatment in ("none", *outside)
            ]
        return experiments

    def _of_stops(self) -> list[TreatmentName]:
        """Treatments of a point-to-point move.

        These are the shapers alone, and all that the user has named, so that the reason against them is reported.
        """
        wanted = [name for name in self.treatments if name in self.named or treatment(name).is_shaper]
        return ["none", *(name for name in wanted if name != "none")]


@dataclass(frozen=True)
class KnownRobot:
    """Robot of a comparison, and the knowledge of it."""

    bench: Bench
    knowledge: Knowledge = field(default_factory=Knowledge)
    source: str = ""


@dataclass(frozen=True)
class LeftOut:
    """Run that is left out, with the reason."""

    experiment: Experiment
    reason: str


@dataclass(frozen=True)
class ComparisonPlan:
    """Runs of a comparison on one robot.

    Attributes:
        robot: The robot, with the identified model in its bench file.
        remarks: Sentences on treatments that were named, and are made all the same.
    """

    robot: KnownRobot
    setups: Mapping[Experiment, TreatmentSetup]
    left_out: tuple[LeftOut, ...]
    remarks: tuple[str, ...] = ()

    @property
    def experiments(self) -> list[Experiment]:
        """Runs in their order."""
        return list(self.setups)


def plan(
    robot: KnownRobot, request: ComparisonRequest, *, channel: Channel | None = None, overload: bool = False
) -> ComparisonPlan:
    """Sort the requested runs into possible and left-out ones.

    Nothing is sent.

    Args:
        channel: Bus of the robot, for its bit rate; opened and closed unless it is given.
        overload: Run even what does not fit on the bus.

    Raises:
        NotPossibleError: Nothing is left but runs without any treatment; or the model file is another robot's.
        ChannelError: The bus cannot be opened.
    """
    bench, identified = robot.bench, robot.knowledge.identified
    if identified is not None:
        identified.check_robot(bench.name)
        robot = replace(robot, bench=with_identified(bench, identified))
    bus = open_channel(parse_address(bench.bus.address)) if channel is None else channel
    setups: dict[Experiment, TreatmentSetup] = {}
    left_out: list[LeftOut] = []
    try:
        for experiment in request.wanted(robot.bench):
            remark = arm_remark(robot.bench, experiment.treatment)
            if remark is not None and experiment.treatment not in request.named:
                left_out.append(LeftOut(experiment, f"{remark}; name it with --treatment to run it"))
                continue
            try:
                setups[experiment] = _setup(robot, experiment, None if overload else bus)
            except (NotPossibleError, UnsafeRequestError, UnreachableError, LineError) as error:
                if (experiment.treatment, experiment.loop) != ("none", "host"):  # it is run for the comparison only
                    left_out.append(LeftOut(experiment, str(error)))
    finally:
        if channel is None:
            bus.close()
    needed = {_conditions(each) for each in setups if each.treatment != "none"}
    compared = {each: setup for each, setup in setups.items() if _conditions(each) in needed}
    if not compared:
        reasons = "; ".join(dict.fromkeys(each.reason for each in left_out))
        raise NotPossibleError(f"{bench.name}: there is nothing to compare" + (f": {reasons}" if reasons else ""))
    remarks = dict.fromkeys(arm_remark(robot.bench, each.treatment) for each in compared)
    return ComparisonPlan(robot, compared, tuple(left_out), tuple(remark for remark in remarks if remark is not None))


def _conditions(experiment: Experiment) -> tuple[str, int | None, str]:
    """Conditions in which runs that are compared with each other agree."""
    return experiment.name, experiment.axis, experiment.loop


def _setup(robot: KnownRobot, experiment: Experiment, channel: Channel | None) -> TreatmentSetup:
    """Set-up of a run.

    Raises:
        NotPossibleError: Something is missing for it, or the bus does not carry it.
        UnsafeRequestError: It would leave a limit.
        UnreachableError: The line leaves the reach of the geometry's chain.
        LineError: The arm cannot follow the line.
    """
    bench, name = robot.bench, experiment.treatment
    check_stop(experiment.is_stop, name, experiment.loop)
    motion = experiment.motion(bench)
    check_band(bench, experiment, motion)
    motion, _ = shaped_motion(bench, name, motion, robot.knowledge.identified)
    setup = treatment_setup(bench, name, robot.knowledge, motion.period_s, experiment.loop)
    where = "none of its axes" if experiment.axis is None else f"axis {experiment.axis}"
    if setup.filters == "notch" and not any(setup.bench.axis[number].notch for number in motion.axes):
        raise NotPossibleError(f"{name}: the bench file has no notch for {where}")
    designs = robot.knowledge.designs
    if treatment(name).needs == "design" and designs is not None and not set(designs.axis) & set(motion.axes):
        raise NotPossibleError(f"{name}: the design file has no filter for {where}")
    if name in HOST_CLOSED and not set(setup.fixed) & set(motion.axes):
        raise NotPossibleError(f"{name}: no notch and no model of {where}")
    if setup.is_cancelled:
        with_notch = setup.filters == "notch"
        made = cancellation_of(setup.bench, setup.cancel_with, motion, channel, with_notch=with_notch)
        made.check(setup.bench, motion)
        if setup.follows:
            following_of(setup.bench, setup.cancel_with, made, motion)
    if setup.is_inside:
        inside_models(setup.bench, setup.cancel_with, motion.axes)
    if experiment.loop == "host":
        for number in motion.axes:
            table = setup.bench.axis[number]
            check_host_loop(number, table, motion.period_s, with_notch=setup.filters == "notch", held=setup.fixed.get(number))
    if channel is not None:
        check_load(setup.bench, channel, experiment.bus_demand(motion))
    return setup


def knowledge_by_robot(
    identified: Sequence[Identified], designs: Sequence[Designs], learnt: Sequence[Identified], names: Sequence[str]
) -> dict[str, Knowledge]:
    """Model and design files sorted by the robot that they are of.

    Args:
        identified: Model files of `hil identify`.
        learnt: Model files of `hil learn`.

    Raises:
        NotPossibleError: A file belongs to none of the robots, or two files of a kind to the same.
    """
    _check_files((identified, designs, learnt), names)
    by_robot = {}
    for name in names:
        own = [next((file for file in files if file.robot == name), None) for files in (identified, learnt)]
        design = next((file for file in designs if file.robot == name), None)
        by_robot[name] = Knowledge(identified=own[0], designs=design, learnt=own[1])
    return by_robot


def _check_files(kinds: Iterable[Sequence[Identified | Designs]], names: Sequence[str]) -> None:
    for files in kinds:
        seen: set[str] = set()
        for file in files:
            if file.robot not in names:
                robots = ", ".join(map(repr, names))
                raise NotPossibleError(f"a model or design file is of {file.robot!r}; the robots compared are {robots}")
            if file.robot in seen:
                raise NotPossibleError(f"two files of the same kind are of {file.robot!r}; give only one of them")
            seen.add(file.robot)
