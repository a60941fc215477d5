"""What holds for all tests."""

import contextlib
import functools
import gc
import importlib
import os
import signal
from collections.abc import Generator
from pathlib import Path

import pytest
import typer.main
import typer.testing
from hypothesis import HealthCheck, settings

from drive_profiles.address import BUS_VARIABLE
from drive_profiles.cli.application import NEW_OBJECTS
from drive_profiles.cli.console import Interrupts

ANY_PACE = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
"""How long an example takes depends on what else the machine does."""
settings.register_profile("same", derandomize=True, **ANY_PACE)
settings.register_profile("random", derandomize=False, print_blob=True, **ANY_PACE)
settings.load_profile("same")
"""The same examples in each run; the whole tier asks for `random`, which draws others."""


typer.testing._get_command = functools.cache(typer.main.get_command)
"""A tool's commands are made of their functions once, and not for each call of a test: that takes up to 80 ms."""


def pytest_configure() -> None:
    """Let Ctrl-C interrupt the tests.

    A shell starts what it runs in the background with SIGINT ignored, and that is inherited: the processes that the tests start
    and interrupt would never hear it.
    """
    gc.disable()  # until the tests are collected: it finds nothing in modules, and takes a sixth of the time
    os.environ.pop(BUS_VARIABLE, None)  # of the user's shell, where it may name a robot
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # nohup
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let a second worker load the tests from their end.

    What pytest makes of their asserts takes 24 s and is kept in files: so two workers share that, and do not both do all of it.
    """
    if os.environ.get("PYTEST_XDIST_WORKER", "gw0") == "gw0":
        return
    for given in session.config.args:
        path = Path(given.partition("::")[0]).absolute()
        for file in sorted(path.rglob("test_*.py"), reverse=True):
            name = ".".join(file.relative_to(session.config.rootpath).with_suffix("").parts)
            with contextlib.suppress(Exception, pytest.skip.Exception):  # the collection says what is wrong
                importlib.import_module(name)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Let the garbage collector work from here on, also in the process that only hands the tests out."""
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest tests, those with the largest limit: at the end one of two workers would wait for the other."""
    items.sort(key=limit_s, reverse=True)


def limit_s(item: pytest.Item) -> float:
    """The time that a test is given by its own mark; 0 where it has none."""
    mark = item.get_closest_marker("timeout")
    return 0.0 if mark is None else float(mark.args[0])


def pytest_collection_finish() -> None:
    """Keep the garbage collector off the collected tests: going through them takes a fifth of a second.

    It comes as rarely as in the tools.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(NEW_OBJECTS)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Give signals back: a test that runs a tool in its own process leaves them to that tool, which keeps them to its end."""
    Interrupts.owns_process = Interrupts.is_held_to_the_end = False
    for number in Interrupts.SIGNALS:
        default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
        if signal.getsignal(number) is not default:
            signal.signal(number, default)


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages whose figures are made but not drawn, for what asks for words and keys alone; drawing them is most of the time."""
    from hil.report import style  # noqa: PLC0415 - matplotlib, which few tests need

    monkeypatch.setattr(style, "to_svg", lambda figure, key, **options: f'<svg role="img" aria-labelledby="{key}-title"></svg>')
