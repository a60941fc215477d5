"""How long an upload takes over the time that its frames need on the wire."""

import tempfile
import time
from collections import deque
from pathlib import Path

from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.files import toml as files
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia301 import DataType
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from hil.can.bits import frame_bits
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import communication_entries
from plant_emulator.slave.store import store_entries

NODE, OBJECTS, BIT_S = 5, 200, 1e-6
_FACT = 'source = "benchmark"\nevidence = "definition"\n'
_HEAD = (
    'name = "bench"\ntitle = "Bench"\nkind = "accelerometer"\n'
    f"[identity]\nvendor_id = 1\nproduct_code = 2\n{_FACT}[sync]\n{_FACT}"
    f'[store]\nobject = "1010:1"\n{_FACT}[parameters]\n'
)


class TimedLine:
    """A node behind a wire of 1 Mbit/s: every frame is held for as long as its bits take, actual stuff bits included.

    Attributes:
        bus_s: What all frames took on the wire.
        frames: How many.
    """

    def __init__(self, slave: Slave) -> None:
        """Join the wire."""
        self._slave = slave
        self._answers: deque[bytes] = deque()
        self.bus_s, self.frames, self.boots = 0.0, 0, 0

    def _hold(self, frame: Frame) -> None:
        duration = frame_bits(frame) * BIT_S
        self.bus_s += duration
        self.frames += 1
        end = time.perf_counter() + duration
        while time.perf_counter() < end:
            pass

    def send(self, can_id: int, data: bytes) -> None:
        """Put a frame on the wire, and the node's answer behind it."""
        frame = Frame(can_id, data)
        self._hold(frame)
        for answer in self._slave.receive(frame, time.perf_counter_ns()):
            self._hold(answer)
            self._answers.append(answer.data)

    def receive(self, timeout_s: float) -> bytes | None:
        """The next answer."""
        return self._answers.popleft() if self._answers else None

    def clear(self) -> list[bytes]:
        """Nothing is left over here."""
        return []


def upload() -> list[str]:
    """200 objects, snapshot, write, read back: the whole upload's time over its frames' time on the wire."""
    lines = [
        f'p{n} = {{ index = {0x2000 + n}, subindex = 0, data_type = "REAL32", class = "tuning", description = "d",'
        ' source = "benchmark", evidence = "definition" }'
        for n in range(OBJECTS)
    ]
    profile = files.loads(_HEAD + "\n".join(lines), Profile)
    entries = [
        *communication_entries(device_type=0x194, name="Bench", vendor_id=1, product_code=2),
        *store_entries(),
        *(Entry(0x2000 + n, 0, f"P {n}", DataType.REAL32, Access.RW, float(n)) for n in range(OBJECTS)),
    ]
    wanted = ParameterSet(tuning={f"p{n}": Item(value=1000.5 + n) for n in range(OBJECTS)})
    best: tuple[float, TimedLine] | None = None
    for _ in range(5):
        slave = Slave(NODE, Dictionary(entries))
        slave.power_on(0)
        line = TimedLine(slave)
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            made = Upload(Device(SdoPort(NODE, line), Catalogue(profile)), wanted, UploadOptions(journals=Path(folder)))
            fleet.prepare([made])
            [outcome] = fleet.run([made])
            took = time.perf_counter() - begin
        if (outcome.kind, outcome.written) != ("done", OBJECTS):
            raise RuntimeError(str(outcome))
        if best is None or took < best[0]:
            best = took, line
    if best is None:
        raise RuntimeError("no run")
    took, line = best
    cells = (OBJECTS, line.frames, f"{1e3 * line.bus_s:.0f}", f"{1e3 * took:.0f}", f"{took / line.bus_s:.2f}")
    return [
        "| objects | frames | on the wire at 1 Mbit/s, ms | whole upload, ms | upload / wire |",
        "|---|---|---|---|---|",
        f"| {' | '.join(map(str, cells))} |",
    ]
