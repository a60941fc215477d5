"""Errors of the bench, with attributes, message and exit status."""

from pathlib import Path
from typing import ClassVar, Literal

from drive_profiles import errors

RefusalCause = Literal[
    "limits", "bus load", "cycle", "noise", "encoder", "nothing to cancel", "another source of vibration", "wrong axis or wiring"
]
"""What of robot or bench lets a refusal happen, as far as the place that refuses can tell."""


class HilError(Exception):
    """Root of the bench's errors.

    Attributes:
        causes: Causes that the refusal names, any of which may be the true one; may be empty.
    """

    exit_code: ClassVar[int] = 1
    causes: tuple[RefusalCause, ...] = ()


class FileProblemError(HilError):
    """A file cannot be used; base of the errors of each kind of file."""

    exit_code: ClassVar[int] = 3

    def __init__(self, path: Path, problem: str) -> None:
        self.path, self.problem = path, problem
        super().__init__(f"{path}: {problem}")


class LogError(FileProblemError):
    """The file is not a log of a bus, or has no frames."""


class ExportError(FileProblemError):
    """A source has nothing for an exported file, or contradictory units."""


class RecordingFileError(FileProblemError, ValueError):
    """A recording, or a given layout, cannot be used."""


class MissingPackageError(HilError):
    """A format needs a package that is not installed."""

    exit_code = 3

    def __init__(self, path: Path, package: str, extra: str) -> None:
        self.path, self.package, self.extra = path, package, extra
        super().__init__(f"{path}: this format needs {package}, which is not installed: pip install 'hil-bench[{extra}]'")


class UnsafeRequestError(HilError):
    """A request would exceed a limit; nothing has been sent.

    The limit is one of the bench file.
    """

    exit_code = 3
    causes = ("limits",)

    def __init__(self, what: str, value: float, limit: float, unit: str, remedy: str = "") -> None:
        self.what, self.value, self.limit, self.unit = what, value, limit, unit
        tail = f"; {remedy}" if remedy else ""
        digits = next((n for n in range(4, 12) if f"{value:.{n}g}" != f"{limit:.{n}g}"), 4)  # told from the limit
        super().__init__(f"{what} would be {value:.{digits}g} {unit}; the limit is {limit:.{digits}g} {unit}{tail}")


class NotPossibleError(HilError):
    """A request that drive, profile or bench file cannot fulfil."""

    exit_code = 3

    def __init__(self, what: str, causes: tuple[RefusalCause, ...] = ()) -> None:
        self.what, self.causes = what, causes
        super().__init__(what)


class NodeError(errors.NodeError, HilError):
    """A node is not as the bench needs it."""


class NoAnswerError(errors.NoAnswerError, NodeError):
    """A node did not answer in time."""


class SharedNodeError(errors.SharedNodeError, NoAnswerError):
    """A node did not answer, and another SDO client talks to it."""


class WrongIdentityError(NodeError):
    """Another device than the bench file names answers at this node."""

    def __init__(self, node: int, what: str, expected: int, found: int) -> None:
        self.expected, self.found = expected, found
        super().__init__(node, f"{what} is 0x{found:X}; the profile says 0x{expected:X}", "is this the right bench file?")


class AlreadyMovingError(NodeError):
    """An axis is enabled or turns without a command of this bench."""


class SdoAbortedError(errors.SdoAbortedError, HilError):
    """A node refused an access."""


class ReadBackError(HilError):
    """An object does not hold the value that was written to it."""

    exit_code = 6

    def __init__(self, node: int, index: int, subindex: int, written: bytes, read: bytes) -> None:
        self.node, self.index, self.subindex, self.written, self.read = node, index, subindex, written, read
        super().__init__(
            f"node {node}: object {index:04X}h:{subindex:02X}h holds {read.hex(' ')} after {written.hex(' ')} was written"
        )


NOT_DISABLED = "NOT every drive has confirmed that it is disabled"
"""The words for the end of a stop after which torque may still act."""


DISABLED = "all axes are stopped and disabled, and their drives close the brakes"
"""The words for the end of a stop that every drive has confirmed."""


def not_restored_words(what: str) -> str:
    """Return the words for an object that a run has not restored."""
    return f"not restored: {what}"


class SafetyStopError(HilError):
    """A run was stopped.

    All axes were brought to rest and disabled, as far as the bus allowed.
    """

    exit_code = 8

    def __init__(self, reason: str, *, all_disabled: bool = True, where: str = "") -> None:
        """Keep the reason, whether every drive has confirmed that it is disabled, and positions, empty if nothing moved."""
        self.reason, self.all_disabled, self.where = reason, all_disabled, where
        end = DISABLED if all_disabled else f"{NOT_DISABLED}: torque may act, and a brake may be open"
        super().__init__("; ".join(filter(None, (f"stopped: {reason}", end, where))))


class InterruptedRunError(SafetyStopError):
    """The user stopped the run.

    If a drive has not confirmed that it is disabled, the exit status is that of any other stop.
    """

    exit_code = 130

    def __init__(self, reason: str, *, all_disabled: bool = True, where: str = "") -> None:
        super().__init__(reason, all_disabled=all_disabled, where=where)
        if not all_disabled:
            self.exit_code = SafetyStopError.exit_code  # type: ignore[misc]  # 130 tells a script that all is safe
