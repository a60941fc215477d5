"""A serial CAN adapter in front of the local bus.

It uses the slcan (LAWICEL) protocol on a pseudo-terminal.

Source: LAWICEL CANUSB manual, version 1.0D; the commands of a CAN232 that it leaves out (X, P, A) are taken from that one's.
"""

import re
import selectors
import socket
import threading
import time
from collections import deque

from hil.can import clock
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, RECORD, Frame, pack, unpack
from plant_emulator.serial.pseudo_terminal import MAX_BACKLOG_BYTES, PseudoTerminal

OK, BELL = b"\r", b"\a"
VERSION, SERIAL_NUMBER = b"V1013", b"NHILB"
BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of the commands S0 to S8."""
MAX_COMMAND = 30
"""Longest command is T with eight bytes, 26 characters; more in one line is not a command."""
POLL_FRAMES = 32
"""Frames that are kept for a host that polls."""
TIME_STAMP_WRAP_MS = 60_000
SEND_TIMEOUT_S = 1.0
TURN_FRAMES = 64

RECEIVE_FULL, TRANSMIT_FULL, DATA_OVERRUN, BUS_ERROR = 0x01, 0x02, 0x08, 0x80
"""Bits of the answer to F."""

_FRAME = re.compile(rb"(?:[tr](?P<short>[0-7][0-9A-Fa-f]{2})|[TR](?P<long>[01][0-9A-Fa-f]{7}))(?P<length>[0-8])(?P<data>.*)")
_RATE = re.compile(rb"S[0-8]|s[0-9A-Fa-f]{4}")
_HEX = re.compile(rb"(?:[0-9A-Fa-f]{2})*")


class Adapter:
    """The adapter's side of the protocol, sans IO.

    At another bit rate than that of the bus nothing passes, and F reports bus errors. A bus without a bit rate accepts any, and
    a rate that is set by the registers of s is assumed to be right.

    Acceptance code and mask apply to identifiers and the remote bit, as in the SJA1000's two filters; their conditions on data
    bytes are ignored.

    Attributes:
        bus_bitrate: Bit rate of the bus in bit/s; None: the bus has none.
        is_open: True while frames pass.
        refused: Commands that were answered by BEL.
    """

    def __init__(self) -> None:
        self.bus_bitrate: int | None = None
        self.is_open = False
        self.refused = 0
        self._bitrate: int | None = None
        self._listen_only = False
        self._has_rate = False
        self._has_time_stamps = False
        self._polls = False
        self._code, self._mask = 0, 0xFFFF_FFFF
        self._flags = 0
        self._line = bytearray()
        self._overlong = False
        self._waiting: deque[bytes] = deque(maxlen=POLL_FRAMES)

    # -- from the host ---------------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> tuple[bytes, list[Frame]]:
        """Process bytes of the host; return answers and frames.

        The frames are for the bus. A line that is not a command is answered by BEL, and the next one is read normally.
        """
        answers, frames = bytearray(), []
        for byte in data:
            if byte != 0x0D:
                self._collect(byte)
                continue
            line, overlong = bytes(self._line), self._overlong
            self._line.clear()
            self._overlong = False
            answer, frame = (BELL, None) if overlong else self._command(line)
            self.refused += answer == BELL
            answers += answer
            if frame is not None:
                frames.append(frame)
        return bytes(answers), frames

    def _collect(self, byte: int) -> None:
        if byte == 0x0A and not self._line:
            return  # hosts that end their lines with both
        if len(self._line) >= MAX_COMMAND:
            self._overlong = True
        else:
            self._line.append(byte)

    def _command(self, line: bytes) -> tuple[bytes, Frame | None]:
        name, arguments = line[:1], line[1:]
        if name in b"tTrR" and name:
            return self._transmit(line)
        if name in b"OLCFVNPA" and arguments:
            return BELL, None
        match name:
            case b"":
                return OK, None  # hosts send some to empty what stands in the line
            case b"V":
                return VERSION + OK, None
            case b"N":
                return SERIAL_NUMBER + OK, None
            case b"O" | b"L":
                return self._open(listen_only=name == b"L"), None
            case b"C":
                return self._close(), None
            case b"F" | b"P" | b"A":
                return (self._while_open(name) if self.is_open else BELL), None
            case _:
                return (OK if not self.is_open and self._set(name, arguments) else BELL), None

    def _open(self, *, listen_only: bool) -> bytes:
        if self.is_open or not self._has_rate:
            return BELL
        self.is_open, self._listen_only, self._flags = True, listen_only, 0
        return OK

    def _close(self) -> bytes:
        if not self.is_open:
            return BELL
        self.is_open = False
        self._waiting.clear()
        return OK

    def _while_open(self, name: bytes) -> bytes:
        if name == b"F":
            flags, self._flags = self._flags, 0
            return b"F%02X\r" % flags
        if not self._polls:
            return BELL
        if name == b"P":
            return self._waiting.popleft() if self._waiting else OK
        every = b"".join(self._waiting)
        self._waiting.clear()
        return every + b"A\r"

    def _set(self, name: bytes, arguments: bytes) -> bool:
        """Process a setting of a closed adapter; return True for one."""
        if _RATE.fullmatch(name + arguments):
            self._has_rate = True
            self._bitrate = BITRATES[int(arguments)] if name == b"S" else None
        elif name == b"Z" and arguments in {b"0", b"1"}:
            self._has_time_stamps = arguments == b"1"
        elif name == b"X" and arguments in {b"0", b"1"}:
            self._polls = arguments == b"0"
        elif name in {b"M", b"m"} and re.fullmatch(rb"[0-9A-Fa-f]{8}", arguments):
            if name == b"M":
                self._code = int(arguments, 16)
            else:
                self._mask = int(arguments, 16)
        else:
            return False
        return True

    def _transmit(self, line: bytes) -> tuple[bytes, Frame | None]:
        found = _FRAME.fullmatch(line)
        if found is None or not self.is_open or self._listen_only:
            return BELL, None
        length = int(found["length"])
        can_id = int(found["short"], 16) if found["short"] is not None else int(found["long"], 16) | CAN_EFF_FLAG
        if line[:1] in b"rR":
            if found["data"]:
                return BELL, None
            frame = Frame(can_id | CAN_RTR_FLAG, bytes(length))  # of a remote request the length is all there is
        elif len(found["data"]) == 2 * length and _HEX.fullmatch(found["data"]):
            frame = Frame(can_id, bytes.fromhex(found["data"].decode("ascii")))
        else:
            return BELL, None
        done = OK if self._polls else b"Z\r" if can_id & CAN_EFF_FLAG else b"z\r"
        if not self._is_tuned():
            self._flags |= BUS_ERROR
            return done, None
        return done, frame

    def _is_tuned(self) -> bool:
        return self.bus_bitrate is None or self._bitrate is None or self._bitrate == self.bus_bitrate

    # -- from the bus ----------------------------------------------------------------------------------------------------

    def deliver(self, frame: Frame, now_ms: int) -> bytes:
        """Return the host's line for a frame of the bus, or b""."""
        can_id, data = frame
        if not self.is_open:
            return b""
        if can_id & CAN_ERR_FLAG or not self._is_tuned():
            self._flags |= BUS_ERROR
            return b""
        if not self._accepts(can_id):
            return b""
        is_remote = bool(can_id & CAN_RTR_FLAG)
        if can_id & CAN_EFF_FLAG:
            text = f"{'R' if is_remote else 'T'}{can_id & CAN_EFF_MASK:08X}{len(data)}"
        else:
            text = f"{'r' if is_remote else 't'}{can_id & 0x7FF:03X}{len(data)}"
        if not is_remote:
            text += data.hex().upper()
        if self._has_time_stamps:
            text += f"{now_ms % TIME_STAMP_WRAP_MS:04X}"
        line = text.encode("ascii") + OK
        if not self._polls:
            return line
        if len(self._waiting) == POLL_FRAMES:
            self._flags |= RECEIVE_FULL | DATA_OVERRUN
        self._waiting.append(line)
        return b""

    def note(self, flags: int) -> None:
        """Keep an error for the next F command."""
        self._flags |= flags

    def _accepts(self, can_id: int) -> bool:
        """Apply the two 16-bit acceptance filters of the SJA1000.

        The first is in the upper half; a bit set in the mask is ignored.
        """
        if can_id & CAN_EFF_FLAG:
            seen, ignored = (can_id & CAN_EFF_MASK) >> 13, 0x0000
        else:
            remote = 0x10 if can_id & CAN_RTR_FLAG else 0
            seen, ignored = (can_id & 0x7FF) << 5 | remote, 0x000F  # the lower bits look into the first data byte
        return any(not (seen ^ self._code >> shift) & ~(self._mask >> shift | ignored) & 0xFFFF for shift in (16, 0))


class SlcanPort:
    """An adapter on a pseudo-terminal, in a thread, as one bus participant.

    Frames that the host does not read in time are dropped and reported by F. The host's bytes wait in the terminal while its
    answers are unread.
    """

    def __init__(self, terminal: PseudoTerminal, connection: socket.socket) -> None:
        """Start serving.

        Args:
            terminal: Its owner closes it, after this.
            connection: Connected to the local bus; `close` closes it.
        """
        self.terminal, self._connection = terminal, connection
        self._connection.settimeout(SEND_TIMEOUT_S)
        self._connection.sendall(pack(clock.question(follows=True)))  # a host behind a serial port keeps wall-clock time
        self._is_stream = connection.type == socket.SOCK_STREAM
        self._received = b""
        self._adapter = Adapter()
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="slcan", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        terminal = self.terminal
        with selectors.DefaultSelector() as selector:
            selector.register(self._connection, selectors.EVENT_READ, self._from_bus)
            selector.register(terminal, selectors.EVENT_READ, self._from_host)
            selector.register(self._woken, selectors.EVENT_READ, lambda: False)
            while True:
                for key, events in selector.select():
                    if events & selectors.EVENT_READ and not key.data():
                        return
                terminal.flush()
                # a host that writes and does not read is not read either, until there is room
                reads = 0 if terminal.backlog > MAX_BACKLOG_BYTES else selectors.EVENT_READ
                writes = selectors.EVENT_WRITE if terminal.backlog else 0
                selector.modify(terminal, reads | writes, self._from_host)

    def _from_host(self) -> bool:
        was_open = self._adapter.is_open
        answers, frames = self._adapter.receive(self.terminal.read())
        if was_open and not self._adapter.is_open:
            self.terminal.discard_after(OK)  # the next host is not shown what the last one has not read
        for frame in frames:
            try:
                self._connection.sendall(pack(frame))
            except TimeoutError:
                self._adapter.note(TRANSMIT_FULL)
            except OSError:
                return False
        if answers:
            self.terminal.write(answers, must=True)
        return True

    def _from_bus(self) -> bool:
        try:
            data = self._connection.recv(TURN_FRAMES * RECORD.size if self._is_stream else RECORD.size)
        except OSError:
            return False
        if not data:
            return False
        self._received += data
        now_ms = time.monotonic_ns() // 1_000_000
        while len(self._received) >= RECORD.size:
            frame = unpack(self._received[: RECORD.size])
            self._received = self._received[RECORD.size :]
            if frame is None:
                continue
            if frame.can_id == clock.CLOCK_ID:
                answer = clock.read_answer(frame.data)
                self._adapter.bus_bitrate = None if answer is None else answer[1]
                continue
            line = self._adapter.deliver(frame, now_ms)
            if line and not self.terminal.write(line):
                self._adapter.note(RECEIVE_FULL | DATA_OVERRUN)
        return True

    def close(self) -> None:
        """Leave the bus."""
        self._wake.close()
        self._thread.join()
        self._woken.close()
        self._connection.close()
