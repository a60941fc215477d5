"""LSS: states, inquiries, node-ID, identification and fast scan (CiA 305). On a real device with --allow-lss and --alone."""

import struct

import pytest

MASTER, SLAVE = 0x7E5, 0x7E4
WAITING, CONFIGURATION = 0, 1
SWITCH_GLOBAL, NODE_ID, BIT_TIMING, STORE = 4, 17, 19, 23
INQUIRE = (90, 91, 92, 93)
INQUIRE_NODE = 94
IDENTIFY, IDENTIFY_ANSWER = 70, 79
UNCONFIGURED, UNCONFIGURED_ANSWER = 76, 80
SELECT, SELECTED = 64, 68
FAST_SCAN = 81


@pytest.fixture
def lss(device, permit):
    """The device as LSS slave, waiting; also afterwards, with the node-ID that it had."""
    if device.device_info.get("lss_supported", "0") != "1":
        pytest.skip("the EDS says LSS_Supported=0")
    permit("lss")
    permit("alone")
    device.is_touched = True
    yield Lss(device)
    Lss(device).switch(WAITING)


class Lss:
    """The services of an LSS master, raw."""

    def __init__(self, device):
        self.device, self.port = device, device.port

    def send(self, *data):
        self.port.send(MASTER, bytes(data).ljust(8, b"\0"))

    def ask(self, *data):
        mark = len(self.port.seen)
        self.send(*data)
        heard = self.port.expect(SLAVE, 0.3, mark)
        if heard is None:
            return None
        assert len(heard.data) == 8, "LSS messages have 8 bytes"
        return heard.data

    def switch(self, mode):
        self.send(SWITCH_GLOBAL, mode)

    def identity(self):
        return [self.device.read(0x1018, sub) for sub in (1, 2, 3, 4)]

    def address(self, first, identity):
        """The messages of a selective service, one number each; what the last is answered."""
        answers = [self.ask(first + i, *struct.pack("<I", value)) for i, value in enumerate(identity)]
        assert answers[:-1] == [None] * (len(answers) - 1)
        return answers[-1]


def test_a_device_that_is_waiting_answers_no_inquiry(lss):
    lss.switch(WAITING)
    assert [lss.ask(service) for service in (*INQUIRE, INQUIRE_NODE, NODE_ID, STORE)] == [None] * 7


def test_a_device_without_lss_does_not_answer(device, permit):
    permit("lss")
    permit("alone")
    if device.device_info.get("lss_supported", "0") == "1":
        pytest.skip("the EDS says LSS_Supported=1")
    lss = Lss(device)
    lss.switch(CONFIGURATION)
    assert lss.ask(INQUIRE_NODE) is None


def test_the_inquiries_give_identity_and_node_id(lss, device):
    identity = lss.identity()
    lss.switch(CONFIGURATION)
    for service, value in zip(INQUIRE, identity, strict=True):
        assert lss.ask(service) == bytes((service, *struct.pack("<I", value), 0, 0, 0))
    assert lss.ask(INQUIRE_NODE)[:2] == bytes((INQUIRE_NODE, device.node_id))


def test_a_device_is_selected_by_its_whole_identity_only(lss):
    identity = lss.identity()
    wrong = [*identity[:3], identity[3] ^ 1]
    assert lss.address(SELECT, wrong) is None
    assert lss.ask(INQUIRE_NODE) is None
    assert lss.address(SELECT, identity)[0] == SELECTED
    assert lss.ask(INQUIRE_NODE)[0] == INQUIRE_NODE


@pytest.mark.parametrize("node_id", [0, 128, 200, 254])
def test_a_node_id_that_there_is_not_is_refused(lss, node_id):
    lss.switch(CONFIGURATION)
    assert lss.ask(NODE_ID, node_id)[:2] == bytes((NODE_ID, 1))


def test_a_bit_timing_that_there_is_not_is_refused(lss):
    lss.switch(CONFIGURATION)
    assert lss.ask(BIT_TIMING, 0, 200)[:2] == bytes((BIT_TIMING, 1))
    assert lss.ask(BIT_TIMING, 1, 0)[0] == BIT_TIMING


def test_a_node_id_comes_into_force_with_a_reset_of_communication_and_goes_back(lss, device):
    old, new = device.node_id, device.node_id % 126 + 1
    for node_id in (new, old):
        lss.switch(CONFIGURATION)
        assert lss.ask(NODE_ID, node_id)[:2] == bytes((NODE_ID, 0))
        mark = len(device.port.seen)
        lss.switch(WAITING)
        present = new if node_id == old else old
        device.port.send(0x000, bytes((130, present)))
        assert device.port.expect(0x700 + node_id, device.boot_s, mark, b"\0") is not None
    assert device.read(0x1000) is not None


def test_identification_is_answered_by_the_range_that_it_names(lss):
    vendor, product, revision, serial = lss.identity()
    inside = (vendor, product, revision, revision, serial, serial)
    assert lss.address(IDENTIFY, inside)[0] == IDENTIFY_ANSWER
    for outside in (
        (vendor ^ 1, product, revision, revision, serial, serial),
        (vendor, product ^ 1, revision, revision, serial, serial),
        (vendor, product, revision + 1, revision + 2, serial, serial),
        (vendor, product, revision, revision, serial + 1, serial + 2),
    ):
        assert lss.address(IDENTIFY, outside) is None


def test_a_device_that_has_a_node_id_is_not_found_among_those_without(lss):
    assert lss.ask(UNCONFIGURED) is None
    assert lss.ask(FAST_SCAN, 0, 0, 0, 0, 0x80) is None


def test_fast_scan_finds_a_device_without_a_node_id(lss, device):
    identity, old = lss.identity(), device.node_id
    lss.switch(CONFIGURATION)
    assert lss.ask(NODE_ID, 255)[:2] == bytes((NODE_ID, 0))
    lss.switch(WAITING)
    device.port.send(0x000, bytes((130, old)))
    device.port.during(0.2)
    assert device.sdo.ask(b"\x40\0\x10\0", 0.1) is None, "without a node-ID there is LSS only"
    assert lss.ask(UNCONFIGURED)[0] == UNCONFIGURED_ANSWER
    assert scan(lss) == identity
    assert lss.ask(NODE_ID, old)[:2] == bytes((NODE_ID, 0)), "fast scan ends in configuration"
    mark = len(device.port.seen)
    lss.switch(WAITING)
    assert device.port.expect(0x700 + old, device.boot_s, mark, b"\0") is not None


def scan(lss):
    """The identity that fast scan finds, bit by bit (CiA 305, fastscan)."""
    assert lss.ask(FAST_SCAN, 0, 0, 0, 0, 0x80) is not None
    found = []
    for part in range(4):
        number = 0
        for bit in range(31, -1, -1):
            if lss.ask(FAST_SCAN, *struct.pack("<I", number), bit, part, part) is None:
                number |= 1 << bit
        following = part + 1 if part < 3 else 0
        assert lss.ask(FAST_SCAN, *struct.pack("<I", number), 0, part, following) is not None
        found.append(number)
    return found


def test_store_and_unknown_services_are_answered_as_the_standard_says(lss):
    lss.switch(CONFIGURATION)
    if lss.device.is_emulated:
        assert lss.ask(STORE)[0] == STORE
    assert lss.ask(3) is None
    assert lss.ask(255) is None


@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_message_of_a_wrong_length_is_ignored(lss, length):
    lss.switch(WAITING)
    lss.port.send(MASTER, bytes((SWITCH_GLOBAL, 1, 0, 0, 0, 0, 0, 0))[:length])
    assert lss.ask(INQUIRE_NODE) is None
