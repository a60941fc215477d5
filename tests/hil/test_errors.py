"""The bench's errors: those of a node are the drive package's too, whoever has raised them."""

import pytest

from drive_profiles import errors as package
from drive_profiles.standard.cia301 import DataType, FunctionCode
from hil.cli.console import exit_status_of
from hil.errors import (
    AlreadyMovingError,
    HilError,
    NoAnswerError,
    NodeError,
    SdoAbortedError,
    UnsafeRequestError,
    WrongIdentityError,
)
from hil.master.network import Network
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World


def test_a_value_beyond_its_limit_is_told_from_it_however_little_it_is_beyond():
    said = str(UnsafeRequestError("the position of axis 2", 22.00004, 22.0, "rev"))
    assert said == "the position of axis 2 would be 22.00004 rev; the limit is 22 rev"
    assert "25.99 rev; the limit is 22 rev" in str(UnsafeRequestError("the position", 25.9876, 22.0, "rev"))


@pytest.fixture
def channel():
    return InProcessChannel(World(load_robot("reference")))


@pytest.fixture
def network(channel):
    return Network(channel, BusLog(None), 0.05, 0.002)


@pytest.mark.parametrize(
    ("mine", "theirs", "exit_code"),
    [
        (NodeError, package.NodeError, 5),
        (NoAnswerError, package.NoAnswerError, 5),
        (WrongIdentityError, package.NodeError, 5),
        (AlreadyMovingError, package.NodeError, 5),
        (SdoAbortedError, package.SdoAbortedError, 6),
    ],
)
def test_an_error_of_a_node_is_caught_as_the_bench_s_and_as_the_package_s(mine, theirs, exit_code):
    assert issubclass(mine, HilError)
    assert issubclass(mine, theirs)
    assert mine.exit_code == exit_code


def test_a_refused_access_says_which_object_and_value_and_why(network):
    with pytest.raises(SdoAbortedError, match=r"node 2: write of 7 of 1018h:1 \(vendor\) aborted: 0x06010002, ") as error:
        network.write(2, 0x1018, 1, DataType.UNSIGNED32, 7, "vendor")
    assert (error.value.node, error.value.index, error.value.subindex, error.value.code) == (2, 0x1018, 1, 0x06010002)
    assert exit_status_of(error.value) == 6


def test_a_silent_node_is_named_with_the_object_that_was_asked_for_and_how_long(channel, network):
    channel.passes = lambda frame: frame.can_id != FunctionCode.SDO_RESPONSE + 2
    with pytest.raises(NoAnswerError, match=r"node 2: no answer to the read of 1018h:1 \(vendor\) within 0\.05 s") as error:
        network.read(2, 0x1018, 1, DataType.UNSIGNED32, "vendor")
    assert exit_status_of(error.value) == 5


def test_after_a_time_out_a_node_that_stays_silent_is_still_the_bench_s_error(channel, network):
    channel.passes = lambda frame: frame.can_id != FunctionCode.SDO_RESPONSE + 2
    for _ in range(2):
        with pytest.raises(NoAnswerError):
            network.read_raw(2, 0x1018, 1)
