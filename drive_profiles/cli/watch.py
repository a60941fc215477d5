"""drive-profiles watch: objects of a drive as they change."""

import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_objects
from drive_profiles.cli.console import READ_EPILOG, ExitStatus, exit_on_error, fail
from drive_profiles.cli.entry import interrupted
from drive_profiles.cli.options import DriveOptions
from drive_profiles.cli.read import decoded, in_json
from drive_profiles.standard import shown

if TYPE_CHECKING:
    from drive_profiles.device.device import Device
    from drive_profiles.family.catalogue import CatalogueEntry

KEPT = 60
"""Values of each object that are drawn, and kept."""
_BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True, kw_only=True)
class WatchOptions(DriveOptions):
    """Options of a drive, with a document for each reading."""

    as_json: Annotated[bool, typer.Option("--json", help="One JSON document for each reading, on a line.")] = False


@command(epilog=READ_EPILOG)
def watch(
    objects: Annotated[list[str], typer.Argument(metavar="OBJECT", help="0x6064, or a name.", autocompletion=complete_objects)],
    drive: WatchOptions,
    *,
    every_s: Annotated[float, typer.Option("--every-s", min=0.01, max=3600.0, help="Time between two readings.")] = 0.2,
    count: Annotated[int | None, typer.Option("--count", min=1, help="Stop after this many readings.")] = None,
    for_s: Annotated[float | None, typer.Option("--for-s", min=0.01, help="Stop after this time.")] = None,
) -> None:
    """Read objects repeatedly until Ctrl-C.

    A terminal shows a value and a plot line for each object; other outputs get a line for each reading.

    Examples:
        drive-profiles watch 0x6064 0x6077 --bus socketcan:can0 --node 2

        drive-profiles watch 0x6041 --bus socketcan:can0 --node 2 --for-s 10 --json
    """
    with exit_on_error(), drive.opened() as device:
        entries = [device.catalogue.find(text) for text in objects]
        readings = _readings(device, entries, every_s, count, for_s)
        try:
            if drive.as_json:
                for when, values in readings:
                    document = {"time_s": round(when, 6), **{_key(e): in_json(v) for e, v in zip(entries, values, strict=True)}}
                    typer.echo(json.dumps(document, ensure_ascii=False))
            elif sys.stdout.isatty():
                _live(device, entries, readings)
            else:
                for when, values in readings:
                    cells = (
                        f"{_key(e)} {_text(e, v)} {device.catalogue.unit_of(e)}".rstrip()
                        for e, v in zip(entries, values, strict=True)
                    )
                    typer.echo(f"{when:9.3f} s  {'  '.join(cells)}")
        except KeyboardInterrupt as error:
            if error.args or count is not None or for_s is not None:  # it was to go on
                raise fail(interrupted(error), ExitStatus.INTERRUPTED) from None


def _readings(
    device: "Device", entries: "list[CatalogueEntry]", every_s: float, count: int | None, for_s: float | None
) -> Iterator[tuple[float, list[float | str]]]:
    """Yield time and values of each reading; missed readings are skipped."""
    scaling = device.scaling(entries)
    start, made = time.monotonic(), 0
    while count is None or made < count:
        when = time.monotonic() - start
        if for_s is not None and made and when > for_s:
            return
        yield when, [decoded(entry, device.read(entry.address), lambda _: scaling) for entry in entries]
        made += 1
        if made == count:
            return
        elapsed = time.monotonic() - start
        time.sleep(every_s * (math.floor(elapsed / every_s) + 1) - elapsed)


def _live(device: "Device", entries: "list[CatalogueEntry]", readings: Iterator[tuple[float, list[float | str]]]) -> None:
    """Show the latest values with a plot line each, in place."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    kept: list[deque[float]] = [deque(maxlen=KEPT) for _ in entries]
    width = max(len(_key(entry)) for entry in entries)
    with Live(console=Console(), auto_refresh=False) as live:
        for when, values in readings:
            lines = [f"{when:.1f} s, Ctrl-C ends it"]
            for entry, value, past in zip(entries, values, kept, strict=True):
                if not isinstance(value, str):
                    past.append(float(value))
                unit = shown.unit(device.catalogue.unit_of(entry))
                lines.append(f"{_key(entry):<{width}}  {_text(entry, value):>12} {unit:<8} {plot_line(past)}")
            live.update(Text("\n".join(lines)), refresh=True)


def plot_line(values: deque[float]) -> str:
    """Plot values as a line of blocks.

    >>> plot_line(deque([0.0, 1.0, 2.0])), plot_line(deque([3.0, 3.0]))
    ('▁▅█', '▁▁')
    """
    known = [value for value in values if math.isfinite(value)]
    low, high = min(known, default=0.0), max(known, default=0.0)
    step = (high - low) / (len(_BARS) - 1) or 1.0
    return "".join(_BARS[int((value - low) / step + 0.5)] if math.isfinite(value) else " " for value in values)


def _key(entry: "CatalogueEntry") -> str:
    from drive_profiles.standard.object_address import address_text

    return entry.name or address_text(entry.address)


def _text(entry: "CatalogueEntry", value: float | str) -> str:
    return shown.value(value, entry.address, entry.data_type)
