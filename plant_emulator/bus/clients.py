"""Participants of the local bus, and their listening sockets."""

import contextlib
import socket
from collections.abc import Iterator

from hil.can import clock
from hil.can.frame import RECORD, Frame, frames_of
from hil.can.local import arrival_ns, stamp_arrivals, wait_at_most

CLOCK_WAIT_S = 0.001
"""Longest silence of the lock-step client before the others are served, in s."""
MAX_CLIENTS = 32
SEND_BUFFER_BYTES = 1 << 20
"""Buffer of a client's socket, as far as the system allows: its own 208 KiB hold 277 records, and the 127 segments of an SDO
block, each with its time stamp, are 254."""
STREAM_BACKLOG_BYTES = 1 << 20
MAX_QUEUED = 1024
"""Messages of a client that a late world reads at once: more than its socket holds."""
_MESSAGE_BYTES = clock.MAX_RECORDS * RECORD.size + 1  # a longer message shows itself by its last byte
_ANCILLARY_BYTES = 64


class Client:
    """One participant of the bus.

    Records that it does not read in time are dropped and counted; the server never waits for it.

    Attributes:
        is_over: True if the server is to drop it, though it is still connected.
    """

    def __init__(self, sock: socket.socket, port: int) -> None:
        self.port = port
        self.knows_clock = self.wants_stamps = self.takes_several = False
        self.may_be_clock = True
        self.is_over = False
        self.syncs = 0
        sock.setblocking(True)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        wait_at_most(sock, CLOCK_WAIT_S)
        self.socket = sock
        self.dropped = 0
        self._is_stream = sock.type == socket.SOCK_STREAM
        self._has_stamps = False
        self._received, self._backlog = b"", bytearray()

    def send(self, record: bytes) -> None:
        """Deliver a message, or drop it if the client's queue is full."""
        try:
            if self._is_stream:
                self._send_stream(record)
            else:
                self.socket.send(record, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self.dropped += len(record) // RECORD.size
        except OSError:
            pass  # it has gone; the next read says so

    def send_all(self, records: list[bytes]) -> None:
        """Deliver records, several in one message if the client understands that."""
        if not self.takes_several or len(records) == 1:
            for record in records:
                self.send(record)
            return
        for begin in range(0, len(records), clock.MAX_RECORDS):
            self.send(b"".join(records[begin : begin + clock.MAX_RECORDS]))

    def _send_stream(self, record: bytes) -> None:
        """Send a record to a stream without losing a part."""
        self.flush()
        if len(self._backlog) >= STREAM_BACKLOG_BYTES:
            self.dropped += 1
            return
        self._backlog += record
        self.flush()

    def flush(self) -> None:
        """Write the waiting bytes to a stream, as far as possible."""
        with contextlib.suppress(OSError):  # no room; or it has gone, and the next read says so
            while self._backlog:
                del self._backlog[: self.socket.send(self._backlog[:65536], socket.MSG_DONTWAIT)]

    def receive(self) -> list[Frame] | None:
        """Return the received frames; None if the client is gone."""
        records = self.receive_records()
        return None if records is None else frames_of(records)

    def receive_records(self, *, wait: bool = False) -> bytes | None:
        """Return the records of the next message; None if the client is gone.

        They are empty if none has come. A message that is not made of whole records is dropped.
        """
        try:
            data = self.socket.recv(65536 if self._is_stream else _MESSAGE_BYTES, 0 if wait else socket.MSG_DONTWAIT)
        except BlockingIOError:
            return b""
        except OSError:
            return None
        if not data:
            return None
        if not self._is_stream:
            return data if len(data) % RECORD.size == 0 else b""
        self._received += data
        whole = len(self._received) - len(self._received) % RECORD.size
        records, self._received = self._received[:whole], self._received[whole:]
        return records

    def stamp_arrivals(self) -> None:
        """Let the kernel stamp the arrival of each message.

        This works on Linux, for seqpacket sockets.
        """
        with contextlib.suppress(OSError):
            stamp_arrivals(self.socket)
            self._has_stamps = not self._is_stream

    def queued(self) -> Iterator[tuple[Frame, int | None]]:
        """Yield all received frames with their arrival times.

        A time is in ns since 1970; None if only the order is known.

        A client that is gone is marked with `is_over`.
        """
        for _ in range(MAX_QUEUED):
            stamp: int | None = None
            if self._has_stamps:
                frames, stamp = self._receive_stamped()
            else:
                frames = self.receive()
            if frames is None:
                self.is_over = True
                return
            if not frames:
                return
            for frame in frames:
                yield frame, stamp

    def _receive_stamped(self) -> tuple[list[Frame] | None, int | None]:
        """Return the frames of the next message, and its arrival time."""
        while True:
            try:
                data, ancillary, _, _ = self.socket.recvmsg(_MESSAGE_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return [], None
            except OSError:
                return None, None
            if not data:
                return None, None
            frames = frames_of(data) if len(data) % RECORD.size == 0 else []
            if frames:
                return frames, arrival_ns(ancillary)


class Listener:
    """Listening socket that makes participants of connections."""

    def __init__(self, listener: socket.socket) -> None:
        self.listener = listener
        listener.setblocking(False)

    def accept(self, sock: socket.socket, port: int) -> Client:
        """Make a participant of a new connection."""
        return Client(sock, port)

    def reject(self, sock: socket.socket) -> None:
        """Refuse a client beyond the largest number."""
        sock.close()
