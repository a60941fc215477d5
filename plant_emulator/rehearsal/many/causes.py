"""Causes of refusals, as the refusals' words name them, and whether the robot has them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from plant_emulator.rehearsal.many.reading import number, text, worst_tip_mm
from plant_emulator.rehearsal.many.rows import Row

REFUSED = frozenset({"refused", "stopped"})
LAST_WORDS = ("cancellation_learnt", "learn", "cancellation", "ate", "plant")
"""Steps whose refusal ends the path, the last first."""


@dataclass(frozen=True)
class Cause:
    """A cause that a refusal can name.

    Attributes:
        name: Name for readers.
        pattern: Words that name it.
        condition: The robots that have it, in words.
        is_true: True for a robot that has it.
    """

    name: str
    pattern: re.Pattern[str]
    condition: str
    is_true: Callable[[Row], bool]


def _at_least(name: str, least: float) -> Callable[[Row], bool]:
    return lambda row: (number(row, name) or 0.0) >= least


def _at_most(name: str, most: float) -> Callable[[Row], bool]:
    return lambda row: (value := number(row, name)) is not None and value <= most


def _is_quiet_already(row: Row) -> bool:
    tip, goal = worst_tip_mm(row, "none"), number(row, "goal_mm")
    return tip is not None and goal is not None and tip <= goal


def _is_late(row: Row) -> bool:
    return row.get("robot_late_answers") is True or (number(row, "robot_sync_period_s") or 0.0) >= LONG_SYNC_S


HYSTERESIS_NM, SOFT_FRACTION, LAG_S, NOISY_M_S2, COARSE_BITS, LONG_SYNC_S = 0.2, 0.1, 0.1e-3, 0.04, 15.0, 0.004
"""From here on (down to here, of bits) a robot counts as one that has the cause."""

CAUSES = (
    Cause("hysteresis", re.compile(r"hysteresis|stiffens|lost motion", re.IGNORECASE),
          f"hysteresis of {HYSTERESIS_NM:g} N·m or more", _at_least("robot_hysteresis_nm", HYSTERESIS_NM)),
    Cause("soft wind-up", re.compile(r"wind-up|softer|softness"),
          f"softness of {100 * SOFT_FRACTION:g} % or more", _at_least("robot_softness", SOFT_FRACTION)),
    Cause("current loop", re.compile(r"current.loop|torque (?:that is )?felt|lag between"),
          f"current lag of {1e3 * LAG_S:g} ms or more", _at_least("robot_current_lag_s", LAG_S)),
    Cause("nothing to cancel", re.compile(r"nothing to cancel|quiet already|no transmission error|already (?:quiet|within)"),
          "its tip without a treatment is within the goal", _is_quiet_already),
    Cause("noise", re.compile(r"noise|noisy"),
          f"accelerometer noise of {NOISY_M_S2:g} m/s² or more", _at_least("robot_noise_m_s2", NOISY_M_S2)),
    Cause("encoder", re.compile(r"encoder|counts per rev|\bbits?\b"),
          f"encoder of {COARSE_BITS:g} bits or fewer", _at_most("robot_encoder_bits", COARSE_BITS)),
    Cause("cycle", re.compile(r"SYNC|late|missed|cycle"),
          f"SYNC period of {1e3 * LONG_SYNC_S:g} ms or more, or late answers", _is_late),
    Cause("wrong axis or wiring", re.compile(r"is this the axis|does this axis move|wiring|wired"),
          "no robot of the stable", lambda row: False),
)  # fmt: skip


@dataclass(frozen=True)
class Refusal:
    """The refusal that ended a path.

    Attributes:
        seed: Seed of the robot.
        step: The step that refused.
        words: Its words.
        named: Names of the causes in them.
        is_true: True where the robot has one of these causes.
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
    """The refusal that ended a robot's path; None where it ends with a cancellation, or nothing was refused."""
    if text(row, "end_treatment").startswith("cancellation"):
        return None
    for step in LAST_WORDS:
        if text(row, f"{step}_ended") in REFUSED:
            words = text(row, f"{step}_words")
            named = [cause for cause in CAUSES if cause.pattern.search(words)]
            seed = row.get("seed")
            names = tuple(cause.name for cause in named)
            return Refusal(seed if isinstance(seed, int) else -1, step, words, names, any(cause.is_true(row) for cause in named))
    return None


def refusals(rows: Sequence[Row]) -> list[Refusal]:
    """The refusals that ended paths, of the robots that are not quiet."""
    found = (main_refusal(row) for row in rows if row.get("is_quiet") is not True)
    return [each for each in found if each is not None]
