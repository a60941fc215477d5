"""Accelerometer on a serial port: reading thread, and measurement at each SYNC."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

import serial

from hil.errors import HilError
from hil.sensor.clock import MAX_SAMPLES, SampleClock, SampleHistory
from hil.sensor.framing import Sample, Vector
from hil.sensor.table import SerialTable

OPEN_TIMEOUT_S = 2.0
"""Time that the first sample may take."""
READ_TIMEOUT_S = 0.1
BITS_PER_BYTE = 10
"""Bits on the line for each byte: a start bit, eight data bits, a stop bit."""


class SerialAccelerometerError(HilError):
    """The accelerometer cannot be read; nothing has been enabled."""

    exit_code = 5

    def __init__(self, port: str, what: str, remedy: str = "") -> None:
        self.port, self.what, self.remedy = port, what, remedy
        super().__init__(f"accelerometer on {port}: {what}" + (f"; {remedy}" if remedy else ""))


class AccelerometerReader:
    """Reader of the sensor, from `open` to `close`.

    The rest of the program asks it for the value at a SYNC. The time of a sample is the arrival of its last byte, less the
    frame's duration on the line, less `delay_s`; `SampleClock` removes the lateness of the operating system.

    Args:
        settings: Port, framing and timing of the sensor.
        now: The clock of all times, in s; the monotonic clock unless it is given.

    Attributes:
        overruns: Samples that newer ones have replaced before they were read.
    """

    def __init__(self, settings: SerialTable, now: Callable[[], float] = time.monotonic) -> None:
        self.settings, self._now = settings, now
        self.overruns = 0
        self._framing = settings.layout()
        self._decoder = self._framing.decoder()
        self._clock = SampleClock(settings.sample_rate_hz, settings.modulo())
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
        """Number of samples that the sensor counted, but that did not arrive."""
        return self._clock.lost

    @property
    def errors(self) -> int:
        """Number of frames with a wrong checksum or a wrong content."""
        return self._decoder.checksum_errors + self._decoder.malformed

    @property
    def failure(self) -> str | None:
        """Error that ended the reading, or None; the port is gone then."""
        return self._failure

    def open(self, *, is_lock_step: bool) -> None:
        """Open the port and wait for the first sample.

        On a lock-step bus time counts in SYNCs (`Channel.is_lock_step`).

        Raises:
            SerialAccelerometerError: The port does not exist, or gives no bytes, or no readable samples; the message says
                which. Or the bus counts its time in SYNCs, to which no sample can be assigned.
        """
        settings = self.settings
        if is_lock_step:
            raise SerialAccelerometerError(
                settings.port, "it needs wall-clock time, but this bus counts time in SYNCs", "docs/serial.md, Clocks"
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
            failure = self._diagnosis()
            self.close()
            raise failure

    def _diagnosis(self) -> SerialAccelerometerError:
        port, decoder = self.settings.port, self._decoder
        if self._failure is not None:
            return SerialAccelerometerError(port, self._failure)
        if not self._bytes:
            return SerialAccelerometerError(port, f"nothing within {OPEN_TIMEOUT_S:g} s", "check power and port")
        counted = f"{self._bytes} bytes, {decoder.checksum_errors} wrong checksums, {decoder.malformed} malformed frames"
        return SerialAccelerometerError(
            port, f"no sample within {OPEN_TIMEOUT_S:g} s, in {counted}", "check baud_rate, framing, fields, checksum and range"
        )

    def _run(self, port: serial.Serial) -> None:
        settings, decoder, queue = self.settings, self._decoder, self._queue
        frame_bytes = self._framing.frame_bytes
        byte_s = BITS_PER_BYTE / settings.baud_rate
        while not self._end.is_set():
            try:
                data = port.read(1)
                data += port.read(port.in_waiting) if data else b""
            except (OSError, TypeError, ValueError) as error:  # TypeError: pyserial's, where the port is closed meanwhile
                self._failure = str(error) or "the port has gone"
                self._first.set()
                return
            now = self._now()
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
        """Return the measurement for the SYNC at this instant, None if silent."""
        queue = self._queue
        while queue:
            self._history.add(*queue.popleft())
        settings = self.settings
        return self._history.at(sync_s, settings.at_sync, settings.max_age_s)

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        self._end.set()
        port, thread = self._port, self._thread
        if port is not None and thread is not None:
            with contextlib.suppress(OSError, AttributeError):
                port.cancel_read()
            thread.join()
            port.close()
        self._port = self._thread = None
