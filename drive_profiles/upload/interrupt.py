"""The window in which an interrupt still rolls an upload back.

It is closed once; after that nothing can be undone.
"""

_INTERRUPTED, _CLOSED = "interrupted", "closed"


class InterruptWindow:
    """Window in which an interrupt still counts.

    Signal handlers and threads may use it without a lock: the one step that decides is a single operation of the interpreter.
    """

    def __init__(self) -> None:
        self._first: dict[None, str] = {}

    @property
    def is_interrupted(self) -> bool:
        """True if an interrupt came before the closing."""
        return self._first.get(None) == _INTERRUPTED

    def interrupt(self) -> bool:
        """Interrupt the upload; return False if the window is closed already."""
        return self._first.setdefault(None, _INTERRUPTED) == _INTERRUPTED

    def close(self) -> bool:
        """Close the window; return False if an interrupt came first."""
        return self._first.setdefault(None, _CLOSED) == _CLOSED
