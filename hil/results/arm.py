"""Result of `hil identify arm`: masses of an arm, predicted dips."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedArm
from hil.results.base import Result, ResultPart


class MeasuredDip(ResultPart):
    """A measured dip of an axis in a posture, and the fit.

    Attributes:
        joints_deg: The posture, from the base on.
        fitted_hz: The nearest dip of the fit.
        bodies_hz: The nearest dip of the bench file's bodies on the same gears; None if it has none.
        way_fraction: Fraction of the line's way to which the posture is near; None if it is near to none.
    """

    axis: int
    joints_deg: tuple[float, ...]
    measured_hz: float
    standard_error_hz: float
    fitted_hz: float
    bodies_hz: float | None = None
    way_fraction: float | None = None


class LineDips(ResultPart):
    """Dips that are predicted at a place of the line motion.

    Attributes:
        bodies_hz: Dips by the bench file's bodies on the same gears; empty if it has none.
    """

    way_fraction: float
    dips_hz: tuple[float, ...]
    standard_error_hz: tuple[float, ...]
    bodies_hz: tuple[float, ...] = ()


class ArmResult(Result):
    """Masses of an arm from several postures.

    Attributes:
        line: Dips along the line motion; empty if they are not known.
        next_posture_deg: Joint angles, by axis, of the posture that would improve the fit most.
    """

    kind: Literal["identify-arm"] = "identify-arm"
    bench: str
    started_utc: str
    arm: IdentifiedArm
    measured: tuple[MeasuredDip, ...]
    line: tuple[LineDips, ...] = ()
    next_posture_deg: dict[int, float] = Field(default_factory=dict)
    notes: tuple[str, ...] = ()
