"""What can go wrong on the bench: one root, attributes first, the message made from them, and the exit status it has."""

from typing import ClassVar

from drive_profiles.cia301 import abort_text


class HilError(Exception):
    """Root of the bench's errors."""

    exit_code: ClassVar[int] = 1


class UnsafeRequestError(HilError):
    """What was asked for would leave a limit of the bench file; nothing has been sent."""

    exit_code = 3

    def __init__(self, what: str, value: float, limit: float, unit: str, remedy: str = "") -> None:
        """Keep what, how much, and how much is allowed."""
        self.what, self.value, self.limit, self.unit = what, value, limit, unit
        tail = f"; {remedy}" if remedy else ""
        super().__init__(f"{what} would be {value:.4g} {unit}, the limit is {limit:.4g} {unit}{tail}")


class NotPossibleError(HilError):
    """The bench file asks for something that its drive, its profile or its own contents do not have."""

    exit_code = 3

    def __init__(self, what: str) -> None:
        """Keep the words."""
        self.what = what
        super().__init__(what)


class NodeError(HilError):
    """A node is not what the bench needs it to be; nothing has been enabled."""

    exit_code = 5

    def __init__(self, node: int, what: str, remedy: str = "") -> None:
        """Keep the node and what is wrong with it."""
        self.node, self.what, self.remedy = node, what, remedy
        super().__init__(f"node {node}: {what}" + (f"; {remedy}" if remedy else ""))


class NoAnswerError(NodeError):
    """A node did not answer in time."""

    def __init__(self, node: int, what: str, after_s: float) -> None:
        """Keep what was asked and how long it was waited for."""
        self.after_s = after_s
        super().__init__(node, f"no answer to {what} within {after_s:g} s", "is it powered, is the node id right?")


class WrongIdentityError(NodeError):
    """Another device than the bench file names answers at this node."""

    def __init__(self, node: int, what: str, expected: int, found: int) -> None:
        """Keep what was compared."""
        self.expected, self.found = expected, found
        super().__init__(node, f"{what} is 0x{found:X}, the profile says 0x{expected:X}", "is this the right bench file?")


class AlreadyMovingError(NodeError):
    """An axis is enabled or turns although nobody has asked it to."""


class SdoAbortedError(HilError):
    """A node refused an access."""

    exit_code = 6

    def __init__(self, node: int, index: int, subindex: int, code: int, name: str = "", value: object = None) -> None:
        """Keep where, what and the abort code."""
        self.node, self.index, self.subindex, self.code, self.name = node, index, subindex, code, name
        action = "read" if value is None else f"write of {value}"
        label = f" ({name})" if name else ""
        super().__init__(
            f"node {node}: {action} of object {index:04X}h:{subindex:02X}h{label} aborted: 0x{code:08X}, {abort_text(code)}"
        )


class ReadBackError(HilError):
    """An object does not hold what was written to it."""

    exit_code = 6

    def __init__(self, node: int, index: int, subindex: int, written: bytes, read: bytes) -> None:
        """Keep both."""
        self.node, self.index, self.subindex, self.written, self.read = node, index, subindex, written, read
        super().__init__(
            f"node {node}: object {index:04X}h:{subindex:02X}h holds {read.hex(' ')} after {written.hex(' ')} was written"
        )


class SafetyStopError(HilError):
    """A run was stopped: all axes were brought to rest and disabled as far as the bus allowed."""

    exit_code = 8

    def __init__(self, reason: str, *, all_disabled: bool = True) -> None:
        """Keep why, and whether every drive has confirmed that it is disabled."""
        self.reason, self.all_disabled = reason, all_disabled
        end = "all axes are stopped and disabled" if all_disabled else "NOT every drive has confirmed that it is disabled"
        super().__init__(f"stopped: {reason}; {end}")


class InterruptedRunError(SafetyStopError):
    """The user stopped the run."""

    exit_code = 130
