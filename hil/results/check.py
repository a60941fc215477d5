"""Result of `hil check`: checks of each axis before its first motion."""

from typing import Final, Literal

from pydantic import Field

from hil.results.base import MeasuredResult, ResultPart

CHECK_FILE: Final = "check.json"

Verdict = Literal["PASS", "FAIL", "NOT JUDGED"]
"""`NOT JUDGED`: the measurement does not decide."""


class CheckEntry(ResultPart):
    """One check of one axis.

    Attributes:
        seen: Observation in words, or the reason why the check was not made.
        is_made: False for a check that could not be made, because another failed, or the axis could not be moved.
        recording: Recording that shows it, relative to the file; None without one.
    """

    axis: int
    name: str
    verdict: Verdict
    seen: str
    is_made: bool = True
    recording: str | None = None


class CheckResult(MeasuredResult):
    """Content of `check.json`.

    Attributes:
        axes: Numbers of the axes that were to be checked.
    """

    kind: Literal["check"] = "check"
    axes: tuple[int, ...]
    checks: tuple[CheckEntry, ...] = Field(default=())

    @property
    def failed(self) -> tuple[CheckEntry, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.verdict == "FAIL")

    @property
    def not_made(self) -> tuple[CheckEntry, ...]:
        """The checks that could not be made."""
        return tuple(check for check in self.checks if not check.is_made)
