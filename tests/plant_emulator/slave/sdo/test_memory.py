"""What SDO clients can make a node keep: the robot file's bound for each channel, whoever writes how."""

import struct
import tracemalloc

import pytest

from drive_profiles.files.toml import FileError
from drive_profiles.standard.cia301 import SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.drive.dictionary.manufacturer_objects import USER_TEXT
from plant_emulator.robots.robot import SDO_DOWNLOAD_BYTES, Robot, load_robot
from plant_emulator.slave.sdo.block import MAX_BLOCK_SIZE, SEGMENT_DATA
from plant_emulator.world import World
from tests.plant_emulator.many_axes import robot_file
from tests.plant_emulator.rig import AXIS, NODE, ONE_AXIS, Rig

SUB_BLOCK = MAX_BLOCK_SIZE * SEGMENT_DATA
SECOND_REQUEST, SECOND_RESPONSE = 0x6A0, 0x6A1
TEXT = struct.pack("<HB", USER_TEXT, 0)


def rig_with(download_bytes):
    return Rig(Robot(axis={AXIS: ONE_AXIS.axis[AXIS].model_copy(update={"sdo_download_bytes": download_bytes})}))


def opened(world, node=NODE):
    """The second channel of a node, opened over the first."""
    for sub, can_id in ((1, SECOND_REQUEST), (2, SECOND_RESPONSE)):
        world.receive(Frame(0x600 + node, struct.pack("<BHBI", 0x23, 0x1201, sub, can_id)))
    return world


def kept(world):
    """The bytes in the buffers of all channels of all nodes."""
    return sum(server.buffered_bytes for slave in world._slaves for server in slave._sdo.servers.values())


def flood(world, request, transfer):
    """One transfer that never ends, frame by frame, until the server aborts it; gives the abort code."""
    begin = bytes(((0xC0 if transfer == "block" else 0x20),)) + TEXT
    assert world.receive(Frame(request, begin.ljust(8, b"\0")))[0].data[0] != 0x80
    number = toggle = 0
    while True:
        number = number % 31 + 1
        first = number if transfer == "block" else toggle
        toggle ^= 0x10
        answers = world.receive(Frame(request, bytes((first,)) + b"\xaa" * 7))
        if answers and answers[0].data[0] == 0x80:
            return int.from_bytes(answers[0].data[4:], "little")
        yield


@pytest.mark.parametrize("length", [1025, SDO_DOWNLOAD_BYTES])
def test_a_long_value_goes_there_and_back(length):
    rig, text = Rig(), bytes(32 + i % 90 for i in range(length))
    assert rig.download(USER_TEXT, 0, text) is None
    assert rig.upload(USER_TEXT) == text


@pytest.mark.parametrize("bound", [8, 1024, 3000])
def test_the_robot_file_says_how_long_a_value_may_be(bound):
    rig = rig_with(bound)
    assert rig.download(USER_TEXT, 0, b"x" * bound) is None
    assert rig.download(USER_TEXT, 0, b"y" * (bound + 1)) == SdoAbortCode.OUT_OF_MEMORY
    assert rig.upload(USER_TEXT) == b"x" * bound


def test_drive_and_accelerometer_have_a_bound_each(tmp_path):
    text = robot_file([2, 3]).replace("[axis.3]\n", "[axis.3]\nsdo_download_bytes = 100\n")
    path = tmp_path / "robot.toml"
    path.write_text(text.replace("[accelerometer]\n", "[accelerometer]\nsdo_download_bytes = 200\n"))
    world = World(load_robot(path))
    bounds = {port: slave._sdo._predefined._max_bytes for port, slave in zip((2, 3, 127), world._slaves, strict=True)}
    assert bounds == {2: SDO_DOWNLOAD_BYTES, 3: 100, 127: 200}


@pytest.mark.parametrize("wrong", ["7", "16777217", "-1", '"64k"'])
def test_a_bound_that_is_none_is_refused(tmp_path, wrong):
    path = tmp_path / "robot.toml"
    path.write_text(robot_file([2]).replace("[axis.2]\n", f"[axis.2]\nsdo_download_bytes = {wrong}\n"))
    with pytest.raises(FileError, match="sdo_download_bytes"):
        load_robot(path)


@pytest.mark.parametrize(
    "transfers",
    [
        pytest.param(("segments", "block"), marks=pytest.mark.ci),
        *(pytest.param((each, each), marks=pytest.mark.slow) for each in ("segments", "block")),
    ],
)
def test_all_channels_together_keep_no_more_than_a_bound_for_each(transfers):
    """Both channels are flooded in turn by clients that never end: sum of the buffers, and the process' own memory."""
    bound = 20_000
    world = opened(rig_with(bound).world)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        floods = [flood(world, request, how) for request, how in zip((0x600 + NODE, SECOND_REQUEST), transfers, strict=True)]
        codes, most = [], 0
        while floods:
            for each in list(floods):
                try:
                    next(each)
                except StopIteration as end:
                    codes.append(end.value)
                    floods.remove(each)
            most = max(most, kept(world))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert codes == [SdoAbortCode.OUT_OF_MEMORY] * 2
    assert bound < most <= 2 * (bound + SUB_BLOCK)
    assert peak - before < 4 * (bound + SUB_BLOCK)  # a buffer that grows is copied
    assert kept(world) == 0


def test_transfers_that_are_begun_again_and_again_keep_nothing_of_those_before():
    rig = rig_with(5000)
    request = 0x600 + NODE
    for _ in range(20):
        for how in ("segments", "block"):
            unfinished = flood(rig.world, request, how)
            for _ in range(300):
                next(unfinished)
            assert kept(rig.world) <= 5000 + SUB_BLOCK
    rig.wait(6000)  # the time-out gives up the last one
    assert kept(rig.world) == 0
