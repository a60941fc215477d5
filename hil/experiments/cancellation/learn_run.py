"""Run of `hil learn`: adaptive cancellation of some axes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from hil.bench.bench import Bench
from hil.bench.model import Identified, identified_axis, load_identified, update_file
from hil.can.channel import Channel
from hil.design.inverse import Actuation
from hil.experiments.ate.motion import Ramps
from hil.experiments.ate.ramp import ACCELERATION_RPS_S
from hil.experiments.bus_demand import BusDemand
from hil.experiments.cancellation.learning import PASSES, AxisLearning, learn, learning_ramp
from hil.experiments.judge import check_axis_shown
from hil.experiments.measurement import Measurement, MeasurementOutcome
from hil.experiments.motor_inertia import given_inertia
from hil.master.motion import RunResult
from hil.reporter import SILENT, Reporter
from hil.results.learning import LearningResult, LearningRun
from hil.robot_tables import ORDERS


@dataclass(frozen=True)
class LearnRequest:
    """Request of adaptive cancellation.

    Attributes:
        axes: Axis numbers, learnt one after the other.
        actuation: `reference` for the set-point alone, `torque` with a torque offset.
        note: Load, temperature: goes into the model file beside the date.
        motor_inertias_kg_m2: J_m from data sheets by axis, where no plant is known.
    """

    axes: tuple[int, ...]
    passes: int = PASSES
    acceleration_rps_s: float = ACCELERATION_RPS_S
    actuation: Actuation = "reference"
    note: str = ""
    motor_inertias_kg_m2: Mapping[int, float] = field(default_factory=dict)
    orders: tuple[float, ...] = ORDERS

    def bus_demand(self, bench: Bench, axis: int) -> BusDemand:
        """Demand of an axis' passes on the bus."""
        title = f"learning, axis {axis}"
        return BusDemand(title, (axis,), bench.bus.sync_period_s, with_torque_offset=self.actuation == "torque")


@dataclass(frozen=True)
class LearningOutcome(MeasurementOutcome[LearningResult]):
    """End of learning.

    Attributes:
        learnt: Learning of each axis that is in the model file, by axis number.
    """

    learnt: dict[int, AxisLearning]


def learn_on_bus(
    bench: Bench,
    request: LearnRequest,
    out: Path,
    model: Path,
    *,
    plant: Path | None = None,
    channel: Channel | None = None,
    overload: bool = False,
    reporter: Reporter = SILENT,
) -> LearningOutcome:
    """Learn axis by axis.

    The estimate of each axis is written to the model file before the next axis begins.

    Args:
        out: Directory for recordings, bus log and result.json; made where it is missing.
        model: The model file; if it exists, it is read for the motors' inertia and the known orders; it is written.
        plant: Model file with the plants of the axes, which are taken over into the model file; None: it has them, or the bench.
            Of a transmission error in it, those orders are kept that the passes do not better.

    Raises:
        HilError: Nothing has moved yet: nodes, limits or files do not allow it.
        ChannelError: The bus cannot be opened, or was lost before anything was recorded.
    """
    identified = known_model(bench, model, plant)
    demands = _demands(bench, request, identified)
    learnt: dict[int, AxisLearning] = {}
    with (
        Measurement(
            bench, out, lambda described: LearningResult(bench=described, model=str(model)), channel=channel, reporter=reporter
        ) as measurement,
        measurement.session(demands, overload=overload) as session,
    ):
        today = measurement.started.date()
        for axis in request.axes:
            learnt[axis] = learn(
                session, axis, identified, passes=request.passes, acceleration_rps_s=request.acceleration_rps_s,
                actuation=request.actuation, motor_inertia_kg_m2=request.motor_inertias_kg_m2.get(axis), orders=request.orders,
                keep=partial(_enter, measurement, axis), reporter=reporter,
            )  # fmt: skip
            learnt[axis].emulated = measurement.result.emulated
            measurement.result.learnt.append(learnt[axis].entry(request.note, today))
            taken_over = identified_axis(identified, axis).plant
            if plant is not None and taken_over is not None:
                update_file(model, bench.name, axis, taken_over)
            identified = _with_plants(learnt[axis].store(model, bench.name, request.note, today), identified)
    return LearningOutcome(measurement.result, measurement.failure, learnt)


def _demands(bench: Bench, request: LearnRequest, identified: Identified | None) -> list[BusDemand]:
    axes = [axis for axis in request.axes if axis in bench.axis]  # another one is refused when it is its turn
    for axis in axes:
        bench.axis[axis].gains(f"learning on axis {axis}")
        given_inertia(bench, identified, axis, request.motor_inertias_kg_m2.get(axis))
        learning_ramp(bench, identified, axis, request.acceleration_rps_s)
        check_axis_shown(f"learning on axis {axis}", bench, axis, identified)
    return [request.bus_demand(bench, axis) for axis in axes]


def known_model(bench: Bench, model: Path, plant: Path | None) -> Identified | None:
    """Load the model file, with the plants of another file.

    Raises:
        FileError: A file is not a model file.
        NotPossibleError: A file is another robot's.
    """
    identified = load_identified(model) if model.exists() else None
    plants = None if plant is None else load_identified(plant)
    for path, file in ((model, identified), (plant, plants)):
        if file is not None:
            file.check_robot(bench.name, str(path))
    if plants is None:
        return identified
    return _with_plants(identified or Identified(robot=bench.name), plants)


def _with_plants(identified: Identified, plants: Identified | None) -> Identified:
    """Add the plants of another file, and transmission errors that are missing."""
    for number, known in ({} if plants is None else plants.axis).items():
        if known.plant is not None:
            identified = identified.with_part(number, known.plant)
        if known.ate is not None and identified_axis(identified, number).ate is None:
            identified = identified.with_part(number, known.ate)
    return identified


def _enter(measurement: Measurement[LearningResult], axis: int, number: int, result: RunResult, motion: Ramps) -> None:
    made, ramp = measurement.made(result, f"learn-axis{axis}-pass{number}"), motion.trajectory
    entry = LearningRun(
        axis=axis, number=number, acceleration_rps_s=ramp.acceleration_rps_s, end_rps=ramp.end_rps, **made
    )  # fmt: skip
    measurement.result.runs.append(entry)
