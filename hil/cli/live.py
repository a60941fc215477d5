"""`--live [PORT]` of motion commands: a scope in another process."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from drive_profiles.cli.application import ToolCommand
from hil.cli import options
from hil.cli.console import say

DEFAULT_PORT = 8765
OPTION = "--live"

LiveOption = Annotated[
    int | None,
    typer.Option(
        OPTION, metavar="[PORT]", min=0, max=65535,
        help=f"Show it live in a browser: a page on 127.0.0.1:PORT ({DEFAULT_PORT}; 0 takes a free port).",
    ),
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Options at the end of commands that measure by moving a robot."""

    out: options.NewOutOption = None
    force: options.ForceOption = False
    overload: options.OverloadOption = False
    live: LiveOption = None
    yes: options.YesOption = False
    as_json: options.JsonOption = False


class LiveCommand(ToolCommand):
    """Command with `--live [PORT]`, whose port may be left out."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments."""
        return super().parse_args(ctx, with_port(args))


def with_port(args: list[str]) -> list[str]:
    """Give a `--live` that no number follows its default.

    >>> with_port(["--live", "--axis", "2"])
    ['--live=8765', '--axis', '2']
    >>> with_port(["--live", "9000", "--live=0"])
    ['--live', '9000', '--live=0']
    """
    found = list(args)
    for place, word in enumerate(found):
        if word == "--":
            break
        if word == OPTION and not (place + 1 < len(found) and found[place + 1].isdigit()):
            found[place] = f"{OPTION}={DEFAULT_PORT}"
    return found


@contextlib.contextmanager
def shown_live(port: int | None, address: str, bench_file: str) -> Iterator[None]:
    """Show a bus live during runs; nothing without a port.

    Raises:
        NotPossibleError: It cannot be shown; nothing has moved.
    """
    if port is None:
        yield
        return
    from hil.scope.process import ScopeProcess

    with ScopeProcess(address, bench_file, port) as scope:
        say(f"live: {scope.url}")
        yield
