"""Options and fixtures of the conformance suite; docs/conformance.md says how to run it against a real device."""

from pathlib import Path

import can
import pytest

from drive_profiles import eds
from drive_profiles.address import parse_address
from drive_profiles.errors import DriveProfileError
from tests.conformance import emulated
from tests.conformance.device import Device
from tests.conformance.ports import CanPort

PERMITS = ("motion", "store", "lss", "alone", "factory", "manufacturer")
REAL = "the device"
_NOT_PUT_BACK = pytest.StashKey[list]()


def pytest_addoption(parser):
    group = parser.getgroup("conformance", "CANopen conformance suite")
    add = group.addoption
    add("--bus", dest="conformance_bus", metavar="ADDRESS", help="Bus of a real device: interface:channel[@bitrate].")
    add("--node", dest="conformance_node", type=int, metavar="N", help="Its node-ID, 1 to 127.")
    add("--eds", dest="conformance_eds", metavar="FILE", help="Its EDS.")
    add("--answer-timeout", dest="conformance_answer_s", type=float, default=1.0, metavar="S", help="For an SDO answer.")
    add("--boot-timeout", dest="conformance_boot_s", type=float, default=10.0, metavar="S", help="From reset to boot-up.")
    for name, words in (
        ("store", "write to 1010h and 1011h: its memory wears, and what was stored is lost"),
        ("motion", "enable its power stage"),
        ("lss", "LSS: its node-ID is changed for a moment"),
        ("alone", "SYNC, broadcasts and global LSS: nothing else on the bus can be disturbed"),
        ("factory", "compare with the defaults of the EDS: it is as delivered"),
        ("manufacturer", "write to its objects 2000h to 5FFFh"),
    ):
        add(_named(name), dest=f"conformance_{name}", action="store_true", help=f"Of the real device: {words}.")


def _named(permit):
    return f"--{permit}" if permit in {"alone", "factory"} else f"--allow-{permit}"


def _option(config, name):
    return config.getoption(f"conformance_{name}", None)


def pytest_generate_tests(metafunc):
    if "device" in metafunc.fixturenames:
        names = [REAL] if _option(metafunc.config, "bus") else emulated.NAMES
        metafunc.parametrize("device_session", names, indirect=True, scope="session")


def pytest_collection_modifyitems(config, items):
    """Of a real device, only what looks at a device."""
    if _option(config, "bus"):
        others = [item for item in items if "device" not in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item not in others]


@pytest.fixture(scope="session")
def device_session(request):
    """The device, opened once; at the end it is as it was found, or the summary says what is not."""
    config = request.config
    if request.param != REAL:
        yield emulated.emulated_device(request.param)
        return
    path, node = _option(config, "eds"), _option(config, "node")
    if path is None or node is None or not 1 <= node <= 127:
        pytest.exit("--bus needs --node N, 1 to 127, and --eds FILE", returncode=4)
    permits = {name for name in PERMITS if _option(config, name)}
    try:
        description = eds.load(Path(path), node_id=node)
        port = CanPort(str(parse_address(_option(config, "bus"))))
    except (DriveProfileError, ValueError, OSError, can.CanError) as error:
        pytest.exit(f"{_option(config, 'bus')}, {path}: {error}", returncode=4)
    device = Device(
        REAL, node, port, description, _option(config, "answer_s"), _option(config, "boot_s"), frozenset(permits),
        device_info=emulated.device_info(Path(path)),
    )  # fmt: skip
    held = device.snapshot()
    yield device
    device.put_back(held)
    config.stash[_NOT_PUT_BACK] = device.not_restored_words
    port.close()


@pytest.fixture
def device(device_session):
    """The device, pre-operational, with what it holds after a reset; whoever changes something leaves it reset."""
    device_session.port.clear()
    yield device_session
    if device_session.is_touched:
        device_session.reset()
        device_session.is_touched = False
    device_session.port.clear()


@pytest.fixture
def permit(device):
    """Skip what the user of a real device has not allowed."""

    def need(name):
        if not device.may(name):
            pytest.skip(f"{_named(name)} is not given")

    return need


@pytest.fixture
def needs(device):
    """Skip where the EDS says that the device lacks an optional object."""

    def need(*places):
        for place in places:
            index, subindex = place if isinstance(place, tuple) else (place, 0)
            if not device.has(index, subindex):
                pytest.skip(f"the EDS has no {index:04X}h:{subindex:02X}h")

    return need


def pytest_terminal_summary(terminalreporter, config):
    left = config.stash.get(_NOT_PUT_BACK, None)
    if left:
        terminalreporter.section("not restored on the device")
        for line in left:
            terminalreporter.write_line(line)
