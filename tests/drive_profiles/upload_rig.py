"""A real slave engine with 60 objects to write, and a line to it that loses, doubles, changes or aborts any single frame."""

import random
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.files import toml as files
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia301 import DataType
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions, UploadResult
from drive_profiles.upload.upload import Upload
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import communication_entries, pdo_entries
from plant_emulator.slave.store import store_entries

NODE = 5
STORE_NS = 300_000_000
SWITCH_ON_DISABLED, OPERATION_ENABLED = 0x0250, 0x0237
TYPES = ("UNSIGNED8", "UNSIGNED16", "INTEGER16", "UNSIGNED32", "INTEGER32", "REAL32")
PARAMETERS = 53
"""Beside them six objects of a PDO and a text that takes segments: 60 in all."""

HEAD = """
name = "rig"
title = "Rig"
kind = "accelerometer"
[identity]
vendor_id = 0x1234
product_code = 0x402
source = "test"
evidence = "definition"
[sync]
source = "test"
evidence = "definition"
[store]
object = "1010:1"
wait_s = 1.0
source = "test"
evidence = "definition"
[parameters]
"""


def old_value(number: int) -> float:
    return 10 + number


def new_value(number: int) -> float:
    return 100 + number


def profile() -> Profile:
    lines = [
        f'p{n} = {{ index = {0x2000 + n}, subindex = 1, data_type = "{TYPES[n % 6]}", class = "tuning", maximum = 200.0,'
        f' description = "d", source = "test", evidence = "definition", order = {n % 3} }}'
        for n in range(PARAMETERS)
    ]
    lines.append(
        'text = { index = 0x2100, subindex = 0, data_type = "VISIBLE_STRING", class = "tuning",'
        ' description = "d", source = "test", evidence = "definition" }'
    )
    return files.loads(HEAD + "\n".join(lines), Profile)


PROFILE = profile()


@cache
def entries(status_word: int) -> tuple[Entry, ...]:
    """What the node holds; nobody changes it, and checking it takes longer than a short upload."""
    made = [
        *communication_entries(device_type=0x192, name="Rig", vendor_id=0x1234, product_code=0x402, revision=1, serial_number=7),
        *store_entries(),
        *pdo_entries(),
        Entry(0x6041, 0, "Status word", DataType.UNSIGNED16, Access.RO, status_word),
        Entry(0x2100, 0, "Text", DataType.VISIBLE_STRING, Access.RW, "what it was before"),
        Entry(0x2200, 0, "Bystander", DataType.UNSIGNED32, Access.RWW, 77, mappable=True),
        Entry(0x2201, 0, "Another", DataType.UNSIGNED16, Access.RWW, 78, mappable=True),
    ]
    for n in range(PARAMETERS):
        kind = DataType[TYPES[n % 6]]
        value = float(old_value(n)) if kind.is_real else int(old_value(n))
        made.append(Entry(0x2000 + n, 1, f"P {n}", kind, Access.RW, value, record_name=f"R {n}"))
    return tuple(Dictionary(made))


def node(status_word: int = SWITCH_ON_DISABLED, more: Iterable[Entry] = ()) -> Slave:
    slave = Slave(NODE, Dictionary([*more, *entries(status_word)]), store_time_ns=STORE_NS)
    slave.power_on(0)
    return slave


def wanted() -> ParameterSet:
    tuning = {f"p{n}": Item(value=new_value(n)) for n in range(PARAMETERS)}
    tuning["text"] = Item(value="what it shall be from now on")
    mapping = {
        "0x1401:1": Item(value=0x300 + NODE, type="UNSIGNED32"),
        "0x1401:2": Item(value=1, type="UNSIGNED8"),
        "0x1601:0": Item(value=2, type="UNSIGNED8"),
        "0x1601:1": Item(value=0x2200_0020, type="UNSIGNED32"),
        "0x1601:2": Item(value=0x2201_0010, type="UNSIGNED32"),
        "0x1601:3": Item(value=0, type="UNSIGNED32"),
    }
    return ParameterSet(tuning=tuning, communication=mapping)


def contents(slave: Slave) -> dict[tuple[int, int], object]:
    """What can be set on the node."""
    return {
        (entry.index, entry.subindex): slave.dictionary.get(entry.index, entry.subindex)
        for entry in slave.dictionary
        if entry.access.is_writable and entry.index not in (0x1010, 0x1011)
    }


class KilledError(BaseException):
    """The tool is killed: nothing of it runs any more, not even what cleans up."""


@dataclass
class Fault:
    """What happens to frame `number` of a transfer, counted from 0 over both directions."""

    kind: str
    number: int
    where: int = 0
    mask: int = 1


class Line:
    """The node's SDO channel, in the node's own time."""

    def __init__(self, slave: Slave, fault: Fault | None = None) -> None:
        self.slave, self.fault = slave, fault
        self.now, self.frames, self.dead, self.boots = 0, 0, False, 0
        self.on_frame: Callable[[int], None] = lambda number: None
        self._answers: deque[bytes] = deque()

    def send(self, can_id: int, data: bytes) -> None:
        if self.dead:
            raise KilledError
        for each in self._through(data, is_answer=False):
            self._take(self.slave.receive(Frame(can_id, each), self.now))

    def receive(self, timeout_s: float) -> bytes | None:
        if self.dead:
            raise KilledError
        if not self._answers:
            self.now += round(1e9 * timeout_s)
            self._take(self.slave.advance(self.now))
            if self.dead:
                raise KilledError
        return self._answers.popleft() if self._answers else None

    def clear(self) -> list[bytes]:
        old = list(self._answers)
        self._answers.clear()
        return old

    def _take(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.boots += frame.can_id == 0x700 + NODE and frame.data == b"\0"
            if frame.can_id == 0x580 + NODE:
                self._answers.extend(self._through(frame.data, is_answer=True))

    def _through(self, data: bytes, *, is_answer: bool) -> list[bytes]:
        """What comes out at the other end."""
        number, fault = self.frames, self.fault
        self.frames += 1
        self.on_frame(number)
        if fault is None or fault.number != number:
            return [data]
        match fault.kind:
            case "lost":
                return []
            case "duplicated":
                return [data, data]
            case "corrupted":
                changed = bytearray(data)
                changed[fault.where] ^= fault.mask
                return [bytes(changed)]
            case "aborted":
                abort = b"\x80" + data[1:4] + (0x0800_0000).to_bytes(4, "little")
                if is_answer:
                    return [abort]
                self._answers.append(abort)
                return []
            case "killed before":
                self.dead = True
                return []
            case "killed after":
                self.dead = True
                return [data]
            case kind:
                raise ValueError(kind)


class Late(Line):
    """After a while the node's answers are late, in order, by anything up to `longest_s`; some frames are lost.

    To be late with a read of the old value is what makes it dangerous, so it begins near the first write.
    """

    def __init__(self, slave: Slave, seed: int, longest_s: float = 1.2, lost: float = 0.0) -> None:
        super().__init__(slave)
        self._random, self._longest_ns, self._lost = random.Random(seed), round(1e9 * longest_s), lost
        self._coming: deque[tuple[int, bytes]] = deque()
        self._late = self._random.choice((0.4, 0.7, 1.0))
        self.calm = 1_000_000
        """How many requests are answered at once first."""

    def receive(self, timeout_s: float) -> bytes | None:
        end = self.now + round(1e9 * timeout_s)
        if not self._answers and self._coming and self._coming[0][0] <= end:
            self.now = max(self.now, self._coming[0][0])
        if not self._arrived():
            self.now = end
            self._take(self.slave.advance(self.now))
            self._arrived()
        return self._answers.popleft() if self._answers else None

    def clear(self) -> list[bytes]:
        self._arrived()
        return super().clear()

    def _arrived(self) -> bool:
        while self._coming and self._coming[0][0] <= self.now:
            self._answers.append(self._coming.popleft()[1])
        return bool(self._answers)

    def _take(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.boots += frame.can_id == 0x700 + NODE and frame.data == b"\0"
            if frame.can_id == 0x580 + NODE and not self._happens(self._lost):
                due = self.now + (self._random.randrange(self._longest_ns) if self._happens(self._late) else 0)
                self._coming.append((max([due, *(self._coming[-1][:1] if self._coming else ())]), frame.data))

    def _through(self, data: bytes, *, is_answer: bool) -> list[bytes]:
        self.calm -= 1
        return [] if self._happens(self._lost) else [data]

    def _happens(self, probability: float) -> bool:
        return self.calm < 0 and self._random.random() < probability


def upload(slave: Slave, folder: Path, parameter_set: ParameterSet, line: Line | None = None, **options: bool) -> Upload:
    """An upload to it that is prepared."""
    device = Device(SdoPort(NODE, Line(slave) if line is None else line, 0.5), Catalogue(PROFILE))
    made = Upload(device, parameter_set, UploadOptions(journals=folder, **options))
    fleet.prepare([made])
    return made


def transfer(
    slave: Slave, folder: Path, fault: Fault | None = None, *, store: bool = False, parameter_set: ParameterSet | None = None
) -> tuple[Line, UploadResult | None]:
    """One upload; None where it was refused before anything was written, or killed."""
    line = Line(slave, fault)
    made = upload(slave, folder, wanted() if parameter_set is None else parameter_set, line, store=store)
    try:
        return line, fleet.run([made])[0]
    except KilledError:
        if made._journal is not None:
            made._journal._file.close()  # as the kernel does with the files of a process that was killed
        raise
