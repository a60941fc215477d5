"""Results of the checks, and their words."""

from collections.abc import Callable
from dataclasses import dataclass

from hil.commissioning.held import HeldAxis
from hil.master.session import Session
from hil.recording import Recording
from hil.results.check import CheckEntry, Verdict

Keep = Callable[[Recording, str], str]
"""Function that saves a recording under a name, and gives its path."""


@dataclass(frozen=True)
class Checked:
    """One axis that is being checked."""

    session: Session
    number: int
    keep: Keep

    def entry(self, name: str, verdict: Verdict, seen: str, recording: str | None = None) -> CheckEntry:
        """One check of this axis."""
        return CheckEntry(axis=self.number, name=name, verdict=verdict, seen=seen, recording=recording)

    def not_made(self, name: str, why: str) -> CheckEntry:
        """One check that could not be made, and why."""
        return CheckEntry(axis=self.number, name=name, verdict="NOT JUDGED", seen=why, is_made=False)

    def stopped(self, name: str, held: HeldAxis, when: str, recording: str | None = None) -> CheckEntry:
        """Return a failed check in which the axis was stopped.

        If the reason lies in the master, the check is not made: the stop proves nothing about the robot.
        """
        seen = f"stopped {when}: {held.stopped}"
        return self.not_made(name, seen) if held.is_masters_fault else self.passed(name, False, seen, recording)

    def passed(self, name: str, is_good: bool, seen: str, recording: str | None = None) -> CheckEntry:
        """One check that passed or failed."""
        return self.entry(name, "PASS" if is_good else "FAIL", seen, recording)
