"""Result of `hil design notch` (`design.json`)."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator

from hil.design.frequency import TwoInertia
from hil.design.notch_problem import Requirements
from hil.design.notch_search import Effort
from hil.results.base import Result, ResultPart
from hil.robot_tables import NotchTable


def _without_infinity(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Bounded = Annotated[float | None, BeforeValidator(_without_infinity)]
"""A number, or None if it has no bound: JSON has no infinity."""


@dataclass(frozen=True)
class DesignPlant(TwoInertia):
    """One plant of the set for which filters were designed."""

    label: str


class DesignCheck(ResultPart):
    """One requirement and its worst value; the fields are those of `hil.design.notch_design.RequirementCheck`."""

    name: str
    value: Bounded
    limit: Bounded
    unit: str
    is_ceiling: bool
    speed_rps: float | None
    member: str
    is_tip_limit: bool = False
    is_rise: bool = False
    holds: bool


class TipPeak(ResultPart):
    """Tip peak on the ramp, predicted, in the window of one order.

    Attributes:
        worst_mm: Peak of the worst plant, rising or falling.
        other_mm: Largest peak of the assumed plant on each of the slower and faster ramps, by their rate in rev/s².
    """

    order: float
    rising_mm: Bounded
    falling_mm: Bounded
    worst_mm: Bounded
    worst_member: str
    other_mm: tuple[tuple[float, Bounded], ...] = ()


class SpeedMarginsEntry(ResultPart):
    """Margins of the assumed plant's loop at one motor speed; `hil.design.frequency.Margins`."""

    speed_rps: float
    sensitivity_peak: Bounded
    gain_margin_db: Bounded
    phase_margin_deg: Bounded
    stable: bool
    pole_radius: Bounded


class ArmMargins(ResultPart):
    """Margins on the arm in one posture.

    The fields are those of `hil.design.notch_design.PostureRow`.
    """

    label: str
    sensitivity_peak: Bounded
    speed_rps: float
    phase_margin_deg: Bounded
    gain_margin_db: Bounded


class DesignVerdict(ResultPart):
    """Verdict on some filters.

    Attributes:
        notch: Filters as a bench file writes them.
        postures: Margins on the arm by posture; empty for an axis by itself.
    """

    notch: tuple[NotchTable, ...]
    holds: bool
    checks: tuple[DesignCheck, ...]
    tip_peaks: tuple[TipPeak, ...]
    margins: tuple[SpeedMarginsEntry, ...]
    postures: tuple[ArmMargins, ...] = ()


class NotchDesignResult(Result):
    """Result of a notch design.

    Attributes:
        orders: Orders k, in the order in which their filters were designed.
        speed_limit_rps: Largest motor speed at which the requirements must hold.
        f_al_hz: Peak of |G_al| without a filter.
        reason: Reason why none does.
        usable: True if the best filters keep all margins and raise no peak, though they may miss a limit of the tip in mm.
        designed: Verdict on the designed filters; None if only the given ones were judged.
        emulated: True if plant or transmission error were identified on an emulated robot.
    """

    kind: Literal["design-notch"] = "design-notch"
    bench: str
    axis: int
    orders: tuple[int, ...]
    plant_from: str
    period_s: float
    delay_samples: int
    speed_limit_rps: float
    f_al_hz: float
    requirements: Requirements
    plants: tuple[DesignPlant, ...]
    feasible: bool
    reason: str | None
    usable: bool = False
    none: DesignVerdict
    given: DesignVerdict | None
    designed: DesignVerdict | None
    effort: Effort
    seconds: float
    emulated: bool | None = None
    notes: tuple[str, ...] = ()
