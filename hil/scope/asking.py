"""Requests for mapping and scales of nodes, by SDO.

A scope sends nothing else; it overhears the answers.
"""

import contextlib

from drive_profiles.address import Address
from hil.can.opening import open_channel
from hil.errors import HilError
from hil.logs.nodes import COMMUNICATION_PARAMETERS, MAPPING_PARAMETERS
from hil.master.network import Network
from hil.master.sensor import DIGITS_OBJECT, UNIT_OBJECT
from hil.recording import BusLog

ASKED_PDOS = 4
TIMEOUT_S = 0.5
_SCALES = ((0x608F, 1), (0x608F, 2), (0x6076, 0), (0x6091, 1), (0x6091, 2), (0x6092, 1), (0x6092, 2), (0x607E, 0),
    (0x60A8, 0), (0x60A9, 0), (0x6060, 0), (UNIT_OBJECT, 1), (DIGITS_OBJECT, 1))  # fmt: skip


def ask_nodes(address: Address, nodes: tuple[int, ...]) -> None:
    """Read the objects with mapping and scales of some nodes.

    Raises:
        BusUnavailableError: The bus cannot be opened once more.
        NoAnswerError: A node does not answer.
    """
    channel = open_channel(address)
    try:
        network = Network(channel, BusLog(None), TIMEOUT_S, 0.001)
        for node in nodes:
            network.read_raw(node, 0x1000, 0, "device type")  # a node that is silent is said
            for index, subindex in (*_mapping_objects(), *_SCALES):
                with contextlib.suppress(HilError):
                    network.read_raw(node, index, subindex, "mapping")
    finally:
        channel.close()


def _mapping_objects() -> list[tuple[int, int]]:
    found = []
    for direction in ("rpdo", "tpdo"):
        for number in range(ASKED_PDOS):
            communication, mapped = COMMUNICATION_PARAMETERS[direction] + number, MAPPING_PARAMETERS[direction] + number
            found += [(communication, 1), (communication, 2), *((mapped, subindex) for subindex in range(9))]
    return found
