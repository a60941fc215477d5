"""hil learn: adaptive cancellation, pass by pass, then frozen in a model file."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.experiments.learn_run import LearnRequest
    from hil.master.bench import Bench

EXIT_INTERNAL, EXIT_USAGE, EXIT_SDO, EXIT_INTERRUPTED = 1, 2, 6, 130
LEARN_EXIT_STATUS = (
    "Exit status: 0 learnt; 2 usage; 3 bad file, or limits that leave no room; 4 no bus; 5 no answer, wrong device, or already "
    "moving; 6 SDO abort; 8 safety stop; 9 not learnt, or a correction did not help; 130 interrupted, after a safe stop."
)


def learn(
    bench_file: Annotated[str, typer.Option("--bench", help="Bench file (TOML), or `reference`.")],
    axis: Annotated[list[int], typer.Option("--axis", help="The axis that is moved; several, one after the other.")],
    model: Annotated[
        Path, typer.Option("--model", help="Model file: read where it is there, for the motor's inertia, and written.")
    ],
    bus: Annotated[str | None, typer.Option("--bus", help="Bus address instead of the bench file's.")] = None,
    passes: Annotated[int, typer.Option(min=2, max=50, help="To and fro; the first is without correction.")] = 5,
    acceleration_rps_s: Annotated[float, typer.Option(min=0.1, max=100.0, help="Of every ramp.")] = 4.0,
    note: Annotated[str, typer.Option(help="Load, temperature: goes into the model file beside the date.")] = "",
    out: Annotated[Path | None, typer.Option("--out", help="Directory; left out: a new one in bench-out.")] = None,
    overload: Annotated[
        bool, typer.Option("--overload", help="Run even what does not fit on the bus at its bit rate (hil plan).")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print result.json on standard output, all else on standard error.")
    ] = False,
) -> None:
    """Learn what cancels the transmission error: an axis goes to and fro, and each pass corrects what the last has left.

    What is learnt is frozen in the model file, for hil run --compensation adaptive --learnt.

    Example: hil learn --bench bench.toml --axis 2 --axis 3 --model learnt.toml --note "22 °C, no load"
    """
    from hil.cli import exit_code_of  # noqa: PLC0415 - cli mounts this module
    from hil.experiments.learn_run import LearnRequest, learn_on_bus, summary  # noqa: PLC0415
    from hil.master.bench import load_bench  # noqa: PLC0415

    try:
        bench = load_bench(bench_file)
        if bus is not None:
            bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": bus})})
        request = LearnRequest(tuple(dict.fromkeys(axis)), passes, acceleration_rps_s, note=note)
        _confirm(bench, request, yes=yes)
        where = out or _new_directory(request)
        outcome = learn_on_bus(bench, request, where, model, overload=overload, announce=_say)
        if as_json:
            typer.echo(json.dumps(outcome.result, ensure_ascii=False))
        else:
            for line in summary(outcome):
                typer.echo(line)
        if outcome.learnt:
            _say(f"model file: {model}")
        for what in outcome.not_restored:
            _say(f"not put back as it was found: {what}")
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.not_restored:
            raise typer.Exit(EXIT_SDO)
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        _say("interrupted before anything moved")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except Exception as error:
        code = 3 if isinstance(error, OSError) else exit_code_of(error)
        if code == EXIT_INTERNAL:
            raise
        _say(str(error))
        raise typer.Exit(code) from None


def mount(app: typer.Typer) -> None:
    """Make it a command of `hil`."""
    app.command(epilog=LEARN_EXIT_STATUS)(learn)


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _new_directory(request: "LearnRequest") -> Path:
    """A directory of its own for every time."""
    import datetime  # noqa: PLC0415

    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    return Path("bench-out") / f"{stamp}-learn-axis{'-'.join(map(str, request.axes))}"


def _confirm(bench: "Bench", request: "LearnRequest", *, yes: bool) -> None:
    """A robot that is not emulated moves only when someone says so."""
    from drive_profiles.address import LOCAL, parse_address  # noqa: PLC0415

    if parse_address(bench.bus.address).interface == LOCAL or yes:
        return
    for axis in request.axes:
        if axis not in bench.axis:
            continue
        limits = bench.axis[axis].limits
        _say(
            f"This moves axis {axis} on {bench.bus.address}: {request.passes} times to and fro at {request.acceleration_rps_s:g} "
            f"rps/s, anywhere within {limits.position_min_rev:g} … {limits.position_max_rev:g} motor revolutions; at most "
            f"{limits.speed_rps:g} rps and {limits.torque_nm:g} N·m."
        )
    if not sys.stdin.isatty():
        _say("nobody can be asked here; --yes moves it without asking")
        raise typer.Exit(EXIT_USAGE)
    if not typer.confirm("Is everyone clear of the robot, and its emergency stop in reach?", err=True):
        raise typer.Exit(EXIT_USAGE)
