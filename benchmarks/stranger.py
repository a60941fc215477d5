"""The `canopen` package doing the master's work over python-can's `virtual` bus, in threads of one process."""

import threading
from collections.abc import Callable
from typing import Self

import can
import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, datatypes

from benchmarks.echo import PATTERN, feedback_ids

_TYPES = {2: datatypes.UNSIGNED16, 4: datatypes.INTEGER32, -2: datatypes.INTEGER16}
_COMMAND = ((0x6040, 2), (0x607A, 4))
_FEEDBACK = ((0x6041, 2), (0x6064, 4), (0x6077, -2))


def _variable(name: str, index: int, subindex: int, kind: int) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type = kind
    return variable


def dictionary(vendor_id: int = 1) -> canopen.ObjectDictionary:
    """A drive's objects, as far as two PDOs need them; and an identity to read."""
    found = canopen.ObjectDictionary()
    for index, size in (*_COMMAND, *_FEEDBACK):
        found.add_object(_variable(f"{index:04X}", index, 0, _TYPES[size]))
    for base in (0x1400, 0x1800):
        communication = ODRecord(f"{base:04X} communication", base)
        for sub, kind in ((0, datatypes.UNSIGNED8), (1, datatypes.UNSIGNED32), (2, datatypes.UNSIGNED8)):
            communication.add_member(_variable(f"sub{sub}", base, sub, kind))
        mapping = ODArray(f"{base:04X} mapping", base + 0x200)
        mapping.add_member(_variable("count", base + 0x200, 0, datatypes.UNSIGNED8))
        mapping.add_member(_variable("entry", base + 0x200, 1, datatypes.UNSIGNED32))
        found.add_object(communication)
        found.add_object(mapping)
    identity = ODRecord("identity", 0x1018)
    for sub in range(5):
        variable = _variable(f"sub{sub}", 0x1018, sub, datatypes.UNSIGNED32)
        variable.default = vendor_id if sub == 1 else sub
        identity.add_member(variable)
    found.add_object(identity)
    return found


class Nodes:
    """Nodes that only echo, a thread on a `virtual` bus with python-can's own messages."""

    def __init__(self, channel: str, count: int) -> None:
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._ids = feedback_ids(count)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._ends = False

    def _serve(self) -> None:
        data = dict.fromkeys(self._ids, PATTERN)
        while not self._ends:
            message = self._bus.recv(0.1)
            if message is None:
                continue
            if message.arbitration_id == 0x80:
                for can_id, payload in data.items():
                    self._bus.send(can.Message(arbitration_id=can_id, data=payload, is_extended_id=False))
            elif message.arbitration_id - 0x80 in data:
                data[message.arbitration_id - 0x80] = PATTERN[:2] + bytes(message.data[2:6]) + PATTERN[6:]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        self._thread.join()
        self._bus.shutdown()


class Master:
    """canopen's master: a thread of python-can's notifier receives, the caller's packs, sends and waits."""

    def __init__(self, channel: str, count: int) -> None:
        self.network = canopen.Network()
        self.network.connect(interface="virtual", channel=channel)
        self._left, self._done = set[int](), threading.Event()
        objects = dictionary()
        self._maps = [self._map(objects, n + 1) for n in range(count)]
        self._ids = frozenset(feedback_ids(count))

    def _map(self, objects: canopen.ObjectDictionary, number: int) -> tuple[object, object, object, object]:
        node = self.network.add_node(canopen.RemoteNode(number, objects))
        node.nmt.stop_node_guarding()
        command, feedback = node.rpdo[1], node.tpdo[1]
        for pdo, entries, can_id in ((command, _COMMAND, 0x200 + number), (feedback, _FEEDBACK, 0x180 + number)):
            pdo.clear()
            for index, size in entries:
                pdo.add_variable(index, 0, 8 * abs(size))
            pdo.cob_id, pdo.enabled = can_id, True
        feedback.subscribe()
        feedback.add_callback(self._heard)
        command["6040"].raw = 0x0F
        return command, command["607A"], feedback["6064"], feedback["6041"]

    def _heard(self, pdo: "canopen.pdo.base.PdoMap") -> None:  # type: ignore[name-defined]
        self._left.discard(pdo.cob_id)
        if not self._left:
            self._done.set()

    def cycle(self, law: Callable[[int, int], int]) -> None:
        """Set-points out, SYNC, answers in, the law on them."""
        self._left, self._done = set(self._ids), threading.Event()
        for command, _, _, _ in self._maps:
            command.transmit()  # type: ignore[attr-defined]
        self.network.sync.transmit()
        if not self._done.wait(1.0):
            raise RuntimeError(f"no answer from {sorted(self._left)}")
        for n, (_, target, position, status) in enumerate(self._maps):
            if status.raw & 0x08:  # type: ignore[attr-defined]
                raise RuntimeError("fault")
            target.raw = law(n, position.raw)  # type: ignore[attr-defined]

    def set_points(self) -> list[int]:
        """What the next cycle will send."""
        return [target.raw for _, target, _, _ in self._maps]  # type: ignore[attr-defined]

    def put(self, values: list[int]) -> None:
        """Change it, node by node."""
        for (_, target, _, _), value in zip(self._maps, values, strict=True):
            target.raw = value  # type: ignore[attr-defined]

    def close(self) -> None:
        """Leave the bus."""
        self.network.disconnect()
