"""Reporter of a bench's progress."""

from typing import Final


class Reporter:
    """Listener of a measurement or a computation, called from its thread."""

    def run(self, title: str) -> None:
        """Show that a run of an experiment begins."""

    def step(self, sentence: str) -> None:
        """Show that a step begins."""

    def progress(self, fraction: float) -> None:
        """Show the progress of the present motion or search, 0 to 1."""


SILENT: Final = Reporter()
