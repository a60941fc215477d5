"""`hil scope`: a live page of a bus, or of recordings."""

import contextlib
import importlib.util
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.address import BUS_VARIABLE, choose_bus, parse_address
from drive_profiles.cli.application import command
from drive_profiles.cli.console import epilog, fail, listed
from hil.cli.console import ExitStatus, exit_on_error, say
from hil.cli.live import DEFAULT_PORT
from hil.cli.options import BusOption, DescriptionsOption, OptionalBenchOption
from hil.errors import NotPossibleError

if TYPE_CHECKING:
    from collections.abc import Callable

    from hil.scope.server import ScopeServer

SCOPE_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.BUS, ExitStatus.NODE, ExitStatus.SDO),
    {ExitStatus.DONE: "ended by Ctrl-C, or by --until-stdin-closes"},
)


@command(epilog=SCOPE_EPILOG)
def scope(
    directory: Annotated[
        Path | None,
        typer.Argument(metavar="[DIR]", exists=True, file_okay=False, help="Directory of a run to show; default: the bus."),
    ] = None,
    bus: BusOption = None,
    bench_file: OptionalBenchOption = None,
    description: DescriptionsOption = None,
    ask: Annotated[
        str,
        typer.Option(
            metavar="NODE[,NODE]", help="Read mapping and scales of these nodes by SDO; without --ask the command sends nothing."
        ),
    ] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on loopback; 0 takes a free one.")] = DEFAULT_PORT,
    until_stdin_closes: Annotated[
        bool, typer.Option("--until-stdin-closes", help="End when standard input closes; for programs that start the scope.")
    ] = False,
) -> None:
    """Show a bus, or a run's recordings, live in a browser.

    The browser runs on this machine. On the bus, the command only listens, unless you give --ask.

    Examples:
      hil scope --bus local:/tmp/robot.sock --bench reference
      hil scope demo
    """
    with exit_on_error(moves=False), contextlib.suppress(KeyboardInterrupt):
        if any(importlib.util.find_spec(name) is None for name in ("bokeh", "tornado")):
            raise NotPossibleError("the page needs bokeh, which is not installed: pip install 'hil-bench[live]'")
        if directory is not None:
            if bus is not None or description or ask:
                raise fail("--bus, --description and --ask are for a bus; leave them out for a directory", ExitStatus.USAGE)
            _show_recordings(directory, port, until_stdin_closes=until_stdin_closes)
            return
        _show_bus(bench_file, bus, description or [], ask, port, until_stdin_closes=until_stdin_closes)


def _show_recordings(directory: Path, port: int, *, until_stdin_closes: bool) -> None:
    from hil.scope.server import ScopeServer
    from hil.scope.sources import RecordedSource, recordings_in

    paths = recordings_in(directory)
    sources: dict[str, RecordedSource] = {}

    def choose(name: str) -> RecordedSource | None:
        wanted = name or next(iter(paths))
        if wanted not in paths:
            return None
        if wanted not in sources:
            sources[wanted] = RecordedSource(paths[wanted])
        return sources[wanted]

    choose("")  # a file that is not a recording is said now

    _run(lambda: ScopeServer(choose, tuple(paths), port), until_stdin_closes=until_stdin_closes)


def _show_bus(
    bench_file: str | None, bus: str | None, descriptions: list[str], ask: str, port: int, *, until_stdin_closes: bool
) -> None:
    """Listen to a bus, and show it."""
    from hil.bench.bench import load_bench
    from hil.can.listening import open_listener
    from hil.cli.heard.explain import description_from
    from hil.scope.asking import ask_nodes
    from hil.scope.decoder import SignalDecoder
    from hil.scope.server import ScopeServer
    from hil.scope.sources import BusSource

    bench = None if bench_file is None else load_bench(bench_file)
    choice = choose_bus(bus, None if bench is None else (f"bench file {bench_file}", bench.bus.address))
    if choice is None:
        raise fail(f"no bus is given; give --bus ADDRESS or --bench FILE, or set {BUS_VARIABLE}", ExitStatus.USAGE)
    say(str(choice))
    asked = listed("--ask", ask, "node-ID") if ask else ()
    known = dict(description_from(text) for text in descriptions)
    address = parse_address(choice.address)
    listener = open_listener(address)
    try:
        decoder = SignalDecoder(bench, known, listener.address.bitrate)
        title = str(listener.address) if bench is None else f"{bench.name} on {listener.address}"
        source = BusSource(listener, decoder, title)
        if asked:
            ask_nodes(address, asked)
        _run(lambda: ScopeServer(lambda name: None if name else source, (), port), until_stdin_closes=until_stdin_closes)
    finally:
        listener.close()
    if source.lost:
        say(f"{source.lost} messages of the bus came too fast, and are not shown")


def _run(made: "Callable[[], ScopeServer]", *, until_stdin_closes: bool) -> None:
    """Serve a page in the event loop until the end."""
    import asyncio

    async def served() -> None:
        await _serve(made(), until_stdin_closes=until_stdin_closes)

    asyncio.run(served())


async def _serve(server: "ScopeServer", *, until_stdin_closes: bool) -> None:
    """Print the page's address; serve until Ctrl-C or standard input's end."""
    import asyncio

    over = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, over.set)
    if until_stdin_closes:
        loop.add_reader(sys.stdin.fileno(), lambda: None if os.read(sys.stdin.fileno(), 4096) else over.set())
    typer.echo(server.url)
    sys.stdout.flush()
    await over.wait()
    if until_stdin_closes:
        loop.remove_reader(sys.stdin.fileno())
    await server.close()
