"""An accelerometer on a serial port: a thread that reads it, and what it measured at each SYNC."""

import contextlib
import threading
import time
from collections import deque
from dataclasses import dataclass

import serial

from hil.errors import HilError
from hil.serial_clock import MAX_SAMPLES, AtSync, SampleClock, SampleHistory
from hil.serial_framing import Framing, Sample, Vector

OPEN_TIMEOUT_S = 2.0
"""How long the first sample may take."""
READ_TIMEOUT_S = 0.1
BITS_PER_BYTE = 10
"""On the line: a start bit, eight data bits, a stop bit."""


class SerialAccelerometerError(HilError):
    """The accelerometer cannot be read; nothing has been enabled."""

    exit_code = 5

    def __init__(self, port: str, what: str, remedy: str = "") -> None:
        """Keep the port and what is wrong."""
        self.port, self.what, self.remedy = port, what, remedy
        super().__init__(f"accelerometer on {port}: {what}" + (f"; {remedy}" if remedy else ""))


@dataclass(frozen=True)
class SerialSettings:
    """All that there is to know about the sensor; `hil.master.bench` reads it from a file.

    Attributes:
        port: Its device.
        baud_rate: In bit/s, with 8 data bits, no parity, one stop bit.
        framing: How samples stand in the stream.
        rate_hz: Samples per second.
        delay_s: From the acceleration to the first bit on the line: half the filter's length, and what a USB converter adds.
        at_sync: Which value a SYNC gets.
        max_age_s: Older at the SYNC, a sample says nothing.
        counter_modulo: Where the sensor's counter begins anew, if it sends one.
    """

    port: str
    baud_rate: int
    framing: Framing
    rate_hz: float
    delay_s: float = 0.0
    at_sync: AtSync = "latest"
    max_age_s: float = 0.05
    counter_modulo: int | None = None


class SerialAccelerometer:
    """Reads the sensor from `open` to `close`; the rest of the program asks for the value at a SYNC.

    A sample's time is when its last byte arrived, less what the frame takes on the line, less `delay_s`; `SampleClock` takes the
    operating system's lateness out. Times are the monotonic clock's.

    Attributes:
        settings: What is read, and where.
        overruns: Samples that gave way to newer ones because nobody asked.
    """

    def __init__(self, settings: SerialSettings) -> None:
        """Nothing is opened."""
        self.settings = settings
        self.overruns = 0
        self._decoder = settings.framing.decoder()
        self._clock = SampleClock(settings.rate_hz, settings.counter_modulo)
        self._history = SampleHistory()
        self._queue: deque[tuple[float, Sample]] = deque(maxlen=MAX_SAMPLES)
        self._first = threading.Event()
        self._end = threading.Event()
        self._failure: str | None = None
        self._bytes = self._samples = 0
        self._port: serial.Serial | None = None
        self._thread: threading.Thread | None = None

    @property
    def lost(self) -> int:
        """Samples that the sensor has counted and that have not arrived."""
        return self._clock.lost

    @property
    def errors(self) -> int:
        """Frames with a wrong checksum, and frames that are none."""
        return self._decoder.checksum_errors + self._decoder.malformed

    @property
    def failure(self) -> str | None:
        """Why reading has ended by itself: the port has gone; or None."""
        return self._failure

    def open(self, *, is_lock_step: bool) -> None:
        """Open the port and wait for the first sample.

        Args:
            is_lock_step: Whether the bus counts its time in SYNCs, as `Channel.is_lock_step` says.

        Raises:
            SerialAccelerometerError: No such port, nothing on it, or nothing that can be read; it says which. Or the bus counts
                its time in SYNCs, and no sample can be told to belong to one.
        """
        settings = self.settings
        if is_lock_step:
            raise SerialAccelerometerError(
                settings.port, "it keeps wall-clock time, but time on this bus is counted in SYNCs", "docs/serial.md, Clocks"
            )
        try:
            self._port = serial.Serial(settings.port, settings.baud_rate, timeout=READ_TIMEOUT_S, exclusive=True)
        except (OSError, ValueError) as error:
            raise SerialAccelerometerError(settings.port, str(error)) from error
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._port.set_low_latency_mode(True)  # an FTDI converter else keeps bytes for 16 ms
        self._thread = threading.Thread(target=self._run, args=(self._port,), name="accelerometer", daemon=True)
        self._thread.start()
        if not self._first.wait(OPEN_TIMEOUT_S) or self._failure is not None:
            found = self._diagnosis()
            self.close()
            raise found

    def _diagnosis(self) -> SerialAccelerometerError:
        port, decoder = self.settings.port, self._decoder
        if self._failure is not None:
            return SerialAccelerometerError(port, self._failure)
        if not self._bytes:
            return SerialAccelerometerError(port, f"nothing within {OPEN_TIMEOUT_S:g} s", "is it powered, is this its port?")
        counted = f"{self._bytes} bytes, {decoder.checksum_errors} wrong checksums, {decoder.malformed} malformed frames"
        return SerialAccelerometerError(
            port, f"no sample within {OPEN_TIMEOUT_S:g} s, in {counted}", "check baud_rate, framing, fields, checksum and range"
        )

    def _run(self, port: serial.Serial) -> None:
        settings, decoder, queue = self.settings, self._decoder, self._queue
        frame_bytes = settings.framing.frame_bytes
        byte_s = BITS_PER_BYTE / settings.baud_rate
        while not self._end.is_set():
            try:
                data = port.read(1)
                data += port.read(port.in_waiting) if data else b""
            except (OSError, TypeError, ValueError) as error:  # TypeError: pyserial's, where the port is closed meanwhile
                self._failure = str(error) or "the port has gone"
                self._first.set()
                return
            now = time.monotonic()
            self._bytes += len(data)
            samples = decoder.feed(data)
            if not samples:
                continue
            self._samples += len(samples)
            length = frame_bytes if frame_bytes is not None else self._bytes / self._samples
            arrival = now - length * byte_s - settings.delay_s
            for sample in samples:
                self.overruns += len(queue) == MAX_SAMPLES
                queue.append((self._clock.time_s(arrival, sample.counter), sample))
            self._first.set()

    def value_at_sync(self, sync_s: float) -> Vector | None:
        """What was measured at the SYNC that was sent at this instant of the monotonic clock; None where the sensor is silent."""
        queue = self._queue
        while queue:
            self._history.add(*queue.popleft())
        settings = self.settings
        return self._history.at(sync_s, settings.at_sync, settings.max_age_s)

    def close(self) -> None:
        """Close the port. Again is allowed."""
        self._end.set()
        port, thread = self._port, self._thread
        if port is not None and thread is not None:
            with contextlib.suppress(OSError, AttributeError):
                port.cancel_read()
            thread.join()
            port.close()
        self._port = self._thread = None
