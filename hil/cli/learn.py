"""`hil learn`: adaptive cancellation, then frozen in a model file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail
from hil.cli import console, options
from hil.cli.console import ExitStatus
from hil.cli.live import LiveCommand, MotionOptions, shown_live

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.cancellation.learn_run import LearnRequest
    from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest
    from hil.experiments.measurement import MeasurementOutcome
    from hil.results.learning import LearningResult, MotionLearningResult

LEARN_EPILOG = console.epilog_of_runs({
    ExitStatus.DONE: "learnt",
    ExitStatus.FILE: "bad file, or limits that leave no room for a motion",
    ExitStatus.NOT_MET: "not learnt, or a cancellation did not help",
})  # fmt: skip

ProbeOption = Annotated[
    float | None,
    typer.Option(
        min=0.1, max=30.0, help="With --motion: amplitude of each order in a probing run; default: chosen by the vibration."
    ),
]
PaceOption = Annotated[
    float | None,
    typer.Option(min=0.5, max=2.0, help="With --motion line-motion: also at this multiple of its duration, for other orders."),
]


@command(cls=LiveCommand, epilog=LEARN_EPILOG)
def learn(
    bench_file: options.BenchOption,
    model: Annotated[Path, typer.Option("--model", help="Model file: read if it exists, for the motor's inertia, and written.")],
    given: MotionOptions,
    axis: Annotated[
        list[int] | None,
        typer.Option("--axis", help="Axis that moves; repeatable, one after the other.", autocompletion=options.AXES.one),
    ] = None,
    motion: Annotated[
        Literal["constant-acceleration", "line-motion"] | None,
        typer.Option(help="Learn on this motion of the bench file instead of ramps: all its axes at once, by probing runs."),
    ] = None,
    probe_arcsec: ProbeOption = None,
    pace: PaceOption = None,
    plant: Annotated[
        Path | None,
        typer.Option(
            "--plant", help="Model file of hil identify: keeps its plants and any order that learning does not improve."
        ),
    ] = None,
    motor_inertia_kg_m2: Annotated[
        list[str] | None,
        typer.Option(
            "--motor-inertia-kg-m2",
            metavar="[AXIS=]VALUE",
            help="J_m of the motor's data sheet, if no file has a plant; repeatable for several axes: 2=2.6e-4.",
        ),
    ] = None,
    bus: options.BusOption = None,
    passes: Annotated[
        int,
        typer.Option(
            min=2, max=50, help="Largest number of passes, each forwards and back; the first runs without cancellation."
        ),
    ] = 5,
    acceleration_rps_s: Annotated[float, typer.Option(min=0.1, max=100.0, help="Acceleration of every ramp.")] = 4.0,
    orders: options.OrdersOption = "1,2,4",
    note: Annotated[str, typer.Option(help="Conditions such as load and temperature, for the model file.")] = "",
) -> None:
    """Learn a cancellation of the transmission error, pass by pass.

    An axis moves forwards and back, and each pass cancels more of the error. With --motion, all axes learn at once on a
    motion of the bench file. The model file gets the result; hil run --treatment cancellation-learnt --learnt takes it.

    Example: hil learn --bench bench.toml --axis 2 --axis 3 --plant model.toml --model learnt.toml --note "22 °C, no load"
    """
    with console.exit_on_error():
        _check(axes := tuple(dict.fromkeys(axis or ())), motion, pace)
        bench = console.bench_on(bench_file, bus)

        from hil.bench.model import Identified

        Identified.check_file(model, bench.name)
        name = f"axis{'-'.join(map(str, axes))}" if motion is None else motion
        where = console.result_directory(given.out, f"learn-{name}", force=given.force)
        inertias, ks = options.inertias_from(motor_inertia_kg_m2 or [], axes), options.orders_from(orders)
        outcome: MeasurementOutcome[Any]
        reporter = console.SpokenReporter()
        with shown_live(given.live, bench.bus.address, bench_file):
            if motion is None:
                from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus

                ramps = LearnRequest(axes, passes, acceleration_rps_s, note=note, motor_inertias_kg_m2=inertias, orders=ks)
                console.confirm_motion(bench, _motion_lines(bench, ramps), yes=given.yes)
                outcome = learn_on_bus(bench, ramps, where, model, plant=plant, overload=given.overload, reporter=reporter)
            else:
                from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest, learn_motion_on_bus

                probes = MotionLearnRequest(motion, axes[0] if axes else None, ks, probe_arcsec, note, inertias, pace)
                console.confirm_motion(bench, _probing_lines(bench, probes), yes=given.yes)
                outcome = learn_motion_on_bus(
                    bench, probes, where, model, plant=plant, overload=given.overload, reporter=reporter
                )
            written = model if outcome.result.learnt else None
            console.tell_measurement(outcome, where, lambda: _summary(outcome.result), written, as_json=given.as_json)


def _summary(result: "LearningResult | MotionLearningResult") -> None:
    """Print verdict and tables of the result's page."""
    from hil.report.pages import learn as ramps
    from hil.report.pages import learn_motion as probing
    from hil.results.learning import LearningResult

    if isinstance(result, LearningResult):
        console.show_page(ramps.verdict(result), ramps.estimates(result), ramps.passes(result))
    else:
        console.show_page(probing.verdict(result), probing.parts(result), probing.runs(result))


def _check(axes: tuple[int, ...], motion: str | None, pace: float | None) -> None:
    """Refuse axes and a pace that do not go with the motion.

    Raises:
        typer.Exit: They do not.
    """
    if motion is None and not axes:
        raise fail("no axis is given; give --axis for its ramps, or --motion for a motion of the bench file", ExitStatus.USAGE)
    if motion == "line-motion" and axes:
        raise fail("a line-motion takes no --axis", ExitStatus.USAGE)
    if motion == "constant-acceleration" and len(axes) != 1:
        raise fail("a constant-acceleration run needs one --axis", ExitStatus.USAGE)
    if pace is not None and motion != "line-motion":
        raise fail("--pace is for --motion line-motion; a ramp passes all speeds anyway", ExitStatus.USAGE)
    if pace == 1.0:
        raise fail("--pace 1 is the line's own pace; give another one, such as 0.75, for other orders", ExitStatus.USAGE)


def _motion_lines(bench: "Bench", request: "LearnRequest") -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    for axis in request.axes:
        if axis not in bench.axis:
            continue
        limits = bench.axis[axis].limits
        yield (
            f"This moves axis {axis} on {bench.bus.address}: at most {request.passes} times back and forth at "
            f"{request.acceleration_rps_s:g} rev/s², anywhere within {limits.position_min_rev:g} … "
            f"{limits.position_max_rev:g} motor revolutions; at most {limits.speed_rps:g} rev/s and {limits.torque_nm:g} N·m."
        )


def _probing_lines(bench: "Bench", request: "MotionLearnRequest") -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    from hil.experiments.plan import Experiment

    yield from console.motion_lines([(bench, Experiment(request.motion, request.axis, "none"))])
    probe = "3 to 15" if request.probe_arcsec is None else f"{request.probe_arcsec:g}"
    yield f"about forty times, with a cancellation of {probe}″ in each order of every axis"
    if request.pace is not None:
        yield f"and about thirty times at {request.pace:g} times the duration of the line"
