"""Runs of a comparison, robot after robot, and their result.

Every robot has a directory as `hil run` would leave it; `result.json` above them holds the table, a row per experiment and
treatment. Runs that are not possible are left out with their reason before anything moves.
"""

import datetime
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.errors import SafetyStopError
from hil.experiments.comparison.plan import ComparisonPlan, ComparisonRequest
from hil.experiments.comparison.table import gathered, unmet
from hil.experiments.runner import run_experiments
from hil.reporter import SILENT, Reporter
from hil.results.base import RESULT_FILE
from hil.results.comparison import ComparisonRequestEntry, ComparisonResult, ComparisonRobot
from hil.results.runs import ExperimentsResult


@dataclass(frozen=True)
class ComparisonOutcome:
    """End of a comparison.

    Attributes:
        unmet: Sentences on named treatments that were not compared, were refused, or could not be judged.
    """

    result: ComparisonResult
    failure: Exception | None
    unmet: list[str]

    @property
    def not_restored(self) -> list[str]:
        """Objects that could not be restored in the nodes."""
        return [what for robot in self.result.robots for what in robot.not_restored]


def compare(
    plans: Sequence[ComparisonPlan],
    request: ComparisonRequest,
    out: Path,
    *,
    overload: bool = False,
    repeat: int = 1,
    reporter: Reporter = SILENT,
) -> ComparisonOutcome:
    """Run the plans, robot after robot, and gather their results.

    After a robot that fails the others are run all the same; after a safety stop or Ctrl-C they are not.

    Args:
        plans: One plan per robot.
        request: Request from which they were made.
        out: Directory for result.json, and below it one per robot.
        overload: Run even what does not fit on the bus.
        repeat: Number of runs of each motion; the mean of their recordings is judged.
    """
    started = datetime.datetime.now(datetime.UTC)
    robots: list[ComparisonRobot] = []
    failure: Exception | None = None
    for plan, directory in zip(plans, _directories(plans), strict=True):
        result: ExperimentsResult | None = None
        if isinstance(failure, SafetyStopError):
            ended = "not run: an earlier run was stopped"
        else:
            own: Exception | None
            try:
                done = run_experiments(
                    plan.robot.bench,
                    plan.experiments,
                    out / directory,
                    overload=overload,
                    repeat=repeat,
                    knowledge=plan.robot.knowledge,
                    reporter=reporter,
                )
                result, own = done.result, done.failure
            except Exception as error:  # noqa: BLE001 - kept beside what the other robots gave; the caller raises it
                own = error
            failure = own if isinstance(own, SafetyStopError) else failure or own
            ended = "" if own is None else str(own)
        robots.append(gathered(plan, directory, result, ended))
    whole = ComparisonResult(
        started_utc=started.isoformat(timespec="seconds"),
        request=request_entry(request),
        robots=robots,
        emulated=any_emulated(each.emulated for each in robots),
    )
    whole.write(out / RESULT_FILE)
    return ComparisonOutcome(whole, failure, unmet(robots, request))


def any_emulated(answers: Iterable[bool | None]) -> bool | None:
    """Combine answers: True if any is True.

    Otherwise the result is None if an answer is unknown or there is none, else False.
    """
    known = list(answers)
    if True in known:
        return True
    return None if None in known or not known else False


def request_entry(request: ComparisonRequest) -> ComparisonRequestEntry:
    """Request of a comparison as an entry of the result file."""
    return ComparisonRequestEntry(
        experiments=request.experiments,
        axes=request.axes,
        treatments=request.treatments,
        named=tuple(sorted(request.named)),
    )


def _directories(plans: Sequence[ComparisonPlan]) -> list[str]:
    """Name each robot's directory after the robot."""
    names: list[str] = []
    for each in plans:
        slug = re.sub(r"[^a-z0-9]+", "-", each.robot.bench.name.lower()).strip("-") or "robot"
        same = sum(directory == slug or directory.startswith(f"{slug}-") for directory in names)
        names.append(slug if not same else f"{slug}-{same + 1}")
    return names
