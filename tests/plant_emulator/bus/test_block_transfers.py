"""SDO block transfers on the local bus: a whole sub-block of 127 segments finds room on every medium."""

import struct

import pytest

from drive_profiles.standard.cia301 import FunctionCode
from hil.can.frame import Frame
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.drive.dictionary.manufacturer_objects import USER_TEXT
from plant_emulator.world import World
from tests.plant_emulator.rig import ONE_AXIS
from tests.plant_emulator.slave.sdo.sdo_rig import BlockClient, Wire

LOSSLESS = Wire()


class Remote:
    """The server of a drive, at the other end of a bus."""

    due = None

    def __init__(self, channel, node):
        self.channel, self.node = channel, node

    def receive(self, data, now):
        self.channel.send(Frame(FunctionCode.SDO_REQUEST + self.node, data))
        answers = []
        while frames := self.channel.receive_all(0.0):
            answers += [frame for frame in frames if frame.can_id == FunctionCode.SDO_RESPONSE + self.node]
        return [Frame(0x585, frame.data) for frame in answers]


@pytest.mark.parametrize("rates", [(None, None), (250_000, None), (500_000, 2_000_000)], ids=["order", "classic", "fd"])
def test_a_text_of_the_longest_length_is_written_and_read_back_in_blocks_of_127(rates):
    world = World(ONE_AXIS)
    channel = InProcessChannel(world, medium_for(world, *rates))
    (node,) = (drive.node_id for drive in world.drives.values())
    while channel.receive_all(0.0):
        pass
    client = BlockClient(Remote(channel, node), struct.pack("<HB", USER_TEXT, 0))
    text = bytes(32 + i % 90 for i in range(1024))
    client.download(text, LOSSLESS)
    assert client.upload(LOSSLESS, [127]) == text
    assert client.sub_blocks == [31, 31, 31, 31, 23, 127, 20]
