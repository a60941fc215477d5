"""A scope joins any bus as a listener: here one of python-can's, between processes."""

import errno
import os

import can
import pytest

from drive_profiles.address import Address
from hil.can.adapter import AdapterChannel
from hil.can.errors import BusUnavailableError
from hil.scope.process import ScopeProcess
from tests.hil.scope.traffic import Traffic, played
from tests.hil.scope.viewer import all_rows_of, look

CYCLES = 300


@pytest.fixture
def udp():
    """Address of a bus of python-can's that is a multicast group, this process' own."""
    pytest.importorskip("msgpack")
    address = Address("udp_multicast", f"239.74.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}")
    try:
        can.Bus(interface=address.interface, channel=address.channel).shutdown()
    except OSError as error:
        if error.errno not in {errno.ENODEV, errno.ENETUNREACH, errno.EADDRNOTAVAIL}:
            raise
        pytest.skip(f"no multicast on this machine: {error}")
    return address


@pytest.mark.slow
def test_a_scope_joins_a_bus_of_python_can_and_shows_every_row(udp):
    try:
        channel = AdapterChannel(udp)
    except BusUnavailableError as error:
        pytest.skip(str(error))
    with ScopeProcess(str(udp), "reference", 0) as scope:
        played(channel, Traffic((41, 42), 2_000_000).set_up().run(CYCLES).heard(), 60.0)
        time_s, values = look(scope, all_rows_of("node 42 position", CYCLES - 1))
    channel.close()
    assert values == pytest.approx([count / 1000 for count in range(CYCLES - 1)])
    assert (time_s[1:] > time_s[:-1]).all()
