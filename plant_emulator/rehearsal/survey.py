"""The survey of a robot: its true tip under each treatment, its floor, and what the trial makes of wrong corrections."""

from collections.abc import Iterator
from contextlib import contextmanager

from hil.bench.bench import Bench
from hil.bench.design import with_designs
from hil.bench.model import Identified
from hil.errors import HilError
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.motions import constant_acceleration
from hil.experiments.treatment import Knowledge
from hil.master.motion import FilterUse
from hil.master.session import Session
from hil.recording import Recording
from plant_emulator.rehearsal.direct import DirectChannel
from plant_emulator.rehearsal.record import ProbeRecord
from plant_emulator.rehearsal.truth import quiet, tip_by_order_mm, true_f_al_hz, without_error
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World


class Survey:
    """Runs of the user's motion on a quiet sensor.

    Args:
        robot: The robot.
        bench: Its bench file.
        axis: Number of the axis.
    """

    def __init__(self, robot: Robot, bench: Bench, axis: int) -> None:
        self._robot, self._bench, self._axis = robot, bench, axis
        self._f_al_hz = true_f_al_hz(bench, robot, axis)

    def tip(self, treatment: str, knowledge: Knowledge) -> dict[int, float]:
        """True tip by order under a treatment, in mm."""
        bench, model = self._bench, None
        filters: FilterUse = "none"
        if treatment == "notch":
            filters = "notch"
        elif treatment == "notch_designed" and knowledge.designs is not None:
            bench, filters = with_designs(bench, knowledge.designs), "notch"
        elif treatment == "cancellation":
            model = knowledge.identified
        elif treatment == "cancellation_learnt":
            model = knowledge.learnt
        recording = self._record(self._robot, bench, filters, model)
        return {} if recording is None else tip_by_order_mm(recording, self._axis, self._f_al_hz)

    def floor(self) -> dict[int, float]:
        """The same without a transmission error."""
        recording = self._record(without_error(self._robot), self._bench, "none", None)
        return {} if recording is None else tip_by_order_mm(recording, self._axis, self._f_al_hz)

    def probes(self, knowledge: Knowledge) -> dict[str, ProbeRecord]:
        """What the trial makes of wrong corrections, by the names of `record.PROBES`."""
        return {}

    def _record(self, robot: Robot, bench: Bench, filters: FilterUse, model: Identified | None) -> Recording | None:
        """Run the user's motion; None where the product refuses or stops it."""
        with _session(quiet(robot), bench) as session:
            motion = constant_acceleration(bench, self._axis, bench.bus.sync_period_s)
            try:
                adder = None if model is None else cancellation_on(session, model, motion).adder()
                result = session.run(motion, filters, "drive", adder, shows_filter=False)
            except HilError:
                return None
        return None if result.stopped is not None else result.recording


@contextmanager
def _session(robot: Robot, bench: Bench) -> Iterator[Session]:
    """A session on a robot of its own."""
    with DirectChannel(World(robot)).session(bench) as session:
        session.bring_up()
        yield session
