"""`hil learn --motion`: cancellation for a motion's axes, learnt on that motion."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hil.cli.console import SpokenReporter, confirm_motion, motion_lines, tell_measurement

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest


def learn_motion(
    bench: "Bench",
    request: "MotionLearnRequest",
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
        request: The motion and its probes.
        where: Directory of the files.
        model: The model file.
        plant: Model file with the plants; None without one.
        overload: Run even if the frames do not fit on the bus.
        yes: Move a real robot without asking.
        as_json: Print result.json instead of text.
    """
    from hil.experiments.cancellation.probing.on_bus import learn_motion_on_bus, motion_summary  # noqa: PLC0415

    confirm_motion(bench, _lines(bench, request), yes=yes)
    outcome = learn_motion_on_bus(bench, request, where, model, plant=plant, overload=overload, reporter=SpokenReporter())

    def tell() -> None:
        for line in motion_summary(outcome):
            typer.echo(line)

    tell_measurement(outcome, where, tell, model if outcome.result.learnt else None, as_json=as_json)


def _lines(bench: "Bench", request: "MotionLearnRequest") -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    from hil.experiments.plan import Experiment  # noqa: PLC0415

    yield from motion_lines([(bench, Experiment(request.motion, request.axis, "none"))])
    probe = "3 to 15" if request.probe_arcsec is None else f"{request.probe_arcsec:g}"
    yield f"about forty times, with a cancellation of {probe}″ in each order of every axis"
    if request.pace is not None:
        yield f"and about thirty times at {request.pace:g} times the duration of the line"
