"""Medium between clients and world: instantaneous, or a wire with bit times."""

from typing import TYPE_CHECKING, Union

from plant_emulator.bus.instant import Instant
from plant_emulator.world import World

if TYPE_CHECKING:  # a bus without bit times does not load them
    from plant_emulator.bus.faults import BusFaults
    from plant_emulator.bus.timed import TimedBus

Medium = Union[Instant, "TimedBus"]
"""Delivery of frames, and passing of time."""


def medium_for(
    world: World,
    bitrate: int | None,
    data_bitrate: int | None = None,
    *,
    wall: bool = False,
    host_latency_s: float = 0.0,
    faults: "BusFaults | None" = None,
) -> Medium:
    """Choose the simplest medium that has the required properties.

    Args:
        bitrate: In bit/s; None: no bit times.
        data_bitrate: In bit/s; given, every data frame goes as a CAN FD frame of the same contents, these at this rate. That
            is what CAN FD brings to PDOs of up to 8 bytes; larger ones, which `hil plan` counts, are another matter.
        wall: Time follows the wall clock; else SYNC.
        host_latency_s: Time that a client's frame takes from its program to its controller, in the time of the bus.

    Raises:
        ValueError: No bit rate, or a data bit rate below it or alone.
    """
    if bitrate is None and data_bitrate is None and not wall and faults is None and not host_latency_s:
        return Instant(world)

    from plant_emulator.bus.timed import TimedBus  # noqa: PLC0415
    from plant_emulator.bus.wire import EmulatedWire  # noqa: PLC0415

    wire = EmulatedWire(bitrate, data_bitrate, faults=faults, now_ns=world.now)
    return TimedBus(world, wire, round(1e9 * host_latency_s), wall=wall)
