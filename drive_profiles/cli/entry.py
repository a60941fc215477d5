"""Entry point of the three tools.

Their modules take some tenths of a second to load; a signal ends the process then as it does later.
"""

import contextlib
import importlib
import itertools
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED, INTERNAL = 130, 1
"""Exit statuses of all tools; `drive_profiles.cli.console`, which has them, is one of the modules that load."""
ENDING = {
    getattr(signal, name): default
    for name, default in (("SIGINT", signal.default_int_handler), ("SIGTERM", signal.SIG_DFL), ("SIGHUP", signal.SIG_DFL))
    if hasattr(signal, name)
}
"""Signals that end a command with a line, with their handlers in a new process.

One that has another handler, such as nohup's, keeps it.
"""
ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""Threads of linear algebra, which numpy reads when it loads. Matrices here are small, and a second thread mostly waits:
without this, the documented path on a drawn robot takes 46 instead of 37 s, and 1.5 times the processor time."""
_tool = "the command"
came: list[int] = []
"""Signals that have ended the command of this process."""


def start(package: str) -> None:
    """Load a tool and run it; never returns."""
    global _tool  # noqa: PLW0603 - a process has one tool
    _tool = package.replace("_", "-")
    os.environ.setdefault(ONE_THREAD, "1")
    heard = hear(_interrupted)  # no exception: a module that is loading may turn it into another one
    app = importlib.import_module(f"{package}.cli.main").app
    try:
        for number in heard:
            signal.signal(number, ENDING[number])
        app.run()
    except KeyboardInterrupt as error:
        leave(f"{interrupted(error)}\n", exit_status())
    except SystemExit as end:
        if end.code != INTERRUPTED:
            raise
        with contextlib.suppress(OSError):  # the terminal may have gone
            sys.stdout.flush()
        leave("", exit_status())  # the interpreter would end by the signal, if it came in code that was evaluated from text
    except OSError as error:  # such as a full disk behind standard output
        leave(f"{error}\n", exit_status() if came else INTERNAL)


def hear(handler: Callable[[int, FrameType | None], Any]) -> list[int]:
    """Let a handler take the signals that end a command; return them."""
    heard = [number for number, default in ENDING.items() if signal.getsignal(number) is default]
    for number in heard:
        signal.signal(number, handler)
    return heard


def interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Handle a signal: raise `KeyboardInterrupt`, with the words for any signal but Ctrl-C's."""
    came.append(number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    signal.signal(number, signal.SIG_DFL)  # a second one ends the process at once
    raise KeyboardInterrupt(_words(number))


def interrupted(error: KeyboardInterrupt) -> str:
    """Return the words for an interrupt.

    >>> interrupted(KeyboardInterrupt()), interrupted(KeyboardInterrupt("hil move was interrupted by SIGTERM"))
    ('interrupted', 'hil move was interrupted by SIGTERM')
    """
    return str(error) or "interrupted"


def exit_status() -> int:
    """Exit status of an interrupted command: 130, or as a shell gives it for another signal than Ctrl-C's."""
    return 128 + came[0] if came else INTERRUPTED


def leave(text: str, status: int) -> NoReturn:
    """End the process at once, with a line on standard error."""
    try:
        os.write(2, text.encode())
    finally:  # also where standard error is closed
        os._exit(status)


def _words(number: int) -> str:
    """Return the words for a signal: a log needs more of them than a user who has just pressed Ctrl-C."""
    if number == signal.SIGINT:
        return "interrupted"
    command = itertools.takewhile(lambda word: not word.startswith("-"), sys.argv[1:])
    return f"{' '.join((_tool, *command))} was interrupted by {signal.Signals(number).name}"


def _interrupted(number: int, frame: FrameType | None) -> NoReturn:
    came.append(number)
    leave(f"{_words(number)} before the command began\n", exit_status())
