"""Causes in refusals, and whether the robot has them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hil.errors import RefusalCause
from plant_emulator.rehearsal.many.reading import worst_tip_mm
from plant_emulator.rehearsal.without import SHORT_SYNC_S, is_true
from plant_emulator.trials.rows import Row, number, text

REFUSED = frozenset({"refused", "stopped"})
LAST_WORDS = ("cancellation_learnt", "learn", "cancellation", "ate", "plant")
"""Steps whose refusal ends the path, the last first."""


@dataclass(frozen=True)
class Cause:
    """A cause that a refusal can state."""

    name: RefusalCause
    condition: str
    is_true: Callable[[Row], bool]


NOISY_M_S2, COARSE_BITS, LONG_SYNC_S = 0.04, 15.0, 0.004
"""From here on (down to here, of bits) a robot counts as one that has the cause."""
SLOW_BIT_S = 500_000
"""Bit rate down to which a bus may be full at the short SYNC period."""


def _at_least(name: str, least: float) -> Callable[[Row], bool]:
    return lambda row: (number(row, name) or 0.0) >= least


def _is_coarse(row: Row) -> bool:
    bits = number(row, "robot_encoder_bits")
    return bits is not None and bits <= COARSE_BITS


def _is_quiet_already(row: Row) -> bool:
    tip, goal = worst_tip_mm(row, "none"), number(row, "goal_mm")
    return tip is not None and goal is not None and tip <= goal


def _is_loaded(row: Row) -> bool:
    period_s, bit_s = number(row, "robot_sync_period_s"), number(row, "robot_bitrate")
    return period_s is not None and bit_s is not None and period_s <= SHORT_SYNC_S and bit_s <= SLOW_BIT_S


NOT_EXPLAINED = "not explained"
"""A run's text about the remaining tip if it knows no cause."""
NOT_IN_FLEET = "no robot of the fleet"

CAUSES: tuple[Cause, ...] = (
    Cause("nothing to cancel", "tip within the goal without a treatment", _is_quiet_already),
    Cause(
        "noise", f"accelerometer noise of {NOISY_M_S2:g} m/s² or more, or an encoder of {COARSE_BITS:g} bits or fewer",
        lambda row: _at_least("robot_noise_m_s2", NOISY_M_S2)(row) or _is_coarse(row),
    ),
    Cause("encoder", f"encoder of {COARSE_BITS:g} bits or fewer", _is_coarse),
    Cause("bus load", f"SYNC period of {1e3 * SHORT_SYNC_S:g} ms at {SLOW_BIT_S // 1000} kbit/s", _is_loaded),
    Cause(
        "cycle", f"SYNC period of {1e3 * LONG_SYNC_S:g} ms or more, or late answers",
        lambda row: row.get("robot_late_answers") is True or _at_least("robot_sync_period_s", LONG_SYNC_S)(row),
    ),
    Cause("limits", NOT_IN_FLEET, lambda row: False),
    Cause("another source of vibration", NOT_IN_FLEET, lambda row: False),
    Cause("wrong axis or wiring", NOT_IN_FLEET, lambda row: False),
)  # fmt: skip


@dataclass(frozen=True)
class Refusal:
    """The refusal that ended a path.

    Attributes:
        is_true: True if the robot has one of these causes.
    """

    seed: int
    step: str
    words: str
    named: tuple[str, ...]
    is_true: bool

    @property
    def cause(self) -> str:
        """The causes as one name."""
        return " or ".join(self.named) or "none of the known causes"


def main_refusal(row: Row) -> Refusal | None:
    """Return the refusal that ended a robot's path, or None.

    If a path ends with a cancellation, it is the run's statement, with a cause, about the excess over the goal. Otherwise it is
    the last refusal that states a cause: a step that only misses an earlier step's result states none.
    """
    if text(row, "end_treatment").startswith("cancellation"):
        return _told(row)
    found = [_refusal(row, step) for step in LAST_WORDS if text(row, f"{step}_ended") in REFUSED]
    return next((each for each in found if each.named), found[0] if found else None)


def _told(row: Row) -> Refusal | None:
    """Return the causes of the path's remaining tip, None if unknown."""
    causes, end, goal = text(row, "end_causes").split(", "), number(row, "end_tip_mm"), number(row, "goal_mm")
    if causes[0] in {"", NOT_EXPLAINED} or end is None or goal is None:
        return None
    holds = is_true(end, goal, number(row, "without_cause_mm"))
    return Refusal(_seed(row), text(row, "end_treatment"), text(row, "end_words"), tuple(causes), holds)


def _refusal(row: Row, step: str) -> Refusal:
    names = tuple(name for name in text(row, f"{step}_causes").split(", ") if name)
    holds = any(cause.is_true(row) for cause in CAUSES if cause.name in names)
    return Refusal(_seed(row), step, text(row, f"{step}_words"), names, holds)


def _seed(row: Row) -> int:
    seed = row.get("seed")
    return seed if isinstance(seed, int) else -1


def refusals(rows: Sequence[Row]) -> list[Refusal]:
    """Return the refusals of the robots that are not quiet."""
    found = (main_refusal(row) for row in rows if row.get("is_quiet") is not True)
    return [each for each in found if each is not None]
