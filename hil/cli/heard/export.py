"""`hil export`: recordings and bus logs in other formats."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import epilog, progress
from hil.cli.console import ExitStatus, exit_on_error, say
from hil.cli.heard.explain import description_from
from hil.cli.options import DescriptionsOption, OptionalBenchOption

if TYPE_CHECKING:
    from hil.export.series import Series
    from hil.export.source import Known

EXPORT_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.NODE, ExitStatus.INTERRUPTED),
    {
        ExitStatus.FILE: "bad file, a missing package, or no data for the format",
        ExitStatus.NODE: "the log contradicts the bench file",
        ExitStatus.INTERRUPTED: "interrupted",
    },
)
FORMATS = (".dbc", ".mf4", ".mcap", ".parquet")


@command(epilog=EXPORT_EPILOG)
def export(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Directory of a run, one of its CSV files, or a log of a bus.")
    ],
    to: Annotated[
        list[Path] | None,
        typer.Option("--to", metavar="FILE", help="File to write, by its suffix: .dbc, .mf4, .mcap, .parquet; repeatable."),
    ] = None,
    run: Annotated[
        str | None, typer.Option("--run", metavar="NAME", help="Name of a recording in a directory of several.")
    ] = None,
    bench_file: OptionalBenchOption = None,
    description: DescriptionsOption = None,
    interface: Annotated[str | None, typer.Option(metavar="NAME", help="Interface to read if the log has several: can1.")] = None,
    plotjuggler: Annotated[
        str | None,
        typer.Option("--plotjuggler", metavar="HOST:PORT", help="Send the recording to PlotJuggler (UDP server, protocol JSON)."),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option("--plotjuggler-layout", metavar="FILE", help="Write a layout of PlotJuggler's plots.", dir_okay=False),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="Pace of the stream, in multiples of the recording's.")
    ] = 1.0,
) -> None:
    """Write a recording or bus log as DBC, MF4, MCAP or Parquet.

    The command can also send it to PlotJuggler.

    Example: hil export line --to line.mf4 --to line.dbc
    """
    files = to or []
    for file in files:
        if file.suffix.lower() not in FORMATS:
            raise typer.BadParameter(f"{file}: unknown suffix; expected one of {', '.join(FORMATS)}", param_hint="--to")
        if file.resolve() == source.resolve():
            raise typer.BadParameter(f"{file}: is the source itself; expected another file", param_hint="--to")
    if not files and plotjuggler is None and layout is None:
        raise typer.BadParameter("nothing to write; give --to FILE, --plotjuggler HOST:PORT or --plotjuggler-layout FILE")
    address = None if plotjuggler is None else _address(plotjuggler)
    with exit_on_error(moves=False):
        from hil.export.source import Known

        descriptions, bench = dict(description_from(text) for text in description or []), None
        if bench_file is not None:  # without one it is not loaded, nor scipy with it
            from hil.bench.bench import load_bench

            bench = load_bench(bench_file)
        known = Known(bench, descriptions, interface, run)
        series = _written(source, files, known, is_needed=address is not None or layout is not None)
        if layout is not None:
            from hil.export.plotjuggler import write_layout

            write_layout(layout, series)
            typer.echo(str(layout))
        if address is not None:
            from hil.export.plotjuggler import send

            with progress(f"sending to {plotjuggler}", sum(len(each.time_s) for each in series)) as advance:
                sent = send(series, *address, speed, advance)
            say(f"{sent} rows sent to {plotjuggler}")


def _written(source: Path, files: list[Path], known: "Known", *, is_needed: bool) -> list["Series"]:
    """Write the files; return the numbers that they contain."""
    from hil.export import tables
    from hil.export.source import mapping_of, series_in

    writers = {".mf4": tables.write_mf4, ".mcap": tables.write_mcap, ".parquet": tables.write_parquet}
    numbers = [file for file in files if file.suffix.lower() in writers]
    series, what = series_in(source, known) if numbers or is_needed else ([], None)
    if len(numbers) < len(files) and what is None:
        what = mapping_of(source, known)
    for note in () if what is None else what.notes:
        say(note)
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f"{file.stem}.part{file.suffix}")
        try:
            if file.suffix.lower() in writers:
                writers[file.suffix.lower()](part, series)
            elif what is not None:
                from hil.export.dbc import write_dbc

                write_dbc(part, what)
            part.replace(file)
        finally:
            with suppress(OSError):
                part.unlink()
        typer.echo(str(file))
    return series


def _address(text: str) -> tuple[str, int]:
    """Host and port.

    Raises:
        typer.BadParameter: It is none.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise typer.BadParameter(f"{text!r} is not HOST:PORT; expected e.g. 127.0.0.1:9870", param_hint="--plotjuggler")
    return host.strip("[]"), int(port)
