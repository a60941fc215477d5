"""SDO round trips: the shipped client over the local bus against the emulator, the `canopen` package against itself."""

import contextlib
import struct
import time
from collections.abc import Callable

import canopen

from benchmarks.measure import Row, agreed, in_turn, progress, table
from benchmarks.robots import FIRST_NODE, SINGLE
from benchmarks.stranger import dictionary
from benchmarks.whole_bench import emulator
from hil.can.frame import Frame
from hil.can.local import LocalChannel
from hil.master.network import Network
from hil.recording import BusLog

NODE, SHARE_S = FIRST_NODE + SINGLE, 0.25
READ = Frame(0x600 + NODE, struct.pack("<BHBI", 0x40, 0x1018, 1, 0))


def rate(function: Callable[[], object]) -> float:
    """Calls per second."""
    count, begin = 0, time.perf_counter()
    while (took := time.perf_counter() - begin) < SHARE_S:
        for _ in range(20):
            function()
        count += 20
    return count / took


def sdo() -> list[str]:
    """Reads of a 32-bit object per second.

    Raises:
        DisagreementError: One of them reads another value.
    """
    progress("sdo: round trips")
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(emulator(1, 1e-3, None))
        channel = LocalChannel(address)
        stack.callback(channel.close)
        network = Network(channel, BusLog(None), 1.0, 1e-3)

        def frames() -> bytes:
            channel.send(READ)
            while (frame := channel.receive(1.0)) is None or frame.can_id != 0x580 + NODE:
                pass
            return frame.data[4:]

        vendor = network.read_raw(NODE, 0x1018, 1)

        near, far = canopen.Network(), canopen.Network()
        for end in (near, far):
            end.connect(interface="virtual", channel="bench-sdo")
            stack.callback(end.disconnect)
        far.add_node(canopen.LocalNode(NODE, dictionary(int.from_bytes(vendor, "little"))))
        remote = near.add_node(canopen.RemoteNode(NODE, dictionary()))
        contenders: dict[str, Callable[[], bytes]] = {
            "`SdoPort`, local bus, emulator process": lambda: network.read_raw(NODE, 0x1018, 1),
            "the same two frames without `SdoPort`": frames,
            "`canopen` client and node on `virtual`": lambda: remote.sdo.upload(0x1018, 1),
        }
        for name, call in contenders.items():
            wrong = int.from_bytes(call(), "little") - int.from_bytes(vendor, "little")
            agreed(f"{name}, the object's value", abs(wrong), 0.0)
        found = in_turn({name: lambda call=call: rate(call) for name, call in contenders.items()}, 3)
    mine = next(iter(found.values()))
    rows: list[Row] = [(name, value, 1e6 / value, mine / value) for name, value in found.items()]
    return table(("read of a 32-bit object", "per s", "µs", "our speed / this"), rows)
