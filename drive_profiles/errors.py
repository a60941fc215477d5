"""Errors of this package."""

import difflib
import math
from pathlib import Path
from typing import ClassVar, NamedTuple


class DriveProfileError(Exception):
    """Root of this package's errors, with the exit status of a command."""

    exit_code: ClassVar[int] = 3


class OutOfRangeError(DriveProfileError, ValueError):
    """A value that the object cannot hold; it is refused, never clamped."""

    def __init__(self, what: str, value: object, unit: str, reason: str) -> None:
        self.what, self.value, self.unit, self.reason = what, value, unit, reason
        super().__init__(f"{what} {value}{f' {unit}' if unit else ''}: {reason}")


def beyond(low: float, high: float) -> str:
    """Return the reason why a value outside the limits is refused."""
    if math.isinf(low):
        return f"must be at most {high:.10g}"
    return f"must be at least {low:.10g}" if math.isinf(high) else f"is outside {low:.10g} to {high:.10g}"


class Problem(NamedTuple):
    """One thing wrong in a file.

    Line 0 is the file as a whole; the key is a dotted path, empty for a syntax error; `expected` is wanted there instead.
    """

    line: int
    key: str
    message: str
    expected: str


class FileError(DriveProfileError):
    """A file that cannot be used, with its problems sorted by line."""

    def __init__(self, path: Path, problems: tuple[Problem, ...]) -> None:
        self.path, self.problems = path, problems
        super().__init__("\n".join(_line(path, problem) for problem in problems))


class ProfileNotFoundError(DriveProfileError, ValueError):
    """The package has no drive profile of that name."""

    def __init__(self, name: str, available: tuple[str, ...]) -> None:
        close = difflib.get_close_matches(name, available, n=1)
        hint = f", did you mean {close[0]}?" if close else ";"
        listed = ", ".join(available) or "none"
        super().__init__(f"no drive profile {name!r}{hint} available: {listed}; drive-profiles list describes them")


class UnknownProductError(DriveProfileError, ValueError):
    """A product code or name (1018h:2) that the profile does not have."""

    def __init__(self, profile: str, product: int | str | None, revision: int | None, known: tuple[str, ...]) -> None:
        if isinstance(product, str):
            super().__init__(f"profile {profile} has no product {product!r}; it has {', '.join(known)}")
            return
        held = "not given" if product is None else f"0x{product:X}"
        if revision is not None and any("revision" in each for each in known):
            held += f" of revision 0x{revision:08X}"
        super().__init__(f"its product (1018h:2) is {held}, profile {profile} says {' or '.join(known)}")


class UnknownParameterError(DriveProfileError, KeyError):
    """A profile has no such parameter; `close` has similar names, best first."""

    def __init__(self, profile: str, name: str, close: tuple[str, ...]) -> None:
        self.profile, self.name, self.close = profile, name, close
        super().__init__(profile, name, close)

    def __str__(self) -> str:
        hint = f", did you mean {' or '.join(self.close)}?" if self.close else ""
        return f"profile {self.profile} has no parameter {self.name!r}{hint}"


class UnknownObjectError(DriveProfileError):
    """An object that neither profile nor EDS has, and similar names."""

    exit_code = 2

    def __init__(self, text: str, close: tuple[str, ...] = ()) -> None:
        self.text, self.close = text, close
        hint = (
            f"did you mean {' or '.join(close)}?" if close else "write it as 0x2147:1, or give a profile or an EDS that names it"
        )
        super().__init__(f"no object {text!r}; {hint}")


class AmbiguousNameError(DriveProfileError):
    """A name that fits several objects; `candidates` has addresses and names."""

    exit_code = 2

    def __init__(self, text: str, candidates: tuple[str, ...]) -> None:
        self.text, self.candidates = text, candidates
        super().__init__(f"{text!r} may be any of {', '.join(candidates)}; give its address instead of a name")


class RefusedError(DriveProfileError):
    """A request that is refused before anything has been written."""

    def __init__(self, *reasons: str) -> None:
        self.reasons = reasons
        super().__init__("\n".join(reasons))


class BusError(DriveProfileError):
    """The bus does not exist, or was lost."""

    exit_code = 4


class NodeError(DriveProfileError):
    """A node that cannot be used as it is, with a remedy."""

    exit_code = 5

    def __init__(self, node: int, what: str, remedy: str = "") -> None:
        self.node, self.what, self.remedy = node, what, remedy
        super().__init__(f"node {node}: {what}" + (f"; {remedy}" if remedy else ""))


class NoAnswerError(NodeError):
    """A node did not answer in time."""

    def __init__(self, node: int, what: str, after_s: float) -> None:
        self.after_s = after_s
        super().__init__(node, f"no answer to {what} within {after_s:g} s", "check its supply and the node-ID")


class NoLssAnswerError(NoAnswerError):
    """No node has answered an LSS service, which knows no node-ID."""

    def __init__(self, what: str, after_s: float, remedy: str) -> None:
        self.node, self.what, self.after_s, self.remedy = 0, what, after_s, remedy
        DriveProfileError.__init__(self, f"no node answers {what} within {after_s:g} s; {remedy}")


class SharedNodeError(NoAnswerError):
    """A node whose answers were lost or went to another client."""

    def __init__(self, node: int, what: str, after_s: float) -> None:
        self.after_s = after_s
        remedy = "end the other program, or wait until it is done"
        NodeError.__init__(self, node, f"no answer to {what} within {after_s:g} s; another SDO client talks to this node", remedy)


class SdoAbortedError(DriveProfileError):
    """A node refused to read or write an object.

    `text` is the standard's meaning of the code or the maker's, `action` the refused access: ``read`` or ``write of …``.
    """

    exit_code = 6

    def __init__(self, node: int, index: int, subindex: int, code: int, text: str, name: str = "", action: str = "read") -> None:
        self.node, self.index, self.subindex, self.code, self.name, self.action = node, index, subindex, code, name, action
        label = f" ({name})" if name else ""
        self.text = text
        super().__init__(f"node {node}: {action} of {index:04X}h:{subindex:X}{label} aborted: 0x{code:08X}, {text}")


class NotRealisableError(DriveProfileError):
    """A design that a drive cannot hold, or that lacks facts."""

    exit_code = 9

    def __init__(self, profile: str, reasons: tuple[str, ...]) -> None:
        self.profile, self.reasons = profile, reasons
        super().__init__(f"{profile}: {'; '.join(reasons)}")


class InterruptedUploadError(DriveProfileError):
    """The user interrupted the upload."""

    exit_code = 130


def _line(path: Path, problem: Problem) -> str:
    where = f"{path}:{problem.line}" if problem.line else f"{path}"
    key = f"{problem.key}: " if problem.key else ""
    expected = f"; expected {problem.expected}" if problem.expected else ""
    return f"{where}: {key}{problem.message}{expected}"
