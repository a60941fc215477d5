"""The accelerometer on a serial port: framing and times as properties, the reader on real pseudo-terminals."""

import contextlib
import itertools
import math
import os
import queue
import struct
import threading
import time
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drive_profiles.files.toml import FileError, loads
from hil.bench.bench import REFERENCE, Bench
from hil.sensor import accelerometer
from hil.sensor.accelerometer import AccelerometerReader, SerialAccelerometerError
from hil.sensor.clock import PHASE_SAMPLES, SampleClock, SampleHistory
from hil.sensor.framing import CHECKSUMS, BinaryFraming, Fields, LineFraming, Sample, crc16_modbus, sum8, xor8
from hil.sensor.table import SerialTable
from plant_emulator.serial.accelerometer import binary_frame, line_frame
from plant_emulator.serial.pseudo_terminal import PseudoTerminal
from tests.plant_emulator.serial.test_accelerometer import served

FIELDS = Fields(("-", "counter", "x", "y", "z"), (1.0, 1.0, 1.0), 100.0)
LINE = LineFraming(FIELDS, prefix="$", checksum="xor")
PLAIN = LineFraming(Fields(("x", "y", "z"), (9.80665, 9.80665, -9.80665), 100.0))
BINARY = BinaryFraming(Fields(("counter", "x", "y", "z"), (1e-3,) * 3, 100.0), b"\xaa\x55", "<Hhhh", "crc16-modbus")
LINE_TOML = """port = "PORT"
baud_rate = 921600
framing = "line"
prefix = "$"
fields = ["-", "counter", "x", "y", "z"]
checksum = "xor"
counter_modulo = 65536
sample_rate_hz = 1000
"""
BINARY_TOML = """port = "PORT"
baud_rate = 460800
framing = "binary"
sync = "AA 55"
format = "<Hhhh"
fields = ["counter", "x", "y", "z"]
scale_m_s2 = [0.001, 0.001, 0.001]
checksum = "crc16-modbus"
frame_bytes = 12
sample_rate_hz = 1000
"""

accelerations = st.tuples(*[st.floats(-30.0, 30.0).map(lambda v: round(v, 3))] * 3)
chunks = st.lists(st.binary(max_size=60), max_size=12)


# -- checksums ---------------------------------------------------------------------------------------------------------


def test_checksums_are_the_published_ones():
    assert crc16_modbus(b"123456789") == 0x4B37  # the check value of every catalogue
    assert crc16_modbus(bytes.fromhex("010300000001")) == 0x0A84  # a Modbus request: 01 03 00 00 00 01 84 0A
    assert xor8(b"GPGLL,5300.97914,N,00259.98174,E,125926,A") == 0x28  # u-blox' example of NMEA 0183
    assert sum8(b"\xff\x02") == 0x01


# -- framing -----------------------------------------------------------------------------------------------------------


@given(chunks, st.sampled_from([LINE, PLAIN, BINARY]))
def test_any_bytes_in_any_pieces_never_raise_and_pieces_do_not_matter(parts, framing):
    pieces, whole = framing.decoder(), framing.decoder()
    found = [sample for part in parts for sample in pieces.feed(part)]
    assert found == whole.feed(b"".join(parts))
    assert (pieces.checksum_errors, pieces.malformed) == (whole.checksum_errors, whole.malformed)
    assert all(math.isfinite(v) and abs(v) <= 100.0 for sample in found for v in sample.acceleration_m_s2)


def false_frames(stream, framing, true):
    """Places at which something else than a frame of ours has sync bytes and a right checksum."""
    length = framing.frame_bytes
    return [
        at
        for at in range(len(stream) - length + 1)
        if at not in true
        and stream[at : at + 2] == framing.sync
        and crc16_modbus(stream[at : at + length - 2]) == int.from_bytes(stream[at + length - 2 : at + length], "little")
    ]


noise = st.lists(st.sampled_from([b"\xaa", b"\x55", b"\xaa\x55", b"\0", b"$", b"*00", b"\xaa\x55\x01\x02"]), max_size=12).map(
    b"".join
)


@pytest.mark.ci
@settings(max_examples=300)
@given(st.lists(st.tuples(noise, accelerations), max_size=6), noise, st.integers(1, 30))
def test_no_binary_frame_is_lost_in_garbage(parts, tail, step):
    stream, true = b"", set()
    for counter, (garbage, acceleration) in enumerate(parts):
        stream += garbage
        true.add(len(stream))
        stream += binary_frame(counter, acceleration)
    stream += tail
    assume(not false_frames(stream, BINARY, true))
    decoder = BINARY.decoder()
    found = [sample for at in range(0, len(stream), step) for sample in decoder.feed(stream[at : at + step])]
    assert [sample.counter for sample in found] == list(range(len(parts)))
    for sample, (_, acceleration) in zip(found, parts, strict=True):
        assert sample.acceleration_m_s2 == pytest.approx(acceleration, abs=5.1e-4)


@settings(max_examples=300)
@given(st.lists(st.tuples(st.binary(max_size=40), accelerations), min_size=1, max_size=6))
def test_of_two_lines_behind_garbage_the_second_at_least_is_found(parts):
    stream = b""
    for counter, (garbage, acceleration) in enumerate(parts):
        assume(b"*" not in garbage)  # or a checksum can be faked: one of 256 is right
        stream += garbage + line_frame(2 * counter, acceleration) + line_frame(2 * counter + 1, acceleration)
    found = {sample.counter: sample for sample in LINE.decoder().feed(stream)}
    for counter, (_, acceleration) in enumerate(parts):
        assert found[2 * counter + 1].acceleration_m_s2 == pytest.approx(acceleration, abs=1e-5)


@given(accelerations, st.integers(0, 11), st.integers(0, 7))
def test_a_wrong_bit_is_counted_and_costs_one_frame(acceleration, byte, bit):
    broken = bytearray(binary_frame(1, acceleration))
    broken[byte] ^= 1 << bit
    decoder = BINARY.decoder()
    found = decoder.feed(binary_frame(0, acceleration) + bytes(broken) + binary_frame(2, acceleration))
    assert [sample.counter for sample in found] == [0, 2]
    assert byte < 2 or decoder.checksum_errors >= 1  # without its sync bytes nobody knows that it was one


@pytest.mark.parametrize("checksum", ["none", "xor", "sum8", "crc16-modbus"])
@pytest.mark.parametrize("place", ["end", "start"])
@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("covers", [True, False])
def test_a_checksum_is_found_where_it_is_said_to_be(checksum, place, order, covers):
    framing = BinaryFraming(Fields(("x", "y", "z"), (1.0,) * 3, 100.0), b"\x7e", ">fff", checksum, place, order, covers)
    body = struct.pack(">fff", 1.0, -2.0, 3.5)
    function, size = CHECKSUMS[checksum]
    check = function((b"\x7e" if covers else b"") + body).to_bytes(size, order)
    frame = b"\x7e" + (body + check if place == "end" else check + body)
    assert len(frame) == framing.frame_bytes
    decoder = framing.decoder()
    assert decoder.feed(b"\0" + frame + frame) == [Sample((1.0, -2.0, 3.5), None)] * 2
    assert decoder.checksum_errors == decoder.malformed == 0


@pytest.mark.parametrize(
    "line",
    ["1,2", "1,2,3,4", "1,2,nan", "1,2,inf", "1,2,1e999", "1,2,0x3", "1,2,1_0", "1,2,", "1;2;3", "1,2,20", "hello", "١,٢,٣"],
)
def test_a_line_that_is_no_measurement_is_counted(line):
    decoder = PLAIN.decoder()
    assert decoder.feed(f"\n{line}\n0.5, -1e0,+.25\r\n".encode()) == [Sample((0.5 * 9.80665, -9.80665, -0.25 * 9.80665), None)]
    assert decoder.malformed == 1


def test_half_a_line_at_the_beginning_is_no_sample():
    assert PLAIN.decoder().feed(b"1,2,3\n1,1,1\n") == [Sample((9.80665, 9.80665, -9.80665), None)]
    assert len(PLAIN.decoder().feed(b"1" * 5000 + b"\n1,1,1\n")) == 1


def test_spaces_may_separate():
    framing = LineFraming(Fields(("x", "y", "z"), (1.0,) * 3, 100.0), separator=" ")
    assert framing.decoder().feed(b"\n  1.0   2.0 3.0 \n") == [Sample((1.0, 2.0, 3.0), None)]


# -- times -------------------------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.floats(0.0, 0.1), st.integers(0, 65535)), max_size=200), st.booleans())
def test_times_never_go_back_and_never_lie_after_the_arrival(steps, counted):
    clock, arrival, last = SampleClock(1000.0, 65536 if counted else None), 0.0, -math.inf
    for wait, counter in steps:
        arrival += wait
        time_s = clock.time_s(arrival, counter if counted else None)
        assert last <= time_s <= arrival + 1e-9
        last = time_s


@given(st.lists(st.integers(0, 20), max_size=300), st.sets(st.integers(1, 290), max_size=20))
def test_a_time_is_as_late_as_the_least_late_of_the_last_arrivals(late_ms, lost):
    clock, arrival, late = SampleClock(1000.0, 65536), 0.0, []
    arrived = [number for number in range(len(late_ms)) if number not in lost]
    for number in arrived:
        arrival = max(arrival, 1e-3 * (number + late_ms[number]))  # none overtakes another
        late.append(arrival - 1e-3 * number)
        assert clock.time_s(arrival, number) - 1e-3 * number == pytest.approx(min(late[-PHASE_SAMPLES:]), abs=1e-9)
    if arrived:
        assert clock.lost == arrived[-1] + 1 - len(arrived)


def test_a_burst_is_spread_over_the_periods_in_which_it_was_taken():
    clock = SampleClock(1000.0)
    times = [clock.time_s(0.016 * (1 + number // 16)) for number in range(160)]
    steady = times[32:]
    assert all(b - a == pytest.approx(1e-3, abs=1e-9) for a, b in itertools.pairwise(steady))
    assert steady[-1] == pytest.approx(0.16, abs=1e-9)  # the last of a burst arrives when it is taken


def test_a_sensor_that_was_silent_gets_a_new_phase():
    clock = SampleClock(1000.0)
    for number in range(100):
        clock.time_s(number * 1e-3)
    assert clock.time_s(5.0) == pytest.approx(5.0)


def test_a_sensor_that_starts_anew_has_lost_nothing():
    clock = SampleClock(1000.0, 65536)
    for number in range(5000, 5100):
        clock.time_s(number * 1e-3, number)
    assert clock.time_s(5.1, 0) == pytest.approx(5.1)
    assert clock.lost == 0


def test_a_sync_gets_the_sample_taken_by_then_or_what_lies_between():
    history = SampleHistory()
    assert history.at(0.0, "latest", 1.0) is None
    for number in range(5000):
        history.add(number * 1e-3, Sample((float(number), 0.0, -float(number)), None))
    assert history.at(4.9995, "latest", 0.01) == (4999.0, 0.0, -4999.0)
    assert history.at(4.9975, "latest", 0.01) == (4997.0, 0.0, -4997.0)
    assert history.at(4.9975, "interpolated", 0.01) == pytest.approx((4997.5, 0.0, -4997.5))
    assert history.at(4.9995, "interpolated", 0.01) == (4999.0, 0.0, -4999.0)  # the next one has not come
    assert history.at(5.02, "latest", 0.01) is None  # silent
    assert history.at(0.5, "latest", 0.01) is None  # forgotten
    assert len(history._times) <= 2048


# -- the bench file ----------------------------------------------------------------------------------------------------


def table(text):
    return loads(text, SerialTable, "bench.toml")


def test_both_tables_are_read():
    line, binary = table(LINE_TOML), table(BINARY_TOML)
    assert line.layout() == LINE or line.layout().fields.range_m_s2 == 1000.0
    assert isinstance(binary.layout(), BinaryFraming)
    assert binary.layout().frame_bytes == 12
    assert (line.modulo(), binary.modulo()) == (65536, 65536)


@pytest.mark.parametrize(
    ("text", "before", "after", "says"),
    [
        (LINE_TOML, '"z"]', '"x"]', "'x' 2 times"),
        (LINE_TOML, '"-", ', '"time", ', "fields name 'time'"),
        (LINE_TOML, "counter_modulo = 65536\n", "", "needs counter_modulo"),
        (LINE_TOML, '"counter", ', "", "needs a counter"),
        (LINE_TOML, 'prefix = "$"', 'sync = "AA"', "framing 'line' has no sync"),
        (LINE_TOML, '"xor"', '"crc32"', "one of"),
        (BINARY_TOML, "frame_bytes = 12", "frame_bytes = 13", "make 12"),
        (BINARY_TOML, "<Hhhh", "Hhhh", "'<' or '>'"),
        (BINARY_TOML, "<Hhhh", "<Hhhhh", "has 5 numbers"),
        (BINARY_TOML, "<Hhhh", "<H99999999999999999999xhhh", "format"),
        (BINARY_TOML, "<Hhhh", "<H999999999xhhh", "the limit is 256"),
        (BINARY_TOML, "<Hhhh", "<hhhh", "needs counter_modulo"),
        (BINARY_TOML, 'sync = "AA 55"', "", "needs sync and format"),
        (BINARY_TOML, "460800", "115200", "need baud_rate = 120000"),
        (BINARY_TOML, "[0.001, 0.001, 0.001]", "[0.001, 0, 0.001]", "has a 0"),
        (BINARY_TOML, "frame_bytes = 12", "max_age_s = 0.001", "less than two samples"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(text, before, after, says):
    assert before in text
    with pytest.raises(FileError, match=says.replace("(", r"\(")):
        table(text.replace(before, after))


def bench(accelerometer):
    text = REFERENCE.read_text()
    before = '[accelerometer]\nnode_id = 16\nprofile = "emulated_accelerometer"\n'
    assert before in text
    return loads(text.replace(before, accelerometer), Bench, "bench.toml")


def test_a_bench_has_a_node_or_a_serial_port():
    assert bench("[accelerometer]\nnode_id = 16\n").accelerometer.node_id == 16
    serial = bench("[accelerometer.serial]\n" + LINE_TOML).accelerometer
    assert serial.serial.sample_rate_hz == 1000.0
    assert serial.node_id is None
    for table in (LINE_TOML, BINARY_TOML):
        whole = bench("[accelerometer.serial]\n" + table)
        assert Bench.model_validate_json(whole.model_dump_json()) == whole  # as a result keeps it and the report reads it
    node = bench("[accelerometer]\nnode_id = 16\n")
    assert Bench.model_validate_json(node.model_dump_json()) == node
    for wrong, says in (
        ("[accelerometer]\n", "needs either a node_id"),
        ("[accelerometer]\nnode_id = 16\n[accelerometer.serial]\n" + LINE_TOML, "needs either a node_id"),
        ("[accelerometer]\nnode_id = 127\n", "accelerometer.node_id: node-ID 127 is given twice on this bus: bus.master_node_id"),
        ("[accelerometer.serial]\n" + LINE_TOML.replace("baud_rate", "baudrate"), "did you mean baud_rate"),
    ):
        with pytest.raises(FileError, match=says):
            bench(wrong)


# -- the reader --------------------------------------------------------------------------------------------------------


@pytest.fixture
def terminal():
    terminal = PseudoTerminal()
    yield terminal
    terminal.close()


class Sensor:
    """Writes frames at 1 kHz into a pseudo-terminal from a thread; x is the time at which it is written."""

    def __init__(self, terminal, frame=binary_frame):
        self.terminal, self.frame = terminal, frame
        self.began = time.monotonic()
        self.skip = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        number = 0
        while not self._end.wait(max(0.0, self.began + number * 1e-3 - time.monotonic())):
            number += 1 + self.skip
            self.skip = 0
            self.terminal.write(self.frame(number % 65536, (1e-3 * (number % 8192), 0.0, -1.0)))

    def stop(self):
        self._end.set()
        self._thread.join()


@contextlib.contextmanager
def reading(toml, terminal, **changes):
    text = toml.replace("PORT", terminal if isinstance(terminal, str) else terminal.path)
    reader = AccelerometerReader(table(text).model_copy(update=changes))
    reader.open(is_lock_step=False)
    try:
        yield reader
    finally:
        reader.close()


@pytest.fixture
def sensor(terminal):
    sensor = Sensor(terminal)
    yield sensor
    sensor.stop()


def wait_for(happened, timeout_s=10.0):
    deadline = time.monotonic() + timeout_s
    while not happened():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.002)


class ScriptedPort:
    """A port in the test's own time: `write` says when the operating system hands over the bytes."""

    def __init__(self):
        self.now_s = 100.0
        self._written = queue.Queue()
        self._data = b""

    def write(self, at_s, data):
        self._written.put((at_s, data))

    @property
    def in_waiting(self):
        return len(self._data)

    def read(self, count):
        if not self._data:
            with contextlib.suppress(queue.Empty):
                self.now_s, self._data = self._written.get(timeout=0.05)
        data, self._data = self._data[:count], self._data[count:]
        return data

    def cancel_read(self):
        """Every read ends by itself."""

    close = set_low_latency_mode = lambda self, *_: None


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.0, 0.003])
def test_the_value_at_a_sync_is_the_one_of_that_instant(monkeypatch, late_s):
    """A frame a millisecond, handed over up to so late; x is the time at which it was written."""
    port, random, arrived_s = ScriptedPort(), Random(1), 0.0
    monkeypatch.setattr(accelerometer.serial, "Serial", lambda *_, **__: port)
    reader = AccelerometerReader(table(BINARY_TOML), lambda: port.now_s)
    line_s = 12 * 10 / 460_800
    for number in range(1, 701):
        arrived_s = max(arrived_s, 1e-3 * number + line_s + random.uniform(0.0, late_s))
        port.write(100.0 + arrived_s, binary_frame(number, (1e-3 * number, 0.0, -1.0)))
        if number == 1:
            reader.open(is_lock_step=False)
        if number % 2 == 0:
            wait_for(lambda number=number: reader._samples == number)
        if number > 300 and number % 2 == 0:
            sync_s = 1e-3 * (number - 3) + 0.0005
            x, y, z = reader.value_at_sync(100.0 + sync_s)
            assert (y, z) == (0.0, -1.0)
            assert -0.0006 < sync_s - x < 0.0016
    reader.close()
    assert (reader.lost, reader.errors, reader.overruns) == (0, 0, 0)


@pytest.mark.wall
def test_losses_and_errors_are_counted(sensor, terminal):
    with reading(BINARY_TOML, terminal) as reader:
        sensor.skip = 7
        wait_for(lambda: reader.lost == 7)
        terminal.write(b"\xaa\x55" + bytes(20))
        wait_for(lambda: reader.errors >= 1)
        wait_for(lambda: reader.value_at_sync(time.monotonic()) is not None)
        wait_for(lambda: reader.overruns > 0)  # nobody asks for a second
        assert reader.value_at_sync(time.monotonic()) is not None


@pytest.mark.wall
def test_a_sensor_that_falls_silent_has_no_value(sensor, terminal):
    with reading(BINARY_TOML, terminal) as reader:
        assert reader.value_at_sync(time.monotonic()) is not None
        sensor.stop()
        wait_for(lambda: reader.value_at_sync(time.monotonic()) is None)
        assert reader.failure is None


def test_a_port_that_goes_is_told(terminal):
    sensor = Sensor(terminal)
    with reading(BINARY_TOML, terminal) as reader:
        sensor.stop()
        os.close(terminal._device)
        wait_for(lambda: reader.failure is not None)
        wait_for(lambda: reader.value_at_sync(time.monotonic()) is None)
    terminal._device = os.open("/dev/null", os.O_RDONLY)  # for its own close


@pytest.mark.wall
@pytest.mark.parametrize(
    ("port", "written", "says"),
    [
        ("/nonexistent", b"", "No such file"),
        (None, b"", "nothing within 2 s; check power and port"),
        (None, b"1,2,3\r\n" * 100, "700 bytes, 0 wrong checksums, 0 malformed"),
        (None, b"\xaa\x55" + bytes(50), "wrong checksums, 0 malformed frames; check baud_rate"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_reason(terminal, port, written, says):
    terminal.write(written)
    threading.Timer(0.1, terminal.write, (written,)).start()
    with pytest.raises(SerialAccelerometerError, match=says.replace("700", r"\d+")), reading(BINARY_TOML, port or terminal):
        pass


def test_a_bus_in_lock_step_is_refused(terminal):
    reader = AccelerometerReader(table(BINARY_TOML))
    with pytest.raises(SerialAccelerometerError, match="this bus counts time in SYNCs"):
        reader.open(is_lock_step=True)
    reader.close()


def test_two_do_not_read_the_same_port(sensor, terminal):
    with (
        reading(BINARY_TOML, terminal),
        pytest.raises(SerialAccelerometerError, match="lock"),
        reading(BINARY_TOML, terminal),
    ):
        pass


@pytest.mark.wall
@pytest.mark.parametrize(("toml", "framing"), [(LINE_TOML, "line"), (BINARY_TOML, "binary")])
def test_the_emulated_sensor_is_read_as_the_page_describes_it(tmp_path, toml, framing):
    with served(tmp_path, "--framing", framing) as path, reading(toml, str(path), max_age_s=60.0) as reader:
        values = []
        while len(set(values)) <= 100:  # the noise is new in each
            time.sleep(0.002)
            values.append(reader.value_at_sync(time.monotonic()))
        assert None not in values
        assert all(abs(v) < 0.2 for value in values for v in value)  # it stands still, and gravity is left out
        assert reader.errors == reader.lost == 0
