"""A drive's faults, reported in 603Fh, 1001h, 1003h and emergencies."""

from collections.abc import Callable

from drive_profiles.standard.cia301 import ErrorRegister
from drive_profiles.standard.cia402 import Object
from plant_emulator.motion import record
from plant_emulator.slave.node import Slave

FAULTS: tuple[tuple[int, str, int], ...] = (
    (record.FOLLOWING, "following error", 0x8611),
    (record.OVERSPEED, "motor speed", 0x8400),
    (record.OUT_OF_RANGE, "position limit", 0x8612),
    (record.SET_POINT_RANGE, "set-point outside position limit", 0x8612),
    (record.SET_POINT_STEP, "set-point faster than the motor", 0x8612),
    (record.SET_POINT_LATE, "set-point late", 0x8700),
)
"""Trip bit, cause and emergency code.

CiA 402, error codes: 8400h velocity, 8611h following error, 8612h reference limit, 8700h sync controller.
"""

PARAMETER_FAULT = 0x6320
TORQUE_OFF_FAULT = 0x5441
"""Safe torque off under torque: CiA 402 has no code of its own for it; 5441h is the first contact of the power section."""
RPDO_TIMEOUT = 0x8250

CONNECTION, TORQUE_OFF = "connection", "safe torque off"
NO_MODE, NO_INTERPOLATION, NO_GAINS = "no mode of operation", "interpolation period", "no gains"
NOT_OPERATIONAL = "NMT state is not operational"
LACKS = (NOT_OPERATIONAL, NO_MODE, NO_INTERPOLATION, NO_GAINS)
"""Causes of the emergency when a drive is not enabled, or does not take a mode: no fault; the status word shows a warning."""

_CAUSES = (*(cause for _, cause, _ in FAULTS), CONNECTION, TORQUE_OFF)


class DriveFaults:
    """Report of faults, and their withdrawal.

    603Fh is the lower half of 1003h:01h (CiA 402-2): the last error of the whole node, including missing parameters and
    communication errors. A fault reset leaves 603Fh and the history; 603Fh is 0 when 1003h:00h is cleared, or the node
    reset.

    Attributes:
        on_lack: Called when something may be lacking, or no longer.
    """

    def __init__(self, slave: Slave) -> None:
        self.on_lack: Callable[[], None] = lambda: None
        self._slave = slave
        slave.dictionary.on_read(Object.ERROR_CODE, 0, lambda: slave.emergencies.last_code)
        self._connection: int | None = None

    def report(self, cause: str, code: int) -> None:
        """Report a fault."""
        self._slave.emergencies.raise_cause(cause, code, ErrorRegister.PROFILE)

    def report_connection(self, code: int) -> None:
        """Report that the connection to the master is lost.

        If the node has just reported the same code, no second emergency is sent.
        """
        self._connection = code
        self._slave.emergencies.join_cause(CONNECTION, code, ErrorRegister.COMMUNICATION)

    def repeat_connection(self) -> None:
        """Report the lost connection again.

        After a communication reset the node has no errors, but the drive still has its fault.
        """
        if self._connection is not None:
            self._slave.emergencies.join_cause(CONNECTION, self._connection, ErrorRegister.COMMUNICATION)

    def forget(self) -> None:
        """Drop the lost connection, after a reset of the node."""
        self._connection = None

    def report_lack(self, lack: str | None) -> None:
        """Report what prevents enabling or a mode change; withdraw it once ended."""
        for cause in LACKS:
            if cause == lack:
                self._slave.emergencies.raise_cause(cause, PARAMETER_FAULT, ErrorRegister.PROFILE)
                break
            self._slave.emergencies.clear_cause(cause)
        self.on_lack()

    def end_lack(self, lack: str) -> None:
        """Withdraw a lack that has ended."""
        self._slave.emergencies.clear_cause(lack)
        self.on_lack()

    @property
    def is_lacking(self) -> bool:
        """True if something is lacking, and nothing has changed since."""
        return any(cause in LACKS for cause in self._slave.emergencies.causes)

    def clear(self) -> None:
        """Withdraw all causes at a fault reset; the history keeps them."""
        self.forget()
        for cause in _CAUSES:
            self._slave.emergencies.clear_cause(cause)
