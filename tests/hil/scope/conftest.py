import pytest

from drive_profiles.address import parse_address
from hil.can.opening import open_channel
from hil.emulator import EmulatorProcess
from hil.scope.process import ScopeProcess


@pytest.fixture(scope="module")
def bus():
    """Address of a local bus."""
    with EmulatorProcess("reference") as emulator:
        yield str(emulator.address)


@pytest.fixture(scope="module")
def scope(bus):
    """A scope on it, as a process of its own."""
    with ScopeProcess(bus, "reference", 0) as process:
        yield process


@pytest.fixture
def channel(bus):
    """A master on the bus."""
    one = open_channel(parse_address(bus))
    yield one
    one.close()
