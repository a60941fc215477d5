"""The master in a test, whose runs are kept if it fails."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Self

import pytest

from drive_profiles.standard.cia301 import DataType
from hil.bench.bench import Bench
from hil.control.notch import FixedFilter
from hil.control.treatments import LoopName
from hil.errors import InterruptedRunError, NoAnswerError, NotPossibleError
from hil.master.cyclic import CyclicExchange
from hil.master.drive.mapping import ACCELERATION_OBJECT
from hil.master.motion import FilterUse, Motion, RunResult
from hil.master.sensor import DIGITS_OBJECT
from hil.master.session import Session
from hil.master.set_point_adder import SetPointAdder
from plant_emulator.pytest_plugin.target import Target


class BenchSession(Session):
    """A session with its target.

    Attributes:
        held: The exchange with the drive that a fixture has enabled, if one has.
    """

    def __init__(self, target: Target, bench: Bench) -> None:
        super().__init__(bench, target.channel(), target.log)
        self.target = target
        self.held: CyclicExchange | None = None

    def __enter__(self) -> Self:
        """Do nothing: the fixture opens and closes the session."""
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: the fixture opens and closes the session."""

    def run(
        self,
        motion: Motion,
        filters: FilterUse = "none",
        loop: LoopName = "drive",
        adder: SetPointAdder | None = None,
        fixed: Mapping[int, FixedFilter] | None = None,
        *,
        shows_filter: bool = True,
    ) -> RunResult:
        """Make one run; its result is kept if the test fails.

        Raises:
            KeyboardInterrupt: Ctrl-C; the axes have come to rest.
        """
        self.target.check_motion_is_allowed()
        if self.held is not None:
            what = "hil_drive holds its drive enabled, and a run needs it disabled"
            raise NotPossibleError(f"{what}; use hil_session without hil_drive")
        with self.interruptible():  # at other times Ctrl-C is pytest's own
            result = super().run(motion, filters, loop, adder, fixed, shows_filter=shows_filter)
        axes = "-".join(map(str, motion.axes))
        self.target.artefacts.add_run(f"axis-{axes}-{loop}-{filters}", result)
        if isinstance(result.stopped, InterruptedRunError):
            raise KeyboardInterrupt
        return result


@contextmanager
def open_session(target: Target, bench: Bench) -> Iterator[BenchSession]:
    """Open a session whose nodes have been found.

    A silent node on a real bus counts as missing hardware.
    """
    opened = BenchSession(target, bench)
    try:
        try:
            opened.bring_up()
        except NoAnswerError as error:
            if target.robot is not None:
                raise
            target.is_missing(f"{target.where}: {error}")
        yield opened
    finally:
        opened.close()
    if opened.not_restored and not target.interference.is_used:
        pytest.fail("these objects of the bench were not restored: " + "; ".join(opened.not_restored), pytrace=False)


class AccelerometerReadings:
    """X, Y and Z at the tip."""

    def __init__(self, session: BenchSession) -> None:
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
            raise NotPossibleError("a serial accelerometer is read only during a run; read the columns of its recording")
        network.sync()
        x, y, z = (
            network.read(node, ACCELERATION_OBJECT, sub, DataType.INTEGER16, "acceleration")
            * 10.0 ** -network.read(node, DIGITS_OBJECT, sub, DataType.UNSIGNED8, "decimal digits")
            for sub in (1, 2, 3)
        )
        return x, y, z
