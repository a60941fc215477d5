"""The SDO servers of a node, 1200h to 127Fh (CiA 301, 7.5.2.33)."""

from collections.abc import Callable, Iterator
from functools import partial

from drive_profiles.standard.cia301 import CobIdBit, DataType, FunctionCode, SdoAbortCode, identifier_refusal
from hil.can.frame import CAN_SFF_MASK, Frame
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.sdo.server import SdoServer

PREDEFINED = 0x1200
ADDITIONAL = range(0x1201, 0x1280)
REQUEST, RESPONSE = 1, 2
"""Sub-indices of the COB-ID from the client to the server, and of that from the server to the client."""

_NAMES = "COB-ID client to server", "COB-ID server to client"


def channel_entries() -> Iterator[Entry]:
    """Return the parameters of the predefined and the additional channel.

    The additional channel does not exist until a master opens it.
    """
    u32, name = DataType.UNSIGNED32, "SDO server parameter"
    for subindex, base in ((REQUEST, FunctionCode.SDO_REQUEST), (RESPONSE, FunctionCode.SDO_RESPONSE)):
        text = _NAMES[subindex - 1]
        yield Entry(PREDEFINED, subindex, text, u32, Access.RO, int(base), record_name=name, node_relative=True)
        yield Entry(ADDITIONAL[0], subindex, text, u32, Access.RW, int(CobIdBit.INVALID), record_name=name)
    yield Entry(ADDITIONAL[0], 3, "Node-ID of the SDO client", DataType.UNSIGNED8, Access.RW, 1, 1, 127, record_name=name)


def _is_valid(cob_id: int) -> bool:
    return not cob_id & CobIdBit.INVALID


class AdditionalChannel:
    """A server that exists while both of its COB-IDs are valid.

    Bit 30 marks a COB-ID that was assigned for the time being: it is not restored. Bit 29 and 29-bit identifiers are not
    supported.

    Args:
        dictionary: Must have the record.
        index: Index of the record.
        changed: Called when the channel exists from now on, or no longer.
    """

    def __init__(self, dictionary: Dictionary, index: int, server: SdoServer, changed: Callable[[], None]) -> None:
        self.server, self._changed = server, changed
        self._cells = {subindex: dictionary.cell(index, subindex) for subindex in (REQUEST, RESPONSE)}
        self._cob_ids = dict.fromkeys(self._cells, int(CobIdBit.INVALID))
        for subindex in self._cells:
            dictionary.on_write(index, subindex, partial(self._write, subindex))

    @property
    def is_open(self) -> bool:
        """True if the channel exists."""
        return all(map(_is_valid, self._cob_ids.values()))

    @property
    def request_id(self) -> int:
        """Identifier of the requests."""
        return self._cob_ids[REQUEST] & CAN_SFF_MASK

    def load(self) -> None:
        """Read both COB-IDs from the dictionary.

        A COB-ID that the bus could not have written is replaced by the default.
        """
        self._cob_ids = dict.fromkeys(self._cells, int(CobIdBit.INVALID))
        for subindex, cell in self._cells.items():
            cob_id = int(cell.current())  # a whole number, as the entry's type says
            if cob_id & CobIdBit.DYNAMIC or self._take(subindex, cob_id) is not None:
                cell.value = cell.entry.default
        self._open()

    def _write(self, subindex: int, cob_id: int) -> SdoAbortCode | None:
        was_open = self.is_open
        code = self._take(subindex, cob_id)
        if code is None and self.is_open != was_open:
            self._open()
            self._changed()
        return code

    def _take(self, subindex: int, cob_id: int) -> SdoAbortCode | None:
        can_id = cob_id & ~(CobIdBit.INVALID | CobIdBit.DYNAMIC)
        is_valid = _is_valid(cob_id)
        old, other = self._cob_ids[subindex], self._cob_ids[REQUEST if subindex == RESPONSE else RESPONSE]
        code = identifier_refusal(can_id, is_valid=is_valid, in_use=old & CAN_SFF_MASK if _is_valid(old) else None)
        if code is not None:
            return code
        if is_valid and _is_valid(other) and can_id == other & CAN_SFF_MASK:
            return SdoAbortCode.PARAMETER_INCOMPATIBLE  # the client would hear its own requests as answers
        self._cob_ids[subindex] = cob_id
        return None

    def _open(self) -> None:
        if self.is_open:
            self.server.reset()
            self.server.response_id = self._cob_ids[RESPONSE] & CAN_SFF_MASK


class SdoChannels:
    """The servers over one dictionary, each with a transfer of its own.

    Args:
        dictionary: Object dictionary that is read and written. Without 1200h the predefined channel has the identifiers of the
            predefined connection set; each of 1201h to 127Fh that is there with both COB-IDs is a channel.
        changed: Called when the node has to listen to other identifiers.

    Attributes:
        servers: By the identifier of their requests, the servers of the channels that exist.
    """

    def __init__(self, dictionary: Dictionary, make_server: Callable[[], SdoServer], changed: Callable[[], None]) -> None:
        self.servers: dict[int, SdoServer] = {}
        self.due: int | None = None
        self._dictionary, self._changed = dictionary, changed
        self._predefined = make_server()
        self._request_id = int(FunctionCode.SDO_REQUEST)
        self._additional = [
            AdditionalChannel(dictionary, index, make_server(), self._look_again)
            for index in ADDITIONAL
            if (index, REQUEST) in dictionary and (index, RESPONSE) in dictionary
        ]

    def load(self) -> None:
        """Read the identifiers from the dictionary."""
        node_id = self._dictionary.node_id
        predefined = (REQUEST, FunctionCode.SDO_REQUEST + node_id), (RESPONSE, FunctionCode.SDO_RESPONSE + node_id)
        self._request_id, self._predefined.response_id = (
            (self._dictionary.get_int(PREDEFINED, subindex) if (PREDEFINED, subindex) in self._dictionary else base)
            & CAN_SFF_MASK
            for subindex, base in predefined
        )
        for channel in self._additional:
            channel.load()
        self._collect()

    def receive(self, server: SdoServer, data: bytes, now: int) -> list[Frame]:
        """Return the answers of one of the servers."""
        frames = server.receive(data, now)
        self._plan()
        return frames

    def advance(self, now: int) -> list[Frame]:
        """Return the frames of the servers that are due."""
        if self.due is None or now < self.due:
            return []
        frames = [frame for server in tuple(self.servers.values()) for frame in server.advance(now)]
        self._plan()
        return frames

    def reset(self) -> None:
        """Drop all unfinished transfers without informing the clients."""
        for server in self.servers.values():
            server.reset()
        self.due = None

    def _look_again(self) -> None:
        self._collect()
        self._changed()

    def _collect(self) -> None:
        # The predefined channel comes last: another that has taken its identifier must not lock the master out.
        self.servers = {channel.request_id: channel.server for channel in self._additional if channel.is_open}
        self.servers[self._request_id] = self._predefined
        self._plan()

    def _plan(self) -> None:
        if len(self.servers) == 1:
            self.due = self._predefined.due
        else:
            self.due = min((server.due for server in self.servers.values() if server.due is not None), default=None)
