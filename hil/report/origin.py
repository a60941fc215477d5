"""Origin of the numbers on a page: real robot, emulated, or both."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from hil.experiments.notch_design import NotchDesignOutcome
from hil.results.arm import ArmResult
from hil.results.base import MeasuredResult
from hil.results.comparison import ComparisonRobot, TreatmentTable


@dataclass(frozen=True)
class Origin:
    """Origin of a page's numbers.

    Attributes:
        word: Word for a number that was not computed: `measured`, `emulated` or `partly emulated`.
        band: Sentence on top of the page; empty for a real robot.
    """

    word: str = "measured"
    band: str = ""
    is_emulated: bool = False


MEASURED = Origin()
NOT_RECORDED = Origin(band="This result does not record whether the robot was emulated.")


def origin_of(result: MeasuredResult) -> Origin:
    """Origin of a measurement on one bench."""
    bench = result.bench.file
    parts = [f"axis {number}" for number in bench.axis]
    parts += ["accelerometer"] if bench.accelerometer.node_id is not None else []
    origin = _origin(result.emulated, result.emulated_parts, parts)
    if not result.unknown_keys:
        return origin
    keys = ", ".join(result.unknown_keys)
    words = f"Another version wrote this result. The installed version does not know these keys of the bench file: {keys}."
    return replace(origin, band=f"{origin.band} {words}".strip())


def origin_of_table(result: TreatmentTable) -> Origin:
    """Origin of a comparison, or of a tour."""
    emulated = [robot.name for robot in result.robots if robot.emulated and not robot.emulated_parts]
    if len(result.robots) == 1 or not result.robots or len(emulated) == len(result.robots):
        parts = result.robots[0].emulated_parts if len(result.robots) == 1 else None
        return _origin(result.emulated, parts)
    if not result.emulated:
        return _origin(result.emulated, None)
    words = "; ".join(f"{robot.name}: {_words(robot)}" for robot in result.robots)
    return Origin("partly emulated", f"Partly emulated. {words}.", is_emulated=True)


def origin_of_design(outcome: NotchDesignOutcome) -> Origin:
    """Return the origin of a design's plant and transmission error."""
    if not outcome.emulated:
        return MEASURED
    parts = " and ".join({"plant": "the plant", "ate": "the transmission error"}[part] for part in outcome.emulated)
    were = "were" if len(outcome.emulated) > 1 else "was"
    return Origin("emulated", f"This rests on an emulated robot: {parts} {were} identified on one.", is_emulated=True)


def origin_of_arm(result: ArmResult) -> Origin:
    """Origin of an arm's masses: of the plants on which they rest."""
    if not result.arm.emulated:
        return MEASURED
    return Origin("emulated", "This rests on an emulated robot: plants were identified on one.", is_emulated=True)


def _words(robot: ComparisonRobot) -> str:
    if robot.emulated is None:
        return "not recorded"
    if not robot.emulated:
        return "a real robot"
    return "emulated: " + ", ".join(robot.emulated_parts) if robot.emulated_parts else "emulated"


def _origin(emulated: bool | None, parts: tuple[str, ...] | None, whole: Iterable[str] = ()) -> Origin:
    if emulated is None:
        return NOT_RECORDED
    if not emulated:
        return MEASURED
    if not parts:
        band = "Emulated robot: nothing on this page was measured on a real one."
        return Origin("emulated", band, is_emulated=True)
    others = [name for name in whole if name not in parts]
    rest = f" Not emulated: {', '.join(others)}." if others else ""
    return Origin("partly emulated", f"Partly emulated: {', '.join(parts)}.{rest}", is_emulated=True)
