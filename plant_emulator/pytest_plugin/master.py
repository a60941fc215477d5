"""The master in a test: its runs are kept for the case of a failure, and Ctrl-C ends a motion by a ramp and then the tests."""

import signal
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Self

import pytest

from drive_profiles.cia402 import Mode
from hil.control.notch import FixedFilter
from hil.errors import InterruptedRunError, NoAnswerError, NotPossibleError
from hil.master.axis import DriveAxis
from hil.master.bench import Bench
from hil.master.correction import Corrector
from hil.master.cyclic import CyclicPlan
from hil.master.motion import Motion, RunResult
from hil.master.session import Compensation, Loop, Session
from plant_emulator.pytest_plugin.target import Target


class BenchSession(Session):
    """A session that knows where it runs.

    Attributes:
        target: Where.
        held: The plan of the drive that a fixture has enabled, if one has.
    """

    def __init__(self, target: Target, bench: Bench) -> None:
        """Open the bus; nothing is sent."""
        super().__init__(bench, target.channel(), target.log)
        self.target = target
        self.held: CyclicPlan | None = None

    def __enter__(self) -> Self:
        """Nothing: the fixture opens and closes it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing: the fixture opens and closes it."""

    def close(self) -> None:
        """Let go of what was opened beside the bus."""
        super().__exit__()

    @contextmanager
    def moving(self) -> Iterator[None]:
        """Ctrl-C ends what moves by a ramp, and then the tests; at other times it is pytest's own."""
        super().__enter__()
        try:
            yield
        finally:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)  # type: ignore[arg-type]
            self._handlers.clear()

    def run(
        self,
        motion: Motion,
        compensation: Compensation = "none",
        loop: Loop = "drive",
        corrector: Corrector | None = None,
        fixed: Mapping[int, FixedFilter] | None = None,
        *,
        shows_filter: bool = True,
    ) -> RunResult:
        """One run, as `hil.master.session.Session.run` has it; what it gives is kept if the test fails.

        Raises:
            KeyboardInterrupt: Ctrl-C; the axes have come to rest.
        """
        self.target.check_motion_is_allowed()
        if self.held is not None:
            raise NotPossibleError("the drive fixture holds its drive enabled; a run needs it disabled")
        with self.moving():
            result = super().run(motion, compensation, loop, corrector, fixed, shows_filter=shows_filter)
        axes = "-".join(map(str, motion.axes))
        self.target.artefacts.add_run(f"axis-{axes}-{loop}-{compensation}", result)
        if isinstance(result.stopped, InterruptedRunError):
            raise KeyboardInterrupt
        return result

    def plan(self, axis: DriveAxis, period: float) -> CyclicPlan:
        """The cycles of one drive that closes its own loop."""
        lateness = self.bench.bus.max_lateness_s
        return CyclicPlan(self.network, [axis], self._accelerometer, period, mode=Mode.CSP, with_notch_state=False,
                          clock=self.clock, max_lateness_s=lateness)  # fmt: skip

    def prepare(self, axis: DriveAxis, plan: CyclicPlan, period: float, context: ExitStack) -> None:
        """Set one drive up as a run does, its nodes started; `context` puts back what was changed."""
        self._check_lateness(period)
        self._real_time(context)
        context.callback(self._tear_down, [axis], plan)
        self._set_up([axis], plan, "none", "drive", plan.mode, period)


@contextmanager
def open_session(target: Target, bench: Bench) -> Iterator[BenchSession]:
    """A session whose nodes have been found; a node that is silent on a real bus counts as missing hardware."""
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
        pytest.fail("the bench is not as it was found: " + "; ".join(opened.not_restored), pytrace=False)
