"""A pseudo-terminal under a given path."""

import contextlib
import os
import tty
from pathlib import Path

from drive_profiles.files.safefile import check_folder

MAX_BACKLOG_BYTES = 1 << 16
READ_BYTES = 4096


class PseudoTerminal:
    """The device's end of a pseudo-terminal; nothing here ever blocks.

    The other end is kept open here too, so that one who opens and closes the port finds the same device again, as behind USB.

    Attributes:
        dropped: Writes that found no room.
    """

    def __init__(self, link: str | None = None, *, max_backlog_bytes: int = MAX_BACKLOG_BYTES) -> None:
        """Open it, raw and without echo.

        Args:
            link: Path of a link to it, which is made here and removed by `close`; a stale one is replaced.
            max_backlog_bytes: Most bytes that wait for a reader, beyond those that the kernel keeps.

        Raises:
            FileExistsError: Something other than a stale link is at `link`.
            OSError: No pseudo-terminal, or the link cannot be made.
        """
        self.dropped = 0
        self._max_backlog_bytes = max_backlog_bytes
        self._backlog = bytearray()
        self._device, self._port = os.openpty()
        try:
            tty.setraw(self._port)
            os.set_blocking(self._device, False)
            self._name = os.ttyname(self._port)
            self.path = self._name if link is None else self._link(link)
        except BaseException:
            os.close(self._device)
            os.close(self._port)
            raise

    def _link(self, link: str) -> str:
        path = Path(link)
        if path.is_symlink() and os.readlink(link).startswith("/dev/pts/"):
            if path.exists() and os.readlink(link) != self._name:
                raise FileExistsError(f"{link} leads to {os.readlink(link)}, which is in use; end its server, or remove the link")
            path.unlink()
        elif path.is_symlink() or path.exists():
            raise FileExistsError(f"{link} exists and is not a link to a pseudo-terminal; choose another path")
        check_folder(path)
        path.symlink_to(self._name)
        return link

    def fileno(self) -> int:
        """Return the descriptor, readable when the other end has written."""
        return self._device

    @property
    def backlog(self) -> int:
        """Number of bytes that wait for a reader."""
        return len(self._backlog)

    def read(self) -> bytes:
        """Read the bytes that the other end has written."""
        try:
            return os.read(self._device, READ_BYTES)
        except OSError:  # nothing there; it cannot be gone, since the port is held open here
            return b""

    def write(self, data: bytes, *, must: bool = False) -> bool:
        """Write bytes for the other end, all or none.

        Returns False if there was no room.

        Args:
            must: Keep it although the bound is reached; the caller then bounds how often.
        """
        self.flush()
        if len(self._backlog) + len(data) > self._max_backlog_bytes and not must:
            self.dropped += 1
            return False
        self._backlog += data
        self.flush()
        return True

    def flush(self) -> None:
        """Write the waiting bytes for the other end, as far as possible."""
        with contextlib.suppress(OSError):
            while self._backlog:
                del self._backlog[: os.write(self._device, self._backlog[:READ_BYTES])]

    def discard_after(self, end: bytes) -> None:
        """Discard the waiting bytes after the first `end`."""
        del self._backlog[self._backlog.find(end) + len(end) :]

    def close(self) -> None:
        """Close both ends, and remove the link if it is still ours."""
        if self.path != self._name:
            with contextlib.suppress(OSError):
                if os.readlink(self.path) == self._name:
                    Path(self.path).unlink()
        for descriptor in (self._device, self._port):
            with contextlib.suppress(OSError):
                os.close(descriptor)
