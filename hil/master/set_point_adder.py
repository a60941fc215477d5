"""Additions to a run's set-points from the measured motor angles."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable


class SetPointAdder(Protocol):
    """Addition to every axis' set-point, in drive-closed runs.

    Attributes:
        uses_torque: True if torque offsets (60B2h) are needed.
    """

    uses_torque: bool


@runtime_checkable
class SteppedAdder(SetPointAdder, Protocol):
    """A `SetPointAdder` in Python, in the order of the motion's axes."""

    def step(
        self, references_rad: Sequence[float], positions_rad: Sequence[float], torques_nm: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        """Additions for the next cycle.

        Args:
            references_rad: Motor angles of the motion in the next cycle.
            positions_rad: Measured motor angles of the last cycle.
            torques_nm: Measured motor torques of the last cycle.

        Returns:
            Additions to the references, in rad at the motor, and torque offsets in N·m.
        """
        ...


class Sensed(NamedTuple):
    """Measurements of a cycle beside angles and torques of the motors.

    Attributes:
        tip_m_s2: Acceleration of the tip (X, Y, Z); None if it was not measured in that cycle.
        row: Row of the motion whose set-points come next; None before it and after.
        load_rad: Angles of the joints by their second encoders, those of axes that move first; None if one has not
            answered, or there is none.
    """

    tip_m_s2: tuple[float, float, float] | None
    row: int | None
    load_rad: tuple[float, ...] | None = None


@runtime_checkable
class CompiledAdder(SetPointAdder, Protocol):
    """A `SetPointAdder` of the core: the laws of `cancellation.h`."""

    @property
    def data(self) -> Any:
        """Record `cancellation`."""
        ...


@runtime_checkable
class SensingAdder(SteppedAdder, Protocol):
    """A `SteppedAdder` that adapts to the remaining vibration."""

    def sense(self, sensed: Sensed) -> None:
        """Take the measurements of the last cycle, before each `step`."""
        ...
