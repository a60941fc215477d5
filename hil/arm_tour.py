"""The demo's last part: cancellation on the line of a whole arm.

Only the arm's kinematics and the motors' data sheets are known. Every step is that of a command
(`hil learn --motion line-motion`, `hil compare`), with its report in a directory of its own.
"""

import datetime
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from hil.bench.bench import REFERENCE_ARM, Bench, load_bench
from hil.control.treatments import TreatmentName
from hil.errors import InterruptedRunError, NotPossibleError
from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest, learn_motion_on_bus
from hil.experiments.comparison.plan import ComparisonRequest, KnownRobot
from hil.experiments.comparison.run import ComparisonOutcome, any_emulated, request_entry
from hil.experiments.motions import LINE_MOTION
from hil.experiments.treatment import known_from
from hil.report.tables.directions import ALONG, peaks_mm
from hil.report.writer import write_report_of
from hil.reporter import SILENT, Reporter
from hil.results.base import RESULT_FILE
from hil.results.comparison import TourClaim, TourPart, TourResult, TourStep
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult, RunEntry
from hil.tour import BENCH_FILE, TourOutcome, make_step, run_side_by_side

HEADING = "A whole arm"
LEARNT: TreatmentName = "cancellation-learnt"
TREATMENTS: tuple[TreatmentName, ...] = ("none", "notch", LEARNT)
LEARNT_ORDERS = (2, 4)
"""Orders that are learnt: those of the paper."""
GOAL_MM = 0.010
"""Tip along x, y and z that is the goal, a fifth of what the bench file asks."""
MODEL_FILE, LEARN_PAGE = "learnt.toml", "learn/report.html"


@dataclass
class _ArmTourRunner:
    """Runner of the arm's tour: makes the steps and notes them."""

    bench: Bench
    out: Path
    reporter: Reporter
    steps: list[TourStep] = field(default_factory=list)
    comparisons: list[ComparisonOutcome] = field(default_factory=list)
    emulated: list[bool | None] = field(default_factory=list)

    @property
    def model(self) -> Path:
        return self.out / MODEL_FILE

    def learn(self) -> tuple[str, str]:
        """Learn the transmission errors on the line itself."""
        where = (self.out / LEARN_PAGE).parent
        request = MotionLearnRequest(LINE_MOTION, orders=LEARNT_ORDERS)
        outcome = learn_motion_on_bus(self.bench, request, where, self.model, reporter=self.reporter)
        self.emulated.append(outcome.result.emulated)
        write_report_of(where)
        if outcome.failure is not None:
            raise outcome.failure
        if not outcome.result.learnt:
            raise NotPossibleError("nothing was learnt on the line")
        learnt = "; ".join(part.words for part in outcome.result.parts if part.outcome == "learnt")
        return f"{len(outcome.result.runs)} runs of the line: {learnt}", LEARN_PAGE

    def run(self, request: ComparisonRequest) -> tuple[str, str]:
        """Run the line untreated, with the notch, and with the learnt cancellation."""
        knowledge = known_from(self.out / BENCH_FILE, self.bench, learnt=self.model)
        robot = KnownRobot(self.bench, knowledge, BENCH_FILE)
        return run_side_by_side(robot, request, self.out, self.comparisons, self.reporter)


def run(address: str, out: Path, *, reporter: Reporter = SILENT) -> TourOutcome:
    """Learn on the reference arm's line, and run it side by side.

    `out/result.json` has steps and claims, also after a failure.

    Args:
        address: Address of the bus on which the reference arm is served.
        out: Directory; made if it is missing. The model file of an earlier tour is replaced.
        reporter: Listener of each step and run.
    """
    out.mkdir(parents=True, exist_ok=True)
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    bench_file = out / BENCH_FILE
    bench_file.write_text(REFERENCE_ARM.read_text(encoding="utf-8"), encoding="utf-8")
    runner = _ArmTourRunner(load_bench(bench_file).on(address), out, reporter)
    runner.model.unlink(missing_ok=True)
    request = ComparisonRequest((LINE_MOTION,), (), TREATMENTS, frozenset(TREATMENTS))
    failure: Exception | None = None
    try:
        for name, make, page in (
            ("learn on the line itself", runner.learn, LEARN_PAGE),
            ("run side by side", partial(runner.run, request), ""),
        ):
            reporter.step(name)
            make_step(runner.steps, out, name, make, page)
    except KeyboardInterrupt:
        failure = InterruptedRunError("interrupted")
    except Exception as error:  # noqa: BLE001 - noted in the result, and returned
        failure = error
    comparison = runner.comparisons[0] if runner.comparisons else None
    result = TourResult(
        started_utc=started,
        request=request_entry(request),
        robots=[] if comparison is None else comparison.result.robots,
        emulated=any_emulated([*runner.emulated, *([] if comparison is None else [comparison.result.emulated])]),
        tour=TourPart(
            bench_file=BENCH_FILE,
            steps=tuple(runner.steps),
            failure=None if failure is None else str(failure),
            heading=HEADING,
            claims=_claims_of(runner),
        ),
    )
    result.write(out / RESULT_FILE)
    return TourOutcome(result, failure, comparison)


def _claims_of(runner: _ArmTourRunner) -> tuple[TourClaim, ...]:
    """Return the claims on the runs that were made."""
    entries: list[RunEntry] = []
    for robot in runner.comparisons[0].result.robots if runner.comparisons else ():
        if (runner.out / robot.directory / RESULT_FILE).is_file():
            entries = load_result(runner.out / robot.directory, ExperimentsResult, "runs").runs
    return claims(entries, runner.bench.specification.tip_mm)


def claims(entries: list[RunEntry], limit_mm: float) -> tuple[TourClaim, ...]:
    """Return the claims on the line with the judged numbers.

    A number that was not judged is None.
    """
    before, after = (peaks_mm(entries, treatment) for treatment in ("none", LEARNT))
    rises = [after[name] - before[name] for name in ALONG if name in before and name in after]
    noise_mm = next((run.noise_mm for run in entries if run.treatment == LEARNT and run.noise_mm is not None), 0.0)
    largest = [after[name] for name in ALONG if name in after]
    return (
        TourClaim(
            claim=f"no treatment: the tip exceeds ±{limit_mm:g} mm",
            asked=limit_mm,
            is_above=True,
            found=before.get("worst"),
            unit="mm",
        ),
        *(
            TourClaim(claim=f"learnt: within ±{limit_mm:g} mm along {name}", asked=limit_mm, found=after.get(name), unit="mm")
            for name in ALONG
        ),
        TourClaim(
            claim=f"learnt: within ±{limit_mm:g} mm in the worst direction", asked=limit_mm, found=after.get("worst"), unit="mm"
        ),
        TourClaim(
            claim="learnt: no direction exceeds its untreated vibration by more than the sensor's noise",
            asked=noise_mm,
            found=max(rises) if len(rises) == len(ALONG) else None,
            unit="mm",
        ),
        TourClaim(
            claim="learnt: the goal along x, y and z",
            asked=GOAL_MM,
            found=max(largest) if len(largest) == len(ALONG) else None,
            unit="mm",
        ),
    )
