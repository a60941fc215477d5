"""Reporter of a bench's progress: protocol, and a silent one."""

from typing import Final, Protocol


class Reporter(Protocol):
    """Listener of a measurement or a computation, called from its thread."""

    def run(self, title: str) -> None:
        """Show that a run of an experiment begins."""

    def step(self, sentence: str) -> None:
        """Show that a step begins.

        A trial, a pass, or a part of a tour.
        """

    def progress(self, fraction: float) -> None:
        """Show the progress of the present motion or search, 0 to 1."""


class SilentReporter:
    """Reporter that shows nothing; base of those that show some of it."""

    def run(self, title: str) -> None:
        """Show nothing."""

    def step(self, sentence: str) -> None:
        """Show nothing."""

    def progress(self, fraction: float) -> None:
        """Show nothing."""


SILENT: Final[Reporter] = SilentReporter()
