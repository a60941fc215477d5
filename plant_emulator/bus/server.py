"""The local bus: a socket for several clients, its world and clocks."""

import contextlib
import errno
import itertools
import os
import selectors
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from operator import itemgetter
from pathlib import Path

from drive_profiles.files.safefile import check_folder
from drive_profiles.standard.cia301 import FunctionCode
from hil.can import clock
from hil.can.frame import RECORD, Frame, frames_of, pack
from plant_emulator.bus.clients import MAX_CLIENTS, Client, Listener
from plant_emulator.bus.instant import FIRST_CLIENT, HeardFrame, Instant
from plant_emulator.bus.medium import Medium
from plant_emulator.bus.stalls import LATE_NS, WallTime, spread, to_stderr
from plant_emulator.world import SECOND, World

FREE_POLL_S = 0.001
"""Time that a world that moves by itself sleeps between two looks at its clients, in s."""
MAX_MESSAGE_BYTES = clock.MAX_RECORDS * RECORD.size
TURN_FRAMES = 64
"""Frames of the lock-step client after which the others are looked at."""


class Server:
    """Server of a world at a path.

    The client that sent the last SYNC holds the clock: while it is connected, only SYNC advances the world. Otherwise the world
    follows the monotonic clock; if it has fallen behind, it first processes the waiting frames, see `bus.stalls`.
    """

    def __init__(
        self,
        world: World,
        path: str,
        *,
        stream: bool = False,
        medium: Medium | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        say: Callable[[str], None] = to_stderr,
    ) -> None:
        """Bind the path and start the nodes.

        Args:
            medium: The medium between world and clients; left out, frames arrive at once and in order.
            path: Path of the socket; a stale one is removed.
            stream: Use a stream socket although the system has seqpacket ones.
            say: Called with a warning each time the world has fallen behind the clock.

        Raises:
            OSError: Another server answers there, or the path cannot be bound.
        """
        self.world, self.path = world, path
        self._listeners: dict[int, Listener] = {}
        listener = _listen(path, stream=stream)
        self._inode = Path(path).stat().st_ino
        self._clients: dict[int, Client] = {}
        self.medium: Medium = Instant(world) if medium is None else medium
        self._is_wall = self.medium.clock == clock.WALL
        # epoll counts in milliseconds, select in microseconds
        self._selector = selectors.SelectSelector() if self._is_wall else selectors.DefaultSelector()
        self._ports = itertools.count(FIRST_CLIENT)
        self.open(Listener(listener))
        self._clock: Client | None = None
        self.time = WallTime(now_ns, world.now, say)
        self._stop = False
        self._cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
        world.power_on()

    def open(self, listener: Listener) -> None:
        """Accept participants through another listening socket."""
        self._listeners[listener.listener.fileno()] = listener
        self._selector.register(listener.listener, selectors.EVENT_READ)

    def watch(self, descriptor: int) -> None:
        """Stop when this descriptor is closed at its other end."""
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
                ready = self._wait()
                if self._clock is None and self._wall_ns() - self.world.now > LATE_NS:
                    self._catch_up()
                self._serve(ready)
                for descriptor, client in tuple(self._clients.items()):
                    client.flush()
                    if client.is_over:
                        self._drop(descriptor)
                if self._clock is None:
                    self._pass_time()
        finally:
            self.close()

    def _wall_ns(self) -> int:
        """Return the world's time according to the monotonic clock."""
        return max(self.world.now, self.time())

    def _pass_time(self) -> None:
        """Let time pass up to the clock's."""
        now = self._wall_ns()
        if now - self.world.now <= LATE_NS:
            self._deliver(self.medium.free(now))

    def _catch_up(self) -> None:
        """Process a stall's frames at their times; let its rest pass."""
        begin, end = self.world.now, self._wall_ns()
        queued = sorted(self._queued(begin, end), key=itemgetter(0))
        arrivals = [arrival for arrival, _, _ in queued]
        instants, reached = self.time.catch_up(begin, end, arrivals, is_used=bool(self._clients))
        for instant, (_, frame, sender) in zip(instants, queued, strict=True):
            if self._clock is None:
                self._deliver(self.medium.free(instant))
            self._take(frame, sender)
        if self._clock is None:
            self._deliver(self.medium.free(reached))

    def _queued(self, begin: int, end: int) -> list[tuple[int, Frame, Client]]:
        """Return waiting frames with arrival times: the kernel's, else spread evenly."""
        real_time = time.time_ns() - end
        queued: list[tuple[int, Frame, Client]] = []
        for client in self._clients.values():
            own = list(client.queued())
            guesses = spread(begin, end, len(own))
            for (frame, stamp), guess in zip(own, guesses, strict=True):
                queued.append((guess if stamp is None else stamp - real_time, frame, client))
        return queued

    def _wait(self) -> list[int]:
        """Return the descriptors that can be read, but for the clock holder's, whose turn is its own.

        While the world moves by itself, this sleeps a little for them.
        """
        if self._clock is not None:
            own = self._clock.socket.fileno()
            return [key.fd for key, _ in self._selector.select(0.0) if key.fd != own]
        patience = FREE_POLL_S
        if self._is_wall and (due := self.medium.due) is not None:
            patience = min(patience, max(0.0, (due - self._wall_ns()) / SECOND))
        return [key.fd for key, _ in self._selector.select(patience)]

    def _serve_clock(self, holder: Client) -> None:
        """Serve a turn of lock-step to the client with the clock.

        The turn ends when the client is silent for `CLOCK_WAIT_S` or has sent its part of the frames; then the others are served.
        """
        for _ in range(TURN_FRAMES):
            records = holder.receive_records(wait=True)
            if records is None:
                self._drop(holder.socket.fileno())
            elif len(self._clients) > 1 or holder.wants_stamps or not self._exchange(records, holder):
                for frame in frames_of(records):
                    self._take(frame, holder)
            if not records:
                self._deliver(self.medium.idle())
            if not records or self._clock is not holder:
                return

    def _exchange(self, records: bytes, holder: Client) -> bool:
        """Process a cycle of the only client in one message each way.

        Returns:
            True if the cycle was one; else its frames have to be taken one by one.
        """
        answers = self.medium.exchange(holder.port, records) if len(records) > RECORD.size else None
        if answers is None:
            return False
        holder.syncs += 1
        if holder.knows_clock and self.medium.bitrate is not None:
            answers += pack(clock.period_over(holder.syncs))
        for begin in range(0, len(answers), MAX_MESSAGE_BYTES):
            holder.send(answers[begin : begin + MAX_MESSAGE_BYTES])
        self._deliver(self.medium.finish_cycle())
        return True

    def _serve(self, descriptors: Iterable[int]) -> None:
        for descriptor in descriptors:
            if descriptor in self._listeners:
                self._accept(self._listeners[descriptor])
            elif descriptor in self._clients:
                self._read(descriptor)
            else:
                try:
                    self._stop = self._stop or not os.read(descriptor, 4096)
                except OSError:
                    self._stop = True

    def _accept(self, listener: Listener) -> None:
        try:
            sock, _ = listener.listener.accept()
        except OSError:
            return
        if len(self._clients) >= MAX_CLIENTS:
            listener.reject(sock)
            return
        try:
            client = listener.accept(sock, next(self._ports))
        except OSError:  # it has gone already
            sock.close()
            return
        if self._is_wall:
            client.stamp_arrivals()
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
                if self._is_wall and frame.can_id != clock.CLOCK_ID:
                    self._pass_time()
                self._take(frame, client)
            if client is not self._clock:
                return  # one at a time, so that a babbling client does not keep the others out

    def _take(self, frame: Frame, sender: Client) -> None:
        if frame.can_id == clock.CLOCK_ID:
            self._on_question(frame, sender)
            return
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
            over = pack(clock.period_over(sender.syncs)) if has_time else b""
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
        """Send every client the others' frames; the waiting one gets `last`."""
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
            self.time.begin(self.world.now)
        if self._clock is None and self._cores is not None:
            os.sched_setaffinity(0, self._cores)  # the lock-step client may have taken us to its core, and have died

    def close(self) -> None:
        """Close all sockets and remove the path if still ours."""
        for descriptor in list(self._clients):
            self._drop(descriptor)
        self._selector.close()
        for listener in self._listeners.values():
            listener.listener.close()
        with contextlib.suppress(OSError):
            if Path(self.path).stat().st_ino == self._inode:
                Path(self.path).unlink()


def _listen(path: str, *, stream: bool) -> socket.socket:
    """Make a listening socket at the path.

    A socket there that does not answer is left over, and is replaced.

    The socket gets its name once it listens, so that a process that sees the file can connect.
    """
    kinds = [socket.SOCK_STREAM]
    if not stream and hasattr(socket, "SOCK_SEQPACKET"):
        kinds.insert(0, socket.SOCK_SEQPACKET)
    if Path(path).is_socket():
        if _answers(path):
            raise OSError(errno.EADDRINUSE, f"another server answers at {path}")
        Path(path).unlink()
    if Path(path).exists():
        raise OSError(errno.EEXIST, f"{path} is a {'folder' if Path(path).is_dir() else 'file'}; choose another path")
    check_folder(Path(path))
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
    """Restrict the socket to the user who serves it."""
    before = os.umask(0o177)
    try:
        yield
    finally:
        os.umask(before)
