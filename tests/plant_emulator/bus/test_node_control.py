"""The canopen package as NMT, guarding and LSS master of a drive on the local bus, with python-can and sockets between."""

import canopen
import canopen.lss
import pytest

from drive_profiles.standard.cia301 import NmtState
from tests.plant_emulator.bus.conftest import wait_for

NODE = 3


@pytest.fixture
def network(running):
    before = len(running.server._clients)
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="hil_local", channel=running.path)
    wait_for(lambda: len(running.server._clients) > before)
    yield network
    network.disconnect()


@pytest.fixture
def node(network):
    return network.add_node(NODE, canopen.ObjectDictionary())


def heard(network, can_id):
    """The first bytes of the frames of this identifier, from now on; the package's own wait for a boot-up begins too late."""
    firsts = []
    network.subscribe(can_id, lambda can_id, data, time: firsts.append(data[0]))
    return firsts


def test_a_stranger_guards_a_node(running, network, node):
    answers = heard(network, 0x700 + NODE)
    node.nmt.start_node_guarding(0.01)
    wait_for(lambda: len(answers) >= 4)
    node.nmt.stop_node_guarding()
    assert answers[:4] == [0x7F, 0xFF, 0x7F, 0xFF]
    assert node.nmt.state == "PRE-OPERATIONAL"
    assert running.drive.slave.emergencies.causes == ()


def test_a_stranger_consumes_heartbeats_and_sees_each_state(network, node):
    node.sdo.download(0x1017, 0, (10).to_bytes(2, "little"))
    for name in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.state = name
        wait_for(lambda: node.nmt.wait_for_heartbeat(5.0) == name)  # noqa: B023 - it is called at once
    answers = heard(network, 0x700 + NODE)
    node.nmt.state = "RESET COMMUNICATION"
    wait_for(lambda: 0 in answers)
    assert answers.count(0) == 1


def test_a_stranger_renames_a_drive(running, network, node, monkeypatch):
    monkeypatch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", 5.0)
    lss = network.lss
    lss.send_switch_state_selective(0x48494C01, 0x402, 1, NODE)
    assert lss.inquire_node_id() == NODE
    lss.configure_node_id(42)
    lss.store_configuration()
    lss.send_switch_state_global(lss.WAITING_STATE)
    renamed = network.add_node(42, canopen.ObjectDictionary())
    answers = heard(network, 0x700 + 42)
    node.nmt.state = "RESET COMMUNICATION"
    wait_for(lambda: answers == [0])
    assert renamed.sdo.upload(0x1018, 4) == NODE.to_bytes(4, "little")
    assert running.drive.slave.nmt_state is NmtState.PRE_OPERATIONAL
