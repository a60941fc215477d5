"""What can be wrong in this package: one root, attributes first, the message made from them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class DriveProfileError(Exception):
    """Root of all errors of this package."""


class OutOfRangeError(DriveProfileError, ValueError):
    """A value that the object on the wire cannot hold. It is refused, never clamped.

    Args:
        what: The quantity, e.g. ``torque``.
        value: What was asked for, in ``unit``.
        unit: Printable unit of ``value``.
        reason: Why it cannot be represented, with the limits.
    """

    def __init__(self, what: str, value: object, unit: str, reason: str) -> None:
        self.what = what
        self.value = value
        self.unit = unit
        self.reason = reason
        super().__init__(f"{what} {value}{f' {unit}' if unit else ''}: {reason}")


class Problem(NamedTuple):
    """One thing wrong in a file.

    Args:
        line: Counted from 1; 0 where the file as a whole is meant.
        key: Dotted key path, empty for a syntax error.
        message: What was found.
        expected: What should have been there.
    """

    line: int
    key: str
    message: str
    expected: str


class FileError(DriveProfileError):
    """A file that cannot be used, with everything that is wrong in it.

    Args:
        path: The file.
        problems: All of them, by line.
    """

    def __init__(self, path: Path, problems: tuple[Problem, ...]) -> None:
        self.path = path
        self.problems = problems
        super().__init__("\n".join(_line(path, problem) for problem in problems))


class ProfileNotFoundError(DriveProfileError):
    """No profile of that name is in the package.

    Args:
        name: What was asked for.
        available: What there is.
    """

    def __init__(self, name: str, available: tuple[str, ...]) -> None:
        self.name = name
        self.available = available
        super().__init__(f"no drive profile {name!r}; available: {', '.join(available) or 'none'}")


class UnknownParameterError(DriveProfileError, KeyError):
    """A profile has no parameter of that name.

    Args:
        profile: The profile's name.
        name: What was asked for.
        close: What it may have meant, best first.
    """

    def __init__(self, profile: str, name: str, close: tuple[str, ...]) -> None:
        self.profile = profile
        self.name = name
        self.close = close
        super().__init__(profile, name, close)

    def __str__(self) -> str:
        hint = f", did you mean {' or '.join(self.close)}?" if self.close else ""
        return f"profile {self.profile} has no parameter {self.name!r}{hint}"


def _line(path: Path, problem: Problem) -> str:
    place = f"{path}:{problem.line}" if problem.line else f"{path}"
    key = f"{problem.key}: " if problem.key else ""
    expected = f"; expected {problem.expected}" if problem.expected else ""
    return f"{place}: {key}{problem.message}{expected}"
