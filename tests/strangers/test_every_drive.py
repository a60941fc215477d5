"""The drives of every profile on the bus of one served robot: the `canopen` package visits each, and none answers for another."""

import re

import canopen
import pytest

from drive_profiles.standard.cia301 import NmtState
from drive_profiles.standard.cia402 import Mode, Object, State, state_of
from hil.emulator import EmulatorProcess
from tests.drive_profiles.profiles import ALL_DRIVES
from tests.plant_emulator.bus.conftest import PATIENCE_S, wait_for
from tests.plant_emulator.many_axes import robot_file

NODES = dict(enumerate(ALL_DRIVES, 1))
MASTER = 126
GAINS = """
[axis.{number}.control]
position_gain_per_s = 25.0
velocity_gain_nm_s_rad = 0.0905
velocity_integral_gain_nm_rad = 1.81
"""

pytestmark = pytest.mark.ci


class Visited(canopen.RemoteNode):
    """A drive as a master sees it that has no EDS file of it."""

    def __init__(self, node_id):
        super().__init__(node_id, canopen.ObjectDictionary())
        self.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        self.profile = ALL_DRIVES[NODES[node_id]]

    def read(self, index, subindex=0):
        return int.from_bytes(self.sdo.upload(index, subindex), "little")

    def write(self, index, subindex, value, size):
        self.sdo.download(index, subindex, value.to_bytes(size, "little"))

    @property
    def state(self):
        return state_of(self.read(Object.STATUS_WORD))

    def word(self, *words):
        for word in words:
            self.write(Object.CONTROL_WORD, 0, word, 2)

    def to(self, mode):
        self.write(Object.MODES_OF_OPERATION, 0, mode % 256, 1)
        self.word(0x06, 0x07, 0x0F)


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    text = robot_file(NODES, more=GAINS)
    path.write_text(re.sub(r"\[axis\.(\d+)\]\n", lambda head: f'{head[0]}profile = "{NODES[int(head[1])]}"\n', text))
    with EmulatorProcess(str(path)) as emulator:
        network = canopen.Network()
        network.NOTIFIER_CYCLE = 0.05  # its thread is only joined so often
        network.connect(interface="hil_local", channel=emulator.address.channel)
        try:
            yield network
        finally:
            network.disconnect()


@pytest.fixture(scope="module")
def drives(network):
    for node_id in NODES:
        network.add_node(Visited(node_id))
    network.nmt.send_command(1)
    for drive in network.values():
        drive.write(Object.INTERPOLATION_PERIOD, 1, 1, 1)  # not every factory has set one
    return list(network.values())


def test_each_says_who_it_is(drives):
    for drive in drives:
        identity = drive.profile.identity
        said = [drive.read(0x1018, subindex) for subindex in range(1, 5)]
        assert said == [identity.vendor_id, identity.product_code or 0, identity.typical_revision, drive.id], NODES[drive.id]
        assert drive.read(0x1000) == (identity.device_type or 0x00020192), NODES[drive.id]


def test_each_has_the_parameters_of_its_profile_and_takes_what_it_holds(drives):
    for drive in drives:
        for name, parameter in drive.profile.parameters.items():
            if parameter.access != "wo":
                held = drive.sdo.upload(*parameter.address)
                assert parameter.type.size in {None, len(held)}, f"{NODES[drive.id]}: {name}"
                if parameter.access == "rw":
                    drive.sdo.download(*parameter.address, held)


def test_all_are_enabled_at_once_in_each_of_their_modes_and_back(drives):
    for mode in Mode:
        able = [drive for drive in drives if mode in drive.profile.supported_modes]
        for drive in able:
            drive.to(mode)
        enabled = [drive for drive in drives if drive.state is State.OPERATION_ENABLED]
        assert [NODES[drive.id] for drive in enabled] == [NODES[drive.id] for drive in able], mode.name
        assert {drive.read(Object.MODES_OF_OPERATION_DISPLAY) for drive in able} <= {mode}
        for drive in able:
            drive.word(0x00)
            wait_for(lambda drive=drive: drive.state is State.SWITCH_ON_DISABLED)


def test_each_sends_heartbeats_of_its_own_until_it_is_told_to_stop(drives):
    for drive in drives:
        drive.write(0x1017, 0, 20 + drive.id, 2)
    assert [drive.read(0x1017) for drive in drives] == [20 + drive.id for drive in drives]
    heard = {}
    for drive in drives:
        drive.nmt.add_heartbeat_callback(lambda state, node_id=drive.id: heard.update({node_id: NmtState(state)}))
    wait_for(lambda: heard.keys() == NODES.keys())
    assert set(heard.values()) == {NmtState.OPERATIONAL}
    for drive in drives:
        drive.write(0x1017, 0, 0, 2)


def test_the_loss_of_the_master_is_a_fault_of_each_which_a_reset_ends(network, drives):
    for drive in drives:
        drive.emcy.reset()
        drive.write(Object.ABORT_CONNECTION_OPTION, 0, 1, 2)
        drive.to(drive.profile.supported_modes[0])
        drive.write(0x1016, 1, MASTER << 16 | 50, 4)
    network.send_message(0x700 + MASTER, b"\x05")
    for drive in drives:
        wait_for(lambda drive=drive: any(each.code == 0x8130 for each in drive.emcy.log))
        wait_for(lambda drive=drive: drive.state is State.FAULT)
        drive.write(0x1016, 1, 0, 4)
        drive.word(0x80)
        assert drive.state is State.SWITCH_ON_DISABLED, NODES[drive.id]
        assert drive.emcy.active == [], NODES[drive.id]
    network.nmt.send_command(1)
