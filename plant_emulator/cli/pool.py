"""Options of the commands that run many trials: where they run, and in how many processes."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.console import fail, progress
from drive_profiles.processors import usable_processors
from plant_emulator.cli.console import EmulatorExitStatus, exit_on_value_error

if TYPE_CHECKING:
    from plant_emulator.trials.executors import Executors

JobsOption = Annotated[int | None, typer.Option("--jobs", min=1, max=256, help="Processes; default: one per processor.")]
OnOption = Annotated[
    str | None,
    typer.Option("--on", metavar="dask:tcp://HOST:PORT", help="Use the workers of a Dask scheduler; needs hil-bench[cluster]."),
]


def executors_of(on: str | None, jobs: int | None) -> "Executors":
    """Return the executors that the options choose.

    Raises:
        typer.Exit: Both options are given, or the address names no scheduler.
    """
    from plant_emulator.trials.executors import DaskWorkers, LocalProcesses, scheduler_address

    if on is None:
        return LocalProcesses(jobs or usable_processors())
    if jobs is not None:
        raise fail("--jobs cannot be combined with --on; the scheduler decides", EmulatorExitStatus.USAGE)
    with exit_on_value_error():
        return DaskWorkers(scheduler_address(on))


@contextmanager
def trials(name: str, total: int, executors: "Executors", rest: Callable[[], str] = lambda: "") -> Iterator[Callable[..., None]]:
    """Show the progress of trials; the loss or refusal of executors ends the command."""
    from plant_emulator.trials.executors import ExecutorsLostError, ExecutorsRefusedError

    begin = time.monotonic()
    try:
        with progress(name, total) as step:
            yield step
    except ExecutorsRefusedError as error:
        raise fail(str(error), EmulatorExitStatus.BUS) from None
    except ExecutorsLostError as error:
        raise fail("; ".join(filter(None, (str(error), rest()))), EmulatorExitStatus.BUS) from None
    typer.echo(f"{name}: {total} in {time.monotonic() - begin:.1f} s, by {executors.name}", err=True)
