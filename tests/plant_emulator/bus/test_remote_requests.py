"""Remote requests on the local bus: a drive's TPDO that a client asks for crosses every medium."""

import can
import pytest

from drive_profiles.standard.cia301 import FunctionCode, NmtCommand
from hil.can.frame import CAN_RTR_FLAG, Frame
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.world import World
from tests.plant_emulator.rig import ONE_AXIS


@pytest.mark.parametrize("rates", [(None, None), (1_000_000, None), (500_000, 2_000_000)], ids=["order", "classic", "fd"])
def test_a_client_asks_a_drive_for_its_status_word(rates):
    world = World(ONE_AXIS)
    channel = InProcessChannel(world, medium_for(world, *rates))
    (node,) = (drive.node_id for drive in world.drives.values())
    status = FunctionCode.TPDO1 + node
    channel.send(Frame(FunctionCode.NMT, bytes((NmtCommand.START, node))))
    while channel.receive_all(0.0):
        pass
    heard = []
    channel.heard = lambda frame, _: heard.append(frame)
    channel.send(Frame(status | CAN_RTR_FLAG, bytes(2)))
    answers = channel.receive_all(0.0)
    assert [(frame.can_id, len(frame.data)) for frame in answers] == [(status, 2)]
    assert heard == [Frame(status | CAN_RTR_FLAG, bytes(2)), *answers]


def test_python_can_asks_over_the_socket(start_server):
    running = start_server()
    status = FunctionCode.TPDO1 + running.drive.node_id
    with can.Bus(interface="hil_local", channel=running.path) as bus:
        bus.send(can.Message(arbitration_id=FunctionCode.NMT, data=(NmtCommand.START, 0), is_extended_id=False))
        while bus.recv(5.0).arbitration_id != status:
            pass  # what an event-driven PDO sends by itself as the node becomes operational
        bus.send(can.Message(arbitration_id=status, is_remote_frame=True, dlc=2, is_extended_id=False))
        answer = bus.recv(5.0)
        assert (answer.arbitration_id, answer.dlc, answer.is_remote_frame) == (status, 2, False)
