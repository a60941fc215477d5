"""`hil learn --motion`: cancellation for a motion's axes, learnt on that motion."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hil.cli.console import (
    ExitStatus,
    SpokenReporter,
    confirm_motion,
    exit_with,
    motion_lines,
    say,
    say_not_restored,
    say_page,
    write_page,
)

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench


@dataclass(frozen=True)
class MotionOptions:
    """Options of learning on a motion, as `MotionLearnRequest` has them."""

    motion: str
    axis: int | None
    orders: tuple[float, ...]
    probe_arcsec: float | None
    note: str
    motor_inertias_kg_m2: Mapping[int, float]
    pace: float | None = None


def learn_motion(
    bench: "Bench",
    options: MotionOptions,
    where: Path,
    model: Path,
    plant: Path | None,
    *,
    overload: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Learn on a motion, write the report, and print the result.

    Exit with the status of a failure.

    Args:
        bench: The bench file.
        options: The motion and its probes.
        where: Directory of the files.
        model: The model file.
        plant: Model file with the plants; None without one.
        overload: Run even if the frames do not fit on the bus.
        yes: Move a real robot without asking.
        as_json: Print result.json instead of text.
    """
    from hil.experiments.cancellation.probing.on_bus import (  # noqa: PLC0415
        MotionLearnRequest,
        learn_motion_on_bus,
        motion_summary,
    )

    request = MotionLearnRequest(**{name: getattr(options, name) for name in asdict(options)})
    confirm_motion(bench, _lines(bench, options), yes=yes)
    outcome = learn_motion_on_bus(bench, request, where, model, plant=plant, overload=overload, reporter=SpokenReporter())
    page = write_page(where)
    if as_json:
        typer.echo(outcome.result.dumps())
    else:
        for line in motion_summary(outcome):
            typer.echo(line)
    if outcome.result.learnt:
        say(f"model file: {model}")
    say_page(page)
    say_not_restored(outcome.not_restored)
    if outcome.failure is not None:
        raise exit_with(outcome.failure)
    if outcome.not_restored:
        raise typer.Exit(ExitStatus.SDO)


def _lines(bench: "Bench", options: MotionOptions) -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    from hil.experiments.plan import Experiment  # noqa: PLC0415

    yield from motion_lines([(bench, Experiment(options.motion, options.axis, "none"))])
    probe = "3 to 15" if options.probe_arcsec is None else f"{options.probe_arcsec:g}"
    yield f"about forty times, with a cancellation of {probe}″ in each order of every axis"
    if options.pace is not None:
        yield f"and about thirty times at {options.pace:g} times the duration of the line"
