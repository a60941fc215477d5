"""The window in which an interrupt still has an upload put back; it is closed once, and nothing follows that could be undone."""

from __future__ import annotations

_INTERRUPTED, _CLOSED = "interrupted", "closed"


class InterruptWindow:
    """Time in which an interrupt still counts: whichever comes first, the interrupt or the closing, decides for good.

    Signal handlers and threads may use it without a lock: the one step that decides is a single operation of the interpreter.
    """

    def __init__(self) -> None:
        self._first: dict[None, str] = {}

    @property
    def is_interrupted(self) -> bool:
        """True if an interrupt has come in time."""
        return self._first.get(None) == _INTERRUPTED

    def interrupt(self) -> bool:
        """Interrupt; False if it comes too late and changes nothing."""
        return self._first.setdefault(None, _INTERRUPTED) == _INTERRUPTED

    def close(self) -> bool:
        """Close the window; False if an interrupt has come before."""
        return self._first.setdefault(None, _CLOSED) == _CLOSED
