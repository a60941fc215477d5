"""The accelerometer at the tip, as a test reads it."""

from drive_profiles.standard.cia301 import DataType
from hil.errors import NotPossibleError
from hil.master.drive.mapping import ACCELERATION_OBJECT
from hil.master.sensor import DIGITS_OBJECT
from plant_emulator.pytest_plugin.master import BenchSession


class AccelerometerReadings:
    """X, Y and Z at the tip."""

    def __init__(self, session: BenchSession) -> None:
        """Keep the session; nothing is read."""
        self._session = session

    def read(self) -> tuple[float, float, float]:
        """Read the acceleration in m/s².

        It is that of the last cycle while a drive is enabled, else that of an extra SYNC.

        Raises:
            HilError: It does not answer.
            NotPossibleError: It is not on the bus.
        """
        session = self._session
        if session.held is not None:
            return session.held.tip_m_s2
        node, network = session.bench.accelerometer.node_id, session.network
        if node is None:
            raise NotPossibleError("an accelerometer on a serial port is read in a run; see the columns of its recording")
        network.sync()
        x, y, z = (
            network.read(node, ACCELERATION_OBJECT, sub, DataType.INTEGER16, "acceleration")
            * 10.0 ** -network.read(node, DIGITS_OBJECT, sub, DataType.UNSIGNED8, "decimal digits")
            for sub in (1, 2, 3)
        )
        return x, y, z
