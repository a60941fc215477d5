"""The bus in one process: frames of a stranger on buses with bit times and without."""

import pytest

from drive_profiles.standard.cia301 import FunctionCode
from hil.can.frame import Frame
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.world import World
from tests.plant_emulator.rig import ONE_AXIS

PROCESS_DATA, HEARTBEAT, QUESTION = Frame(0x210, bytes(4)), Frame(0x77E, b"\x05"), Frame(0x602, b"\x40\0\x10\0\0\0\0\0")


def channel(bitrate):
    world = World(ONE_AXIS)
    made = InProcessChannel(world, medium_for(world, bitrate))
    made.receive_all(0.0)
    return made


@pytest.mark.parametrize("bitrate", [None, 1_000_000])
@pytest.mark.parametrize("frame", [PROCESS_DATA, HEARTBEAT, QUESTION], ids=["process data", "heartbeat", "SDO"])
def test_an_injected_frame_is_heard_when_the_client_waits(bitrate, frame):
    made, ends = channel(bitrate), []
    made.heard = lambda each, end_ns: ends.append((each, end_ns))
    before_ns = made.world.now
    made.inject(frame)
    assert frame in made.receive_all(0.0)
    assert [each for each, _ in ends].count(frame) == 1
    assert (ends[0][1] > before_ns) == (bitrate is not None)


@pytest.mark.parametrize("bitrate", [None, 1_000_000])
def test_injected_frames_reach_the_bus_with_the_next_sync(bitrate):
    made, heard = channel(bitrate), []
    made.heard = lambda each, end_ns: heard.append(each)
    for _ in range(3):
        made.inject(PROCESS_DATA)
        made.inject(HEARTBEAT)
        made.send(Frame(FunctionCode.SYNC, b""))
    assert heard.count(PROCESS_DATA) == heard.count(HEARTBEAT) == 3
    assert made.receive_all(0.0).count(HEARTBEAT) == 3
