"""`hil check`: checks of each axis before its first motion."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import table
from hil.cli import console
from hil.cli.console import ExitStatus
from hil.cli.options import AXES, BenchOption, BusOption, ForceOption, JsonOption, NewOutOption, YesOption

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench

CHECK_EPILOG = console.epilog_of_runs(
    {ExitStatus.DONE: "every check passed", ExitStatus.NOT_MET: "a check failed, or could not be made"}
)


@command(epilog=CHECK_EPILOG)
def check(
    bench_file: BenchOption,
    axis: Annotated[
        list[int] | None, typer.Option("--axis", help="Axis to check; repeatable; default: all.", autocompletion=AXES.one)
    ] = None,
    bus: BusOption = None,
    out: NewOutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    reset_faults: Annotated[bool, typer.Option("--reset-faults", help="Reset drives that are in fault first.")] = False,
    yes: YesOption = False,
) -> None:
    """Check each axis before its first motion.

    The checks cover encoder, brake, torque, stops, limits and sensor, with the smallest possible motions. Each ends in
    PASS, FAIL or NOT JUDGED, with the measurement. A check that depends on a failed one is not made.

    Example: hil check --bench bench.toml --axis 2
    """
    with console.exit_on_error():
        bench = console.bench_on(bench_file, bus)

        from hil.commissioning.check import check_axes, known_axes

        numbers = known_axes(bench, axis or ())
        where = console.result_directory(out, "check", force=force)
        console.confirm_motion(bench, _lines(bench, numbers), yes=yes)
        outcome = check_axes(bench, numbers, where, reset_faults=reset_faults, reporter=console.SpokenReporter())
        if as_json:
            typer.echo(outcome.result.dumps())
        else:
            rows = [(str(each.axis), each.name, each.verdict, each.seen) for each in outcome.result.checks]
            table("", ("axis", "check", "verdict", "seen"), rows)
        console.say(f"result: {where / 'check.json'}")
        console.say_not_restored(outcome.not_restored)
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.not_restored:
            raise typer.Exit(ExitStatus.SDO)
        if outcome.result.failed or outcome.result.not_made:
            raise typer.Exit(ExitStatus.NOT_MET)


def _lines(bench: "Bench", axes: tuple[int, ...]) -> Iterator[str]:
    """Lines on what moves, for `confirm`."""
    from hil.commissioning.held import CHECK_FOLLOWING_REV, ROOM_REV
    from hil.commissioning.limits import ASKED_REV
    from hil.experiments.plant.probe import PROBE_RPS

    yield f"This enables each axis on {bench.bus.address}, waits for its automatic stop, and turns it:"
    for number in axes:
        limits, ratio = bench.axis[number].limits, bench.axis[number].reduction_ratio
        yield (
            f"  axis {number}: a third of a motor turn at {PROBE_RPS:g} rev/s, then {ASKED_REV:g} rev to either side "
            f"({360.0 * ASKED_REV / ratio:.2f}° of the joint), at most {limits.torque_nm:g} N·m. It stops at "
            f"{min(CHECK_FOLLOWING_REV, limits.following_error_rev):g} rev from its set-point, or {ROOM_REV:g} rev from its start"
        )
