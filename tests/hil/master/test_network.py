"""The master's side of the bus: what it makes of frames that others send."""

import itertools

import pytest

from drive_profiles.standard.cia301 import FunctionCode
from hil.can.frame import Frame
from hil.errors import NoAnswerError, SharedNodeError
from hil.master.network import Network
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

NODE = 2
READ = bytes.fromhex("40 00 10 00 00 00 00 00")


@pytest.fixture
def channel():
    return InProcessChannel(World(load_robot("reference")))


@pytest.fixture
def network(channel):
    return Network(channel, BusLog(None), 0.05, 0.002)


def lose_answers(channel):
    channel.passes = lambda frame: frame.can_id != FunctionCode.SDO_RESPONSE + NODE


def test_another_sdo_client_is_named_where_a_node_does_not_answer(channel, network):
    network.read_raw(NODE, 0x1018, 1)
    channel.inject(Frame(FunctionCode.SDO_REQUEST + NODE, READ))
    lose_answers(channel)
    network.pump_until(lambda: False, 0.01)
    with pytest.raises(SharedNodeError, match="another SDO client talks to this node; end the other program"):
        network.read_raw(NODE, 0x1018, 2)


def test_a_silent_node_with_which_nobody_else_talks_has_its_own_words(channel, network):
    network.read_raw(NODE, 0x1018, 1)
    channel.inject(Frame(FunctionCode.SDO_REQUEST + NODE + 1, READ))
    channel.inject(Frame(FunctionCode.SDO_REQUEST + NODE | 0x8000_0000, READ))  # an extended identifier is no request
    lose_answers(channel)
    network.pump_until(lambda: False, 0.01)
    with pytest.raises(NoAnswerError, match="check its supply and the node-ID") as caught:
        network.read_raw(NODE, 0x1018, 2)
    assert not isinstance(caught.value, SharedNodeError)


def test_an_adapter_that_returns_our_own_requests_is_no_other_client(channel, network):
    network.read_raw(NODE, 0x1018, 1)
    channel.hand_over(Frame(FunctionCode.SDO_REQUEST + NODE, bytes.fromhex("40 18 10 01 00 00 00 00")))
    lose_answers(channel)
    with pytest.raises(NoAnswerError) as caught:
        network.read_raw(NODE, 0x1018, 1)
    assert not isinstance(caught.value, SharedNodeError)


def test_no_time_is_spent_on_a_bus_on_which_nothing_can_come(channel):
    class Clock:
        def __init__(self):
            self.looks = itertools.count()

        def now(self):
            assert next(self.looks) < 20, "it polls a bus that cannot bring anything"
            return 0.0

    while channel.receive(0.0) is not None:
        pass
    assert not Network(channel, BusLog(None), 0.05, 0.002, Clock()).pump_until(lambda: False, 0.1)
