"""hil learn: adaptive cancellation, pass by pass, then frozen in a model file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.console import (
    ExitStatus,
    SpokenReporter,
    bench_on,
    confirm,
    epilog_of_runs,
    exit_on_error,
    exit_with,
    is_on_local_bus,
    new_directory,
    say,
    say_not_restored,
    say_page,
    write_page,
)
from hil.cli.options import (
    AXES,
    BenchOption,
    BusOption,
    JsonOption,
    NewOutOption,
    OrdersOption,
    OverloadOption,
    YesOption,
    orders_from,
)

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.cancellation.learn_run import LearningOutcome, LearnRequest

LEARN_EPILOG = epilog_of_runs({
    ExitStatus.DONE: "learnt",
    ExitStatus.FILE: "bad file, or limits that leave no room",
    ExitStatus.NOT_MET: "not learnt, or a cancellation did not help",
})  # fmt: skip


def mount(app: typer.Typer) -> None:
    """Add the command to `hil`."""
    app.command(epilog=LEARN_EPILOG)(learn)


def learn(
    bench_file: BenchOption,
    axis: Annotated[
        list[int], typer.Option("--axis", help="The axis that is moved; several, one after the other.", autocompletion=AXES.one)
    ],
    model: Annotated[
        Path, typer.Option("--model", help="Model file: read where it is there, for the motor's inertia, and written.")
    ],
    plant: Annotated[
        Path | None, typer.Option("--plant", help="Model file of hil identify: its plants, and what no pass betters, are kept.")
    ] = None,
    motor_inertia_kg_m2: Annotated[
        float | None,
        typer.Option("--motor-inertia-kg-m2", min=1e-9, max=10.0, help="Of the motor's data sheet, where no file has a plant."),
    ] = None,
    bus: BusOption = None,
    passes: Annotated[int, typer.Option(min=2, max=50, help="To and fro; the first is without cancellation.")] = 5,
    acceleration_rps_s: Annotated[float, typer.Option(min=0.1, max=100.0, help="Of every ramp.")] = 4.0,
    orders: OrdersOption = "1,2,4",
    note: Annotated[str, typer.Option(help="Load, temperature: goes into the model file beside the date.")] = "",
    out: NewOutOption = None,
    overload: OverloadOption = False,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Learn what cancels the transmission error: an axis goes to and fro, and each pass cancels more of it.

    What is learnt is frozen in the model file, for hil run --treatment cancellation-learnt --learnt.

    Example: hil learn --bench bench.toml --axis 2 --axis 3 --plant model.toml --model learnt.toml --note "22 °C, no load"
    """
    with exit_on_error():
        bench = bench_on(bench_file, bus)

        from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus  # noqa: PLC0415

        request = LearnRequest(
            tuple(dict.fromkeys(axis)),
            passes,
            acceleration_rps_s,
            note=note,
            motor_inertia_kg_m2=motor_inertia_kg_m2,
            orders=orders_from(orders),
        )
        if not yes and not is_on_local_bus(bench):
            confirm(_motion_lines(bench, request))
        where = out or new_directory(f"learn-axis{'-'.join(map(str, request.axes))}")
        outcome = learn_on_bus(bench, request, where, model, plant=plant, overload=overload, reporter=SpokenReporter())
        _tell(outcome, where, model, as_json=as_json)


def _tell(outcome: "LearningOutcome", where: Path, model: Path, *, as_json: bool) -> None:
    """Write the report, print the result, and leave with the exit status of a failure."""
    from hil.experiments.cancellation.learn_run import summary  # noqa: PLC0415

    page = write_page(where)
    if as_json:
        typer.echo(outcome.result.dumps())
    else:
        for line in summary(outcome):
            typer.echo(line)
    if outcome.learnt:
        say(f"model file: {model}")
    say_page(page)
    say_not_restored(outcome.not_restored)
    if outcome.failure is not None:
        raise exit_with(outcome.failure)
    if outcome.not_restored:
        raise typer.Exit(ExitStatus.SDO)


def _motion_lines(bench: "Bench", request: "LearnRequest") -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    for axis in request.axes:
        if axis not in bench.axis:
            continue
        limits = bench.axis[axis].limits
        yield (
            f"This moves axis {axis} on {bench.bus.address}: {request.passes} times to and fro at {request.acceleration_rps_s:g} "
            f"rev/s², anywhere within {limits.position_min_rev:g} … {limits.position_max_rev:g} motor revolutions; at most "
            f"{limits.speed_rps:g} rev/s and {limits.torque_nm:g} N·m."
        )
