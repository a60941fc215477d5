"""hil move: one axis, slowly, to a position."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail
from hil.cli import console
from hil.cli.console import ExitStatus
from hil.cli.options import BenchOption, BusOption, ForceOption, LoopOption, MovedAxisOption, YesOption


@command(epilog=console.epilog_of_runs(is_judged=False))
def move(
    bench_file: BenchOption,
    axis: MovedAxisOption,
    to_rev: Annotated[float | None, typer.Option("--to", metavar="REV", help="Motor position, in revolutions.")] = None,
    by_rev: Annotated[
        float | None, typer.Option("--by", metavar="REV", help="Distance from the present position, in revolutions.")
    ] = None,
    back: Annotated[bool, typer.Option("--back", help="To the position before the last motion of this axis.")] = False,
    loop: LoopOption = "drive",
    bus: BusOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Directory for the log of all frames; default: a new one in bench-out.")
    ] = None,
    force: ForceOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the position of the axis as JSON.")] = False,
    yes: YesOption = False,
) -> None:
    """Move one axis slowly to a position.

    It also works after a stop or a fault, and resets the fault. The speed is `approach_rps` or a quarter of the axis' speed
    limit, whichever is lower. Ctrl-C stops the axis as in a run. `--back` reads the position from the newest log of a motion,
    in `bench-out` or in another folder here. That position is right only if the drive has kept its zero.

    Examples:
        hil move --axis 2 --to 0 --bench bench.toml

        hil move --axis 2 --by -0.5 --bench bench.toml

        hil move --axis 2 --back --bench bench.toml
    """
    if [to_rev is not None, by_rev is not None, back].count(True) != 1:
        raise fail("give one of --to and --by, in motor revolutions, or --back", ExitStatus.USAGE)
    with console.exit_on_error():
        bench = console.bench_on(bench_file, bus)

        from hil.experiments.move import MoveRequest, make_move, plan_move
        from hil.experiments.position_before import position_before
        from hil.master.whereabouts import rev_text
        from hil.results.base import LOG_FILE

        where = console.result_directory(out, f"move-axis{axis}", force=force)
        request = MoveRequest(axis, to_rev, by_rev, loop)
        request.check(bench)
        planned = plan_move(bench, replace(request, before=position_before(bench, axis)) if back else request)
        stands_rev: float | None = planned.from_rev
        if not planned.is_there:
            for line in planned.sentences:
                console.say(line)
            console.confirm_motion(bench, (), yes=yes)
            with console.RunProgress(1) as progress:
                progress.run(f"axis {axis}")
                outcome = make_move(planned, where / LOG_FILE, reporter=progress)
            console.say_not_restored(outcome.not_restored)
            if outcome.stopped is not None:
                raise outcome.stopped
            stands_rev = outcome.stands_rev
        if as_json:
            typer.echo(json.dumps({"axis": axis, "from_rev": planned.from_rev, "stands_at_rev": stands_rev}))
        else:
            typer.echo(f"axis {axis} is at {'an unknown position' if stands_rev is None else f'{rev_text(stands_rev)} rev'}")
        if not planned.is_there and outcome.not_restored:
            raise typer.Exit(ExitStatus.SDO)
