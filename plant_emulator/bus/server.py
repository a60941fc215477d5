"""The local bus: a Unix socket that several clients join, and the world behind it with its two clocks."""

import contextlib
import errno
import itertools
import os
import selectors
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from drive_profiles.standard.cia301 import FunctionCode
from hil.can import clock
from hil.can.frame import MAX_DATA_LENGTH, RECORD, Frame, pack, unpack
from hil.can.raw import wait_at_most
from plant_emulator.bus.medium import Instant, Medium
from plant_emulator.bus.timed import FIRST_CLIENT, HeardFrame
from plant_emulator.world import SECOND, World

FREE_POLL_S = 0.001
"""Time that a world that moves by itself sleeps between two looks at its clients, in s."""
CLOCK_WAIT_S = 0.001
"""Longest silence of the lock-step client before the others are served, in s."""
TURN_FRAMES = 64
"""Frames of the lock-step client after which the others are looked at."""
_MESSAGE_BYTES = clock.MAX_RECORDS * RECORD.size + 1  # a longer message shows itself by its last byte
MAX_CLIENTS = 32
SEND_BUFFER_BYTES = 1 << 20
"""Buffer of a client's socket, as far as the system allows: its own 208 KiB hold 277 records, and the 127 segments of an SDO
block, each with its time stamp, are 254."""
STREAM_BACKLOG_BYTES = 1 << 20


class AddressInUseError(Exception):
    """Another server answers at this path."""

    def __init__(self, path: str) -> None:
        """Take the path of the socket."""
        self.path = path
        super().__init__(f"another server answers at {path}")


class Client:
    """One participant of the bus. What it does not read in time is dropped and counted, never waited for.

    Attributes:
        is_over: Whether the server is to drop it, though it is still connected.
    """

    def __init__(self, sock: socket.socket, port: int) -> None:
        """Take over a connected socket.

        Args:
            sock: Its own end.
            port: Its number on the bus.
        """
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
        self._received, self._backlog = b"", bytearray()

    def send(self, record: bytes) -> None:
        """Deliver a message, or drop it where the client's queue is full."""
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
        """Deliver records, several in one message where the client understands that."""
        if not self.takes_several or len(records) == 1:
            for record in records:
                self.send(record)
            return
        for begin in range(0, len(records), clock.MAX_RECORDS):
            self.send(b"".join(records[begin : begin + clock.MAX_RECORDS]))

    def _send_stream(self, record: bytes) -> None:
        """A stream must not lose half a record: what does not fit waits, up to a bound."""
        self.flush()
        if len(self._backlog) >= STREAM_BACKLOG_BYTES:
            self.dropped += 1
            return
        self._backlog += record
        self.flush()

    def flush(self) -> None:
        """Write the waiting bytes to a stream, as far as there is room."""
        with contextlib.suppress(OSError):  # no room; or it has gone, and the next read says so
            while self._backlog:
                del self._backlog[: self.socket.send(self._backlog[:65536], socket.MSG_DONTWAIT)]

    def receive(self, *, wait: bool = False) -> list[Frame] | None:
        """The frames that are there, [] where there is none, None where the client has gone; what is no frame is dropped.

        Args:
            wait: Wait for the first one, up to `CLOCK_WAIT_S`.
        """
        try:
            data = self.socket.recv(65536 if self._is_stream else _MESSAGE_BYTES, 0 if wait else socket.MSG_DONTWAIT)
        except BlockingIOError:
            return []
        except OSError:
            return None
        if not data:
            return None
        if not self._is_stream:
            if len(data) != RECORD.size:
                return _frames(data) if len(data) % RECORD.size == 0 else []
            frame = unpack(data)
            return [] if frame is None else [frame]
        self._received += data
        whole = len(self._received) - len(self._received) % RECORD.size
        records, self._received = self._received[:whole], self._received[whole:]
        return _frames(records)


class Door:
    """A listening socket, and the participants that it makes of connections."""

    def __init__(self, listener: socket.socket) -> None:
        """Take over a listening socket."""
        self.listener = listener
        listener.setblocking(False)

    def admit(self, sock: socket.socket, port: int) -> Client:
        """Make a participant of a new connection."""
        return Client(sock, port)

    def turn_away(self, sock: socket.socket) -> None:
        """Refuse a client beyond the largest number."""
        sock.close()


class Server:
    """Serves a world at a path.

    The client whose SYNC was the last holds the clock: as long as it is connected the world moves by SYNC alone. Otherwise the
    world follows the monotonic clock.
    """

    def __init__(
        self,
        world: World,
        path: str,
        *,
        stream: bool = False,
        medium: Medium | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Bind the path and start the nodes.

        Args:
            world: The world behind the bus.
            medium: The medium between world and clients; left out, frames arrive at once and in order.
            path: Path of the socket; a stale one is removed.
            stream: Use a stream socket although the system has seqpacket ones.
            now_ns: The monotonic clock.

        Raises:
            AddressInUseError: Another server answers there.
            OSError: The path cannot be bound.
        """
        self.world = world
        self.path = path
        self._doors: dict[int, Door] = {}
        listener = _listen(path, stream=stream)
        self._inode = Path(path).stat().st_ino
        self._clients: dict[int, Client] = {}
        self.medium: Medium = Instant(world) if medium is None else medium
        self._is_wall = self.medium.clock == clock.WALL
        # epoll counts in milliseconds, select in microseconds
        self._selector = selectors.SelectSelector() if self._is_wall else selectors.DefaultSelector()
        self._ports = itertools.count(FIRST_CLIENT)
        self.open(Door(listener))
        self._clock: Client | None = None
        self._now_ns = now_ns
        self._epoch_ns = now_ns() - world.now
        self._stop = False
        self._cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
        world.power_on()

    def open(self, door: Door) -> None:
        """Take participants through one more listening socket; `close` closes it."""
        self._doors[door.listener.fileno()] = door
        self._selector.register(door.listener, selectors.EVENT_READ)

    def watch(self, descriptor: int) -> None:
        """Stop when this descriptor is closed at its other end: the server then lives as long as the one who started it."""
        try:
            self._selector.register(descriptor, selectors.EVENT_READ)
        except (OSError, ValueError):
            self._stop = True  # /dev/null, a regular file or a closed one: there is nobody at its other end

    def stop(self) -> None:
        """End `run` soon; may be called from a signal handler."""
        self._stop = True

    def run(self) -> None:
        """Serve until `stop`."""
        try:
            while not self._stop:
                if self._clock is not None:
                    self._serve_clock(self._clock)
                self._serve(self._wait())
                for descriptor, client in tuple(self._clients.items()):
                    client.flush()
                    if client.is_over:
                        self._drop(descriptor)
                if self._clock is None:
                    self._deliver(self.medium.free(self._wall_ns()))
        finally:
            self.close()

    def _wall_ns(self) -> int:
        """The world's time as it would be now if it followed the monotonic clock."""
        return max(self.world.now, self._now_ns() - self._epoch_ns)

    def _wait(self) -> list[int]:
        """Descriptors that can be read; while the world moves by itself, sleeps a little for them."""
        if self._clock is not None:
            return [key.fd for key, _ in self._selector.select(0.0)]
        patience = FREE_POLL_S
        if self._is_wall and (due := self.medium.due) is not None:
            patience = min(patience, max(0.0, (due - self._wall_ns()) / SECOND))
        return [key.fd for key, _ in self._selector.select(patience)]

    def _serve_clock(self, holder: Client) -> None:
        """A turn of lock-step: what the client that holds the clock sends, waited for in its own socket.

        The turn ends when the client is silent for `CLOCK_WAIT_S` or has sent its part of the frames; then the others are served.
        """
        for _ in range(TURN_FRAMES):
            frames = holder.receive(wait=True)
            if frames is None:
                self._drop(holder.socket.fileno())
            for frame in frames or ():
                self._on_frame(frame, holder)
            if not frames:
                self._deliver(self.medium.idle())
            if not frames or self._clock is not holder:
                return

    def _serve(self, descriptors: Iterable[int]) -> None:
        for descriptor in descriptors:
            if descriptor in self._doors:
                self._accept(self._doors[descriptor])
            elif descriptor in self._clients:
                self._read(descriptor)
            else:
                try:
                    self._stop = self._stop or not os.read(descriptor, 4096)
                except OSError:
                    self._stop = True

    def _accept(self, door: Door) -> None:
        try:
            sock, _ = door.listener.accept()
        except OSError:
            return
        if len(self._clients) >= MAX_CLIENTS:
            door.turn_away(sock)
            return
        try:
            client = door.admit(sock, next(self._ports))
        except OSError:  # it has gone already
            sock.close()
            return
        self._clients[sock.fileno()] = client
        self.medium.join(client.port)
        self._selector.register(sock, selectors.EVENT_READ)

    def _read(self, descriptor: int) -> None:
        client = self._clients[descriptor]
        for _ in range(TURN_FRAMES):
            frames = client.receive()
            if frames is None:
                self._drop(descriptor)
                return
            if not frames:
                return
            for frame in frames:
                self._on_frame(frame, client)
            if client is not self._clock:
                return  # one at a time, so that a babbling client does not keep the others out

    def _on_frame(self, frame: Frame, sender: Client) -> None:
        if frame.can_id == clock.CLOCK_ID:
            self._on_question(frame, sender)
            return
        if self._is_wall:
            self._deliver(self.medium.free(self._wall_ns()))
        if self._is_wall or frame.can_id != FunctionCode.SYNC or not sender.may_be_clock:
            self._deliver(self.medium.frame(sender.port, frame))
            return
        if self._clock is not sender:
            if self._clock is None:
                self._deliver(self.medium.begin_cycles())
            self._clock = sender
        sender.syncs += 1
        for heard in self.medium.cycle(sender.port, frame):
            has_time = sender.knows_clock and self.medium.bitrate is not None
            over = pack(clock.period_over(sender.syncs, self.medium.lag_ns)) if has_time else b""
            self._deliver(heard, sender, over)

    def _on_question(self, frame: Frame, sender: Client) -> None:
        """Tell a client which clock the bus has."""
        asked = clock.read_question(frame.data)
        if asked is not None:
            sender.knows_clock = True
            sender.wants_stamps = asked.stamps
            sender.takes_several = asked.several
            sender.may_be_clock = not asked.follows
            sender.send(pack(clock.answer(self.medium.clock, self.medium.bitrate, several=True)))

    def _deliver(self, heard: Iterable[HeardFrame], waiting: Client | None = None, last: bytes = b"") -> None:
        """Give everyone what others have sent, and behind it a last record to the one who waits for it."""
        if len(self._clients) == 1:  # the rule, and quick: nobody else hears what it has sent itself
            [alone] = self._clients.values()
            heard = [each for each in heard if each[1] != alone.port]
        sent = [(pack(frame), port, end_ns) for frame, port, end_ns in heard]
        if not sent and not last:
            return
        for client in self._clients.values():
            records = []
            for record, port, end_ns in sent:
                if port != client.port:
                    if client.wants_stamps:
                        records.append(pack(clock.stamp(end_ns)))
                    records.append(record)
            if client is waiting and last:
                records.append(last)
            client.send_all(records)

    def _drop(self, descriptor: int) -> None:
        client = self._clients.pop(descriptor)
        self.medium.leave(client.port)
        self._selector.unregister(client.socket)
        client.socket.close()
        if client is self._clock:
            self._clock = None
            self._epoch_ns = self._now_ns() - self.world.now
            if self._cores is not None:
                os.sched_setaffinity(0, self._cores)  # the lock-step client may have taken us to its core

    def close(self) -> None:
        """Leave: close all sockets and remove the path, if it is still ours."""
        for descriptor in list(self._clients):
            self._drop(descriptor)
        self._selector.close()
        for door in self._doors.values():
            door.listener.close()
        with contextlib.suppress(OSError):
            if Path(self.path).stat().st_ino == self._inode:
                Path(self.path).unlink()


def _frames(records: bytes) -> list[Frame]:
    """Frames of whole records; other bytes are skipped."""
    return [Frame(can_id, data[:length]) for can_id, length, data in RECORD.iter_unpack(records) if length <= MAX_DATA_LENGTH]


def _listen(path: str, *, stream: bool) -> socket.socket:
    """Make a listening socket at the path; a socket there that does not answer is a leftover and is replaced.

    The socket gets its name once it listens, so that whoever sees the file can connect.
    """
    kinds = [socket.SOCK_STREAM]
    if not stream and hasattr(socket, "SOCK_SEQPACKET"):
        kinds.insert(0, socket.SOCK_SEQPACKET)
    if Path(path).is_socket():
        if _answers(path):
            raise AddressInUseError(path)
        Path(path).unlink()
    if Path(path).exists():
        raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE), path)
    unfinished = path[:-1] + ("~" if path[-1] != "~" else "-")  # as long as the path, whose length is limited
    if Path(unfinished).is_socket() and not _answers(unfinished):
        Path(unfinished).unlink()
    failure: OSError | None = None
    for kind in kinds:
        try:
            sock = socket.socket(socket.AF_UNIX, kind)
        except OSError as error:
            failure = error
            continue
        try:
            with _private():
                sock.bind(unfinished)
            sock.listen(MAX_CLIENTS)
            Path(path).hardlink_to(unfinished)  # unlike a renaming, it replaces nothing
            Path(unfinished).unlink()
        except OSError:
            sock.close()
            raise
        return sock
    raise failure if failure is not None else OSError("no Unix sockets")


def _answers(path: str) -> bool:
    for kind in (getattr(socket, "SOCK_SEQPACKET", socket.SOCK_STREAM), socket.SOCK_STREAM):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as probe:
            probe.connect(path)
            return True
    return False


@contextlib.contextmanager
def _private() -> Iterator[None]:
    """Only the user who serves may join."""
    before = os.umask(0o177)
    try:
        yield
    finally:
        os.umask(before)
