"""Layer setting services (LSS, CiA 305) on a bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from canopen.lss import LssError, LssMaster

from drive_profiles.device.bus import SdoBus
from drive_profiles.errors import NoLssAnswerError, RefusedError
from drive_profiles.standard.cia305 import BIT_TIMINGS, UNCONFIGURED

BIT_RATES = {rate: index for index, rate in BIT_TIMINGS.items()}
"""Bit rates and their index in the standard's table of bit timings."""
_REMEDY = "check its identity, its supply and its NMT state"


class LssAddress(NamedTuple):
    """LSS address of a node: the four numbers of 1018h, in order."""

    vendor_id: int
    product_code: int
    revision: int
    serial_number: int

    def __str__(self) -> str:
        """Return the address as `--identity` takes it."""
        return f"0x{self.vendor_id:X},0x{self.product_code:X},0x{self.revision:X},{self.serial_number}"


class Lss:
    """LSS master through canopen, for the one node in configuration state."""

    def __init__(self, bus: SdoBus, timeout_s: float) -> None:
        self._bus, self._timeout_s = bus, timeout_s
        master: Any = LssMaster()  # which has no types
        master.RESPONSE_TIMEOUT, master.network = timeout_s, _Sender(bus)  # as much of a network as it uses
        self._master = master
        bus.on_lss = lambda data: self._master.on_message_received(self._master.LSS_RX_COBID, data, 0.0)

    @contextmanager
    def chosen(self, address: LssAddress | None, *, unconfigured: bool = False) -> Iterator[LssAddress]:
        """Put one node in configuration state; return all to waiting afterwards.

        Args:
            address: Its address; None for the only node of the bus.
            unconfigured: It is one without a node-ID, found by fast scan.

        Raises:
            NoLssAnswerError: No such node answers.
        """
        self._all_wait()
        try:
            if unconfigured:
                found, numbers = self._master.fast_scan()
                if not found:
                    raise NoLssAnswerError(
                        "the LSS fast scan",
                        self._timeout_s,
                        "either every node has a node-ID already, or no node is powered: check the supply",
                    )
                yield LssAddress(*numbers)
            elif address is not None:
                if not self._tried(lambda: self._master.send_switch_state_selective(*address)):
                    raise NoLssAnswerError(f"LSS as {address}", self._timeout_s, _REMEDY)
                yield address
            else:
                self._master.send_switch_state_global(self._master.CONFIGURATION_STATE)
                yield LssAddress(*(self._asked(0x5A + part) for part in range(4)))
        finally:
            self._all_wait()

    def node_id(self) -> int | None:
        """Return the node-ID of the chosen node, or None.

        Raises:
            NoLssAnswerError: It does not answer.
        """
        found = self._tried(self._master.inquire_node_id)
        if found is None or found is False:
            raise NoLssAnswerError("the LSS inquiry of its node-ID", self._timeout_s, _REMEDY)
        return None if found == UNCONFIGURED else int(found)

    def configure_node_id(self, node_id: int) -> None:
        """Give the chosen node a node-ID.

        It takes effect with the node's next reset of communication.

        Raises:
            RefusedError: It refuses.
        """
        self._configured(lambda: self._master.configure_node_id(node_id), f"node-ID {node_id}")

    def configure_bit_rate(self, bitrate: int) -> None:
        """Give the chosen node a bit rate.

        It takes effect once it is stored and the node has been power-cycled.

        Raises:
            RefusedError: It refuses, or there is no such bit rate.
        """
        if bitrate not in BIT_RATES:
            raise RefusedError(f"{bitrate} bit/s is not a bit rate of CiA 305; expected one of {', '.join(map(str, BIT_RATES))}")
        self._configured(lambda: self._master.configure_bit_timing(BIT_RATES[bitrate]), f"{bitrate} bit/s")

    def store(self) -> None:
        """Store node-ID and bit rate of the chosen node.

        Raises:
            RefusedError: It refuses.
        """
        self._configured(self._master.store_configuration, "store")

    def _all_wait(self) -> None:
        self._master.send_switch_state_global(self._master.WAITING_STATE)

    def _asked(self, service: int) -> int:
        found = self._tried(lambda: self._master.inquire_lss_address(service))
        if found is None:
            raise NoLssAnswerError("the LSS inquiry of its identity", self._timeout_s, _REMEDY)
        return int(found)

    def _configured(self, action: Any, what: str) -> None:
        try:
            action()
        except LssError as error:
            raise RefusedError(f"LSS {what}: {error}") from error

    def _tried(self, action: Any) -> Any:
        try:
            return action()
        except LssError:
            return None


class _Sender(NamedTuple):
    """As much of canopen's network as its LSS master uses."""

    bus: SdoBus

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Put a frame on the bus."""
        self.bus.send(can_id, bytes(data))
