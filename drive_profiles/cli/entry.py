"""Entry point of the three tools.

Their modules take some tenths of a second to load; Ctrl-C ends the process then as it does later.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from types import FrameType

INTERRUPTED, INTERNAL = 130, 1
"""Exit statuses of all tools; `drive_profiles.cli.console`, which has them, is one of the modules that load."""


def start(package: str) -> None:
    """Load a tool and run it; never returns.

    Args:
        package: Package of the tool; `app` in its `cli.main` is run.
    """
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler:  # nohup stays nohup
        signal.signal(signal.SIGINT, _interrupted)  # no exception: a module that is loading may turn it into another one
    app = importlib.import_module(f"{package}.cli.main").app
    try:
        signal.signal(signal.SIGINT, handler)
        app.run()
    except KeyboardInterrupt:
        _leave("interrupted\n", INTERRUPTED)
    except SystemExit as end:
        if end.code != INTERRUPTED:
            raise
        sys.stdout.flush()
        _leave("", INTERRUPTED)  # the interpreter would end by the signal, if it came in code that was evaluated from text
    except OSError as error:  # such as a full disk behind standard output
        _leave(f"{error}\n", INTERNAL)


def _interrupted(number: int, frame: FrameType | None) -> None:
    _leave("interrupted\n", INTERRUPTED)


def _leave(text: str, status: int) -> None:
    """End the process at once, with a line on standard error."""
    try:
        os.write(2, text.encode())
    finally:  # also where standard error is closed
        os._exit(status)
