"""The state machine of a drive, its modes and option codes (CiA 402-2 / IEC 61800-7-201). Enabling needs --allow-motion."""

import pytest

from tests.conformance.device import START
from tests.conformance.sdo_client import DEVICE_STATE, INVALID, TOO_HIGH, TOO_LOW, Abort

CONTROL, STATUS, MODE, DISPLAY, SUPPORTED = 0x6040, 0x6041, 0x6060, 0x6061, 0x6502
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80
STATES = {
    "not ready to switch on": (0x4F, 0x00),
    "switch on disabled": (0x4F, 0x40),
    "ready to switch on": (0x6F, 0x21),
    "switched on": (0x6F, 0x23),
    "operation enabled": (0x6F, 0x27),
    "quick stop active": (0x6F, 0x07),
    "fault reaction active": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}
"""Mask and value of the status word (CiA 402-2, status word)."""
OPTIONS = {
    0x605A: range(9),
    0x605B: range(2),
    0x605C: range(2),
    0x605D: range(1, 5),
    0x605E: range(5),
    0x6007: range(4),
}
"""Values of the option codes that the standard gives; negative ones are the manufacturer's."""
MODE_BITS = {1: 0, 2: 1, 3: 2, 4: 3, 6: 5, 7: 6, 8: 7, 9: 8, 10: 9, 11: 10}
"""Bit of 6502h of each mode."""
SETTLE_S = 2.0


@pytest.fixture
def drive(device, needs):
    needs(CONTROL, STATUS)
    return Drive(device)


class Drive:
    """Control word and state."""

    def __init__(self, device):
        self.device = device
        device.is_touched = True

    @property
    def state(self):
        word = self.device.read(STATUS)
        names = [name for name, (mask, value) in STATES.items() if word & mask == value]
        assert len(names) == 1, f"status word {word:04X}h is that of {names}"
        return names[0]

    def word(self, word, state):
        """Command, and the state within a time."""
        self.device.set(CONTROL, 0, word)
        for _ in range(20):
            if self.state == state:
                break
            self.device.port.during(SETTLE_S / 20)
        return self.state

    def disabled(self):
        """From wherever it is after a reset into Switch on disabled."""
        if self.state == "fault":
            self.word(0x00, "fault")
            self.word(FAULT_RESET, "switch on disabled")
        assert self.word(DISABLE_VOLTAGE, "switch on disabled") == "switch on disabled"

    def modes(self):
        """Modes that 6502h has, among those that the standard numbers."""
        bits = self.device.read(SUPPORTED) & 0xFFFF
        return [mode for mode, bit in MODE_BITS.items() if bits >> bit & 1]


def test_the_status_word_is_that_of_one_state(drive):
    assert drive.state in {"switch on disabled", "fault", "ready to switch on"}


def test_a_drive_becomes_ready_and_back_without_power(drive):
    drive.disabled()
    for _ in range(2):
        assert drive.word(SHUTDOWN, "ready to switch on") == "ready to switch on"
        assert drive.word(DISABLE_VOLTAGE, "switch on disabled") == "switch on disabled"
    drive.word(SHUTDOWN, "ready to switch on")
    assert drive.word(QUICK_STOP & ~0x02, "switch on disabled") == "switch on disabled"


@pytest.mark.parametrize("word", [SWITCH_ON, ENABLE, 0x1F, 0x8F, FAULT_RESET, 0x0D, 0x0B, 0x02])
def test_a_disabled_drive_leaves_its_state_by_shutdown_only(drive, permit, word):
    permit("motion")  # a drive that is wrong here is enabled
    drive.disabled()
    drive.device.set(CONTROL, 0, word)
    drive.device.port.during(0.05)
    assert drive.state == "switch on disabled"


def test_quick_stop_of_a_drive_without_power_disables_it(drive):
    drive.disabled()
    drive.word(SHUTDOWN, "ready to switch on")
    assert drive.word(QUICK_STOP, "switch on disabled") == "switch on disabled"


def test_a_fault_reset_without_a_fault_changes_nothing(drive):
    drive.disabled()
    drive.word(SHUTDOWN, "ready to switch on")
    for word in (0x00 | FAULT_RESET | SHUTDOWN, SHUTDOWN):
        drive.device.set(CONTROL, 0, word)
    assert drive.state in {"ready to switch on", "switch on disabled"}


def test_the_modes_are_those_of_6502h(drive, needs):
    needs(MODE, DISPLAY, SUPPORTED)
    drive.disabled()
    wrong, supported = [], drive.modes()
    assert supported, "6502h states no mode"
    for mode in range(-1, 13):
        if mode < 0:
            continue  # the manufacturer's
        answer = drive.device.write(MODE, 0, mode)
        if mode in supported:
            if answer is not None:
                wrong.append(f"mode {mode}: {answer!r}")
                continue
            drive.device.port.during(0.05)
            if drive.device.read(DISPLAY) != mode:
                wrong.append(f"mode {mode}: 6061h is {drive.device.read(DISPLAY)}")
        elif mode and answer is None:
            drive.device.port.during(0.05)
            if drive.device.read(DISPLAY) == mode or drive.device.is_emulated:
                wrong.append(f"mode {mode} is accepted, 6502h does not have it")
    assert wrong == []


def test_an_unsupported_mode_is_refused_by_its_value(drive, needs):
    needs(MODE, SUPPORTED)
    absent = next(mode for mode in (*MODE_BITS, 5, 12) if mode not in drive.modes())
    answer = drive.device.write(MODE, 0, absent)
    assert answer is None or drive.device.refused(answer, INVALID, TOO_HIGH, TOO_LOW)


@pytest.mark.parametrize("index", OPTIONS)
def test_an_option_code_takes_values_of_the_standard_only(drive, needs, index):
    needs(index)
    device, taken = drive.device, []
    before = device.sdo.upload(index)
    for value in range(16):
        answer = device.write(index, 0, value)
        if answer is None:
            taken.append(value)
            assert device.read(index) == value
        else:
            assert answer in {INVALID, TOO_HIGH, TOO_LOW, DEVICE_STATE}, f"{value}: {answer!r}"
    assert device.sdo.download(index, 0, before) is None
    assert taken
    assert set(taken) <= set(OPTIONS[index])


@pytest.mark.parametrize("index", [0x6083, 0x6084, 0x6085])
def test_a_ramp_of_0_is_refused_or_does_not_stay(drive, needs, index):
    needs(index)
    answer = drive.device.write(index, 0, 0)
    assert answer is None or answer in {INVALID, TOO_LOW, DEVICE_STATE}


# -- with the motor under torque ---------------------------------------------------------------------------------------


@pytest.fixture
def powered(drive, permit, needs):
    """A drive that may be enabled; afterwards it is without power again."""
    permit("motion")
    needs(MODE)
    drive.disabled()
    drive.device.nmt(START)
    mode = next((mode for mode in (1, 8) if mode in drive.modes()), None)
    if mode is None:
        pytest.skip("the drive has neither profile position nor cyclic position")
    drive.device.set(MODE, 0, mode)
    yield drive
    drive.word(DISABLE_VOLTAGE, "switch on disabled")


def enable(drive):
    assert drive.word(SHUTDOWN, "ready to switch on") == "ready to switch on"
    assert drive.word(SWITCH_ON, "switched on") == "switched on"
    state = drive.word(ENABLE, "operation enabled")
    if state == "switched on":
        pytest.skip("the drive does not enable: gains, supply or STO")
    assert state == "operation enabled"


def test_a_drive_is_enabled_and_disabled_by_its_control_words(powered):
    enable(powered)
    assert powered.word(SWITCH_ON, "switched on") == "switched on"
    assert powered.word(ENABLE, "operation enabled") == "operation enabled"
    assert powered.word(SHUTDOWN, "ready to switch on") == "ready to switch on"
    assert powered.word(SWITCH_ON, "switched on") == "switched on"
    assert powered.word(DISABLE_VOLTAGE, "switch on disabled") == "switch on disabled"


def test_quick_stop_ends_where_605ah_says(powered, needs):
    needs(0x605A)
    enable(powered)
    stays = powered.device.read(0x605A) >= 5
    end = "quick stop active" if stays else "switch on disabled"
    assert powered.word(QUICK_STOP, end) == end


def test_an_enabled_drive_stands_still(powered, needs):
    needs(0x6064, 0x608F)
    before = powered.device.read(0x6064)
    enable(powered)
    powered.device.port.during(0.2)
    turn = powered.device.read(0x608F, 1)
    assert abs(powered.device.read(0x6064) - before) < turn / 8


def test_a_lost_connection_is_acted_upon_as_6007h_says(powered, needs):
    needs(0x6007)
    if powered.device.write(0x6007, 0, 2) is not None:
        pytest.skip("6007h does not take 2, disable voltage")
    enable(powered)
    powered.device.nmt(128)
    powered.device.port.during(0.1)
    assert powered.state == "switch on disabled"


@pytest.fixture
def faulty(powered, needs):
    """An enabled drive in fault: the connection is lost with 6007h = 1."""
    needs(0x6007)
    if powered.device.write(0x6007, 0, 1) is not None:
        pytest.skip("6007h does not take 1, fault")
    enable(powered)
    powered.device.nmt(128)
    powered.word(ENABLE, "fault")
    if powered.state != "fault":
        pytest.skip("the drive is not in fault after a lost connection")
    powered.device.nmt(START)
    yield powered
    powered.device.reset()


def test_a_fault_is_reset_by_the_rising_edge_of_bit_7_only(faulty):
    for word in (SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE):
        faulty.device.set(CONTROL, 0, word)
        assert faulty.state == "fault"
    assert faulty.word(FAULT_RESET | ENABLE, "switch on disabled") == "switch on disabled", "never further than that"
    faulty.device.set(CONTROL, 0, FAULT_RESET | SHUTDOWN)
    assert faulty.state in {"switch on disabled", "ready to switch on"}


def test_a_fault_has_its_error_code_as_the_history_has(faulty, needs):
    """603Fh is the lower half of 1003h:01h; whether a reset of the fault clears it, devices decide differently."""
    needs(0x603F)
    assert faulty.device.read(0x603F) != 0
    faulty.word(DISABLE_VOLTAGE, "fault")
    faulty.word(FAULT_RESET, "switch on disabled")
    assert not isinstance(faulty.device.sdo.upload(0x603F), Abort)
    if faulty.device.is_emulated:
        assert faulty.device.read(0x603F) == faulty.device.read(0x1003, 1) & 0xFFFF != 0
        faulty.device.set(0x1003, 0, 0)
        assert faulty.device.read(0x603F) == 0
