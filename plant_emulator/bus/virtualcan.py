"""The local bus over TCP, in the virtualcan project's format.

It serves CANopen stacks in languages without a client for our socket.

Each message is a length of four bytes, big-endian and always 14, and behind it identifier (4 bytes, big-endian), flags, number of
data bytes, and eight bytes of data, filled up with zeros. Bit 0 of the flags is set where the identifier has 29 bits. The format
has no bit for a remote request: as gocanopen does it, the identifier then carries SocketCAN's ``CAN_RTR_FLAG``. Error frames have
no counterpart and are left out. A client does not receive its own frames.

Source: github.com/windelbouwman/virtualcan (its servers and clients in Python, Rust and C++); gocanopen's virtual bus.
"""

import contextlib
import socket
import struct
from collections.abc import Callable

from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, RECORD, Frame
from plant_emulator.bus.clients import MAX_CLIENTS, Client, Listener
from plant_emulator.bus.server import TURN_FRAMES

MESSAGE = struct.Struct(">IIBB8s")
PAYLOAD_BYTES = 14
EXTENDED = 0x01
"""Bit of the flags: an identifier of 29 bits."""
LOOPBACK = {"localhost": "127.0.0.1", "127.0.0.1": "127.0.0.1", "::1": "::1", "[::1]": "::1"}
MAX_BACKLOG_BYTES = 1 << 18
"""Bytes that a client has not read: 14 563 frames, two seconds of a full bus at 1 Mbit/s. A client with more is dropped."""
_READ_BYTES = TURN_FRAMES * MESSAGE.size
_LENGTH_BYTES = 4


class EndpointError(ValueError):
    """An address at which the bus cannot be served."""


def parse_endpoint(text: str) -> tuple[str, int]:
    """Parse ``[HOST:]PORT`` into host and port; 0 is any free one.

    Raises:
        EndpointError: No port, or a host that others than this machine's own programs reach.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit()) or int(port) > 0xFFFF:
        raise EndpointError(f"{text}: expected [HOST:]PORT, such as 18000 or 127.0.0.1:18000")
    if (host or "localhost") not in LOOPBACK:
        raise EndpointError(
            f"{text}: expected the host 127.0.0.1, ::1 or localhost; the port commands the robot without a password"
        )
    return LOOPBACK[host or "localhost"], int(port)


def encode(frame: Frame) -> bytes:
    """Return a frame as a message; b"" if the format has none."""
    can_id, data = frame
    if can_id & CAN_ERR_FLAG:
        return b""
    flags = EXTENDED if can_id & CAN_EFF_FLAG else 0
    return MESSAGE.pack(PAYLOAD_BYTES, can_id & ~CAN_EFF_FLAG, flags, len(data), data)


class Messages:
    """Parser of a client's messages, sans IO.

    The first invalid message ends the connection, since the following bytes cannot be trusted.

    Attributes:
        refused: Reason for its end; None while it lasts.
    """

    def __init__(self) -> None:
        self.refused: str | None = None
        self._rest = b""

    def receive(self, data: bytes) -> list[Frame]:
        """Process received bytes; return the complete frames."""
        frames: list[Frame] = []
        self._rest += data
        while self.refused is None and len(self._rest) >= _LENGTH_BYTES:
            length = int.from_bytes(self._rest[:_LENGTH_BYTES], "big")
            if length != PAYLOAD_BYTES:
                self.refused = f"a message of {length} bytes; expected {PAYLOAD_BYTES}"
            elif len(self._rest) < MESSAGE.size:
                return frames
            else:
                message, self._rest = self._rest[: MESSAGE.size], self._rest[MESSAGE.size :]
                frame = self._frame(message)
                if frame is not None:
                    frames.append(frame)
        if self.refused is not None:
            self._rest = b""
        return frames

    def _frame(self, message: bytes) -> Frame | None:
        _, can_id, flags, length, data = MESSAGE.unpack(message)
        is_extended = bool(flags & EXTENDED or can_id & CAN_EFF_FLAG)
        if length > MAX_DATA_LENGTH:
            self.refused = f"a frame of {length} data bytes"
        elif can_id & CAN_ERR_FLAG or can_id & CAN_EFF_MASK > (CAN_EFF_MASK if is_extended else CAN_SFF_MASK):
            self.refused = f"identifier {can_id:X}h with flags {flags:02X}h"
        else:
            remote = can_id & CAN_RTR_FLAG
            identifier = can_id & CAN_EFF_MASK | remote | (CAN_EFF_FLAG if is_extended else 0)
            return Frame(identifier, bytes(length) if remote else data[:length])
        return None


class VirtualcanClient(Client):
    """A participant over TCP.

    It is dropped if it sends anything but messages, or does not read its own.
    """

    def __init__(self, sock: socket.socket, port: int, over: Callable[[str], None]) -> None:
        super().__init__(sock, port)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.may_be_clock = False  # a program behind a TCP port keeps wall-clock time
        self._messages = Messages()
        self._over = over

    def send(self, record: bytes) -> None:
        """Deliver one record."""
        self.send_all([record])

    def send_all(self, records: list[bytes]) -> None:
        """Deliver records as messages.

        Bytes that do not fit wait; beyond a bound the client is dropped.
        """
        if self.is_over:
            return
        for record in records:
            can_id, length, data = RECORD.unpack(record)
            self._backlog += encode(Frame(can_id, data[:length]))
        self.flush()
        if len(self._backlog) > MAX_BACKLOG_BYTES:
            self._end(f"it has not read {len(self._backlog) // MESSAGE.size} frames")

    def receive(self) -> list[Frame] | None:
        """Return the received frames; None if the client is gone."""
        if self.is_over:
            return None
        try:
            data = self.socket.recv(_READ_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return []
        except OSError:
            return None
        frames = self._messages.receive(data)
        if self._messages.refused is not None:
            self._end(self._messages.refused)
        return frames if data else None

    def _end(self, reason: str) -> None:
        self.is_over = True
        self._over(reason)


class VirtualcanListener(Listener):
    """A TCP port that joins participants to the local bus by `Server.open`.

    Attributes:
        endpoint: Host and port, also where any free port was asked for.
    """

    def __init__(self, host: str, port: int, tell: Callable[[str], None] = lambda _: None) -> None:
        """Listen.

        Args:
            host: One of this machine's loopback addresses, as `parse_endpoint` gives it.
            port: 0 for any that is free.
            tell: Called with a line about every client that is dropped or rejected.

        Raises:
            EndpointError: The host is none of this machine's own.
            OSError: The port cannot be had.
        """
        if host not in LOOPBACK.values():
            raise EndpointError(f"{host}:{port}: expected the host 127.0.0.1 or ::1")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__(socket.create_server((host, port), family=family, backlog=MAX_CLIENTS))
        self.endpoint: tuple[str, int] = (host, self.listener.getsockname()[1])
        self._tell = tell

    def __str__(self) -> str:
        host, port = self.endpoint
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    def accept(self, sock: socket.socket, port: int) -> Client:
        """Make a participant of a new connection."""
        name = _name(sock)
        return VirtualcanClient(sock, port, lambda reason: self._say(f"virtualcan client {name} is dropped: {reason}"))

    def reject(self, sock: socket.socket) -> None:
        """Refuse a client beyond the largest number."""
        with contextlib.closing(sock), contextlib.suppress(OSError):  # where it has gone already it has no name
            self._say(f"virtualcan client {_name(sock)} is rejected: {MAX_CLIENTS} clients are on the bus already")

    def _say(self, line: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody reads standard error any more
            self._tell(line)


def _name(sock: socket.socket) -> str:
    host, port = sock.getpeername()[:2]
    return f"{host}:{port}"
