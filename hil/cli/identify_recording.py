"""`hil identify ate --recording`: a transmission error from existing recordings."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.console import ExitStatus, result_directory, say, show_page, tell_result
from hil.cli.live import MotionOptions
from hil.cli.options import orders_from

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.results.recorded_ate import RecordedAteResult


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Options on recordings."""

    column: Annotated[
        list[str] | None,
        typer.Option(
            "--column",
            metavar="ROLE=NAME[,UNIT]",
            help="Column of a recording; roles: time, motor, load, acceleration, torque; e.g. motor=enc_2,2^20/rev; repeatable.",
        ),
    ] = None
    layout: Annotated[Path | None, typer.Option("--layout", help="Columns, units and ratio of recordings (TOML).")] = None
    ratio: Annotated[
        float | None,
        typer.Option("--ratio", help="Reduction ratio of the recorded axis; not needed if both encoders are recorded."),
    ] = None
    robot: Annotated[str | None, typer.Option("--robot", help="Name of a recorded robot, for its model file.")] = None
    description: Annotated[
        Path | None,
        typer.Option("--description", help="EDS, DCF, XDD or DBC file that decodes a recording of frames (candump, BLF)."),
    ] = None
    node: Annotated[int | None, typer.Option("--node", help="Node-ID of the drive in a recording of frames.", min=1, max=127)] = (
        None
    )

    def refuse_without_recording(self) -> None:
        """Refuse options that need a recording.

        Raises:
            typer.BadParameter: One was given.
        """
        for name, value in vars(self).items():
            if value:
                raise typer.BadParameter("it needs --recording; give both, or leave it out", param_hint=f"--{name}")


def from_recordings(
    files: list[Path],
    words: RecordingOptions,
    axis: int,
    orders: str,
    bench_file: str | None,
    model: Path | None,
    given: MotionOptions,
    *,
    sensorless: bool,
) -> None:
    """Identify from recordings; write the model file and the report.

    Print the result. The bench file has lever and plant of a sensor.

    Raises:
        typer.Exit: Nothing was identified.
    """
    from hil.bench.bench import load_bench
    from hil.bench.model import load_identified, update_file
    from hil.experiments.ate.recorded.identify import identify_recorded
    from hil.experiments.ate.recorded.request import RecordedRequest
    from hil.recordings.layout import load_layout, said_with

    try:
        file = None if words.layout is None else load_layout(words.layout, axis)
        said = said_with(words.column or [], words.ratio, words.robot, file)
        said = dataclasses.replace(said, description=words.description, node_id=words.node)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--column") from None
    request = RecordedRequest(tuple(files), axis, said, orders_from(orders), sensorless)
    bench = None if bench_file is None else load_bench(bench_file)
    identified = load_identified(model) if model is not None and model.exists() else None
    where = result_directory(given.out, f"identify-ate-axis{axis}", force=given.force)
    result = identify_recorded(request, where, bench, identified)
    file_of_model = model or where / "model.toml"
    if result.ate is not None and result.is_identified:
        update_file(file_of_model, result.robot, axis, result.ate)
    written = file_of_model if result.is_identified else None
    tell_result(result, where, lambda: _summary(result), written, as_json=given.as_json)
    if not result.is_identified:
        say("no order exceeds its noise: no model file is written")
        raise typer.Exit(ExitStatus.NOT_MET)


def _summary(result: "RecordedAteResult") -> None:
    """Print verdict, tables and sources of the result's page."""
    from hil.report.pages import recorded_ate as page

    show_page(page.verdict(result), page.orders(result), page.stretches(result), provenance=page.provenance(result))
