"""The demo's last part: cancellation on the line of a whole arm.

Only the arm's kinematics and the motors' data sheets are known. Every step is that of a command
(`hil learn --motion line-motion`, `hil compare`), with its report in a directory of its own.
"""

from pathlib import Path
from typing import Any

from hil.bench.bench import REFERENCE_ARM
from hil.control.treatments import TreatmentName
from hil.errors import NotPossibleError
from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest, learn_motion_on_bus
from hil.experiments.comparison.plan import ComparisonRequest
from hil.experiments.motions import LINE_MOTION
from hil.experiments.treatment import known_from
from hil.report.figures.directions import ALONG, peaks_mm
from hil.reporter import SILENT, Reporter
from hil.results.base import RESULT_FILE
from hil.results.comparison import TourClaim
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult, RunEntry
from hil.tour import BENCH_FILE, TourOutcome, TourRunner, bench_of_tour

HEADING = "A whole arm"
LEARNT: TreatmentName = "cancellation-learnt"
TREATMENTS: tuple[TreatmentName, ...] = ("none", "notch", LEARNT)
LEARNT_ORDERS = (2, 4)
"""Orders that are learnt: those of the paper."""
GOAL_MM = 0.010
"""Tip along x, y and z that is the goal, a fifth of what the bench file asks."""
MODEL_FILE, LEARN_PAGE = "learnt.toml", "learn/report.html"


class _ArmTourRunner(TourRunner):
    """Runner of the arm's tour."""

    @property
    def model(self) -> Path:
        return self.out / MODEL_FILE

    def take_steps(self) -> None:
        """Learn, and run side by side."""
        self.step("learn on the line itself", self.learn, LEARN_PAGE)
        self.step("run side by side", self.compare)

    def findings(self) -> dict[str, Any]:
        """The heading, and the claims on the runs that were made."""
        entries: list[RunEntry] = []
        for robot in self.comparisons[0].result.robots if self.comparisons else ():
            if (self.out / robot.directory / RESULT_FILE).is_file():
                entries = load_result(self.out / robot.directory, ExperimentsResult, "runs").runs
        return {"heading": HEADING, "claims": claims(entries, self.bench.specification.tip_mm)}

    def learn(self) -> tuple[str, str]:
        """Learn the transmission errors on the line itself."""
        where = (self.out / LEARN_PAGE).parent
        request = MotionLearnRequest(LINE_MOTION, orders=LEARNT_ORDERS)
        outcome = learn_motion_on_bus(self.bench, request, where, self.model, reporter=self.reporter)
        self.keep(outcome, where)
        if not outcome.result.learnt:
            raise NotPossibleError("nothing was learnt on the line")
        learnt = "; ".join(part.words for part in outcome.result.parts if part.outcome == "learnt")
        return f"{len(outcome.result.runs)} runs of the line: {learnt}", LEARN_PAGE

    def compare(self) -> tuple[str, str]:
        """Run the line untreated, with the notch, and with the learnt cancellation."""
        return self.run_side_by_side(known_from(self.out / BENCH_FILE, self.bench, learnt=self.model))


def run(address: str, out: Path, *, reporter: Reporter = SILENT) -> TourOutcome:
    """Learn on the reference arm's line, and run it side by side.

    `out/result.json` has steps and claims, also after a failure. The reference arm is served at `address`. The model file of an
    earlier tour in `out` is replaced.
    """
    bench = bench_of_tour(out, REFERENCE_ARM.read_text(encoding="utf-8")).on(address)
    runner = _ArmTourRunner(bench, out, reporter, ComparisonRequest((LINE_MOTION,), (), TREATMENTS, frozenset(TREATMENTS)))
    runner.model.unlink(missing_ok=True)
    return runner.run()


def claims(entries: list[RunEntry], limit_mm: float) -> tuple[TourClaim, ...]:
    """Return the claims on the line; None is found where nothing was judged."""
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
