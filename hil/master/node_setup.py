"""Set-up of the nodes before a run, and their restoration after it."""

from drive_profiles.standard.cia301 import DataType, NmtCommand
from drive_profiles.standard.cia402 import Object, state_of
from hil.bench.bench import Bus
from hil.can.errors import ChannelError
from hil.errors import HilError
from hil.master.control_words import DISABLE_VOLTAGE, DISABLED
from hil.master.cyclic import CyclicExchange
from hil.master.drive.axis import DriveAxis
from hil.master.drive.needs import MissingObjectsError, ProfileGapsError, encoder_objects, objects_needed, profile_gaps
from hil.master.network import Network
from hil.master.supervision import Supervisor


class NodeSetup:
    """Set-up of a run's nodes, and restoration of their former contents."""

    def __init__(self, network: Network, bus: Bus, axes: list[DriveAxis], exchange: CyclicExchange) -> None:
        self._network, self._bus, self._axes, self._exchange = network, bus, axes, exchange

    def check(self, *, with_notch: bool) -> None:
        """Refuse a run for which a profile or a drive lacks something.

        The error has all that is missing; nothing is written.

        Raises:
            ProfileGapsError: A profile lacks what the run needs.
            MissingObjectsError: A drive lacks objects that the run needs.
            NoAnswerError: A drive is silent.
        """
        exchange = self._exchange
        gaps = [
            gap
            for axis in self._axes
            for gap in profile_gaps(axis.number, axis.table, axis.profile, exchange.loop, with_notch=with_notch)
        ]
        if gaps:
            raise ProfileGapsError(gaps)
        missing = []
        for axis in self._axes:
            needs = objects_needed(
                axis.table, axis.profile, exchange.loop, with_notch_state=exchange.with_notch_state,
                with_torque_offset=exchange.with_torque_offset,
            )  # fmt: skip
            missing.append((axis.number, axis.node, axis.snapshot.look(needs)))
        for axis in exchange.watched:
            needs = encoder_objects(axis.table, axis.profile, with_notch_state=exchange.with_notch_state)
            missing.append((axis.number, axis.node, axis.snapshot.look(needs)))
        if any(absent for _, _, absent in missing):
            raise MissingObjectsError([each for each in missing if each[2]])

    def set_up(self, supervisor: Supervisor, *, with_notch: bool) -> None:
        """Write limits, gains, filters, PDOs and supervision; start the nodes.

        Each object is read back.

        Args:
            supervisor: Supervisor that sends the first heartbeat and watches the drives from then on.
            with_notch: True if the drives' filters act.

        Raises:
            HilError: A node refuses, is silent, or does not hold a written value.
        """
        exchange, nodes = self._exchange, self._nodes(self._axes)
        for node in nodes:
            self._network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
        for axis, slot in zip(self._axes, exchange.slots, strict=True):
            axis.write_limits()
            axis.write_gains(exchange.loop)
            axis.write_notches(tuple(table.notch() for table in axis.table.notch) if with_notch else ())
            axis.write_mode(slot.mode, exchange.period_s)
        exchange.configure()
        for axis in self._axes:
            axis.write_supervision(self._bus.master_node_id, self._bus.heartbeat_s)
        supervisor.send_heartbeat()  # a drive watches from the first heartbeat on that it sees after it was told to
        for node in nodes:
            self._network.nmt(NmtCommand.START, node)
        supervisor.begin(axis.node for axis in self._axes)
        if exchange.with_torque_offset:
            for axis in self._axes:
                axis.snapshot.write(Object.TORQUE_OFFSET, 0, DataType.INTEGER16, 0, "torque offset")

    def tear_down(self) -> list[str]:
        """Restore all nodes; return the failures in words."""
        not_restored: list[str] = []
        try:
            for node in self._nodes(self._axes):
                self._network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
            disabled = [axis for axis in self._axes if self._is_disabled(axis)]
            for axis in self._axes:
                if axis in disabled:
                    not_restored += axis.restore()  # its supervision ends first
                else:  # it keeps its limits, and our heartbeat, which it watches, has stopped
                    not_restored.append(
                        f"node {axis.node} has not confirmed that it is disabled, so it keeps the limits of the run"
                    )
            not_restored += self._exchange.restore(set(self._nodes(disabled)))
        except ChannelError as error:
            not_restored.append(f"the bus: {error}")
        return not_restored

    def _nodes(self, axes: list[DriveAxis]) -> list[int]:
        """Return the nodes of these axes, of watched ones, and the sensor."""
        return [*(axis.node for axis in (*axes, *self._exchange.watched)), *self._exchange.sensor.nodes]

    def _is_disabled(self, axis: DriveAxis) -> bool:
        """True if a drive confirms by SDO that it is disabled.

        If it does not, the command is sent once more.
        """
        for attempt in range(2):
            try:
                if attempt:
                    self._network.write_raw(axis.node, Object.CONTROL_WORD, 0, DISABLE_VOLTAGE.to_bytes(2, "little"))
                word = self._network.read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16, "status word")
            except HilError:
                return False
            if state_of(word) in DISABLED:
                return True
        return False
