"""Tour of the user's own robot: identify, design, upload, compare.

It begins with a bench file without a model. Every step is that of a command (`hil identify plant`, `hil identify ate`,
`hil design notch`, `drive-profiles upload`, `hil compare`), with its report in a directory of its own.
"""

import datetime
import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from drive_profiles.cli.console import Interrupts
from drive_profiles.device.bus import SdoBus
from drive_profiles.device.target import device_at
from drive_profiles.files.toml import load
from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.processors import usable_processors
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions, UploadResult
from drive_profiles.upload.upload import Upload
from hil.bench.bench import REFERENCE, Bench, load_bench
from hil.bench.design import load_designs, update_designs
from hil.bench.model import IdentifiedAxis, load_identified, update_file, values_in_words
from hil.control.treatments import TreatmentName, treatment
from hil.design.notch_design import NotchVerdict
from hil.design.notch_search import Effort
from hil.emulator import DrawnRobot
from hil.errors import HilError, InterruptedRunError, NotPossibleError, not_restored_words
from hil.experiments import notch_design
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest
from hil.experiments.comparison.plan import ComparisonRequest, KnownRobot, plan
from hil.experiments.comparison.run import ComparisonOutcome, any_emulated, compare, request_entry
from hil.experiments.measurement import MeasurementOutcome
from hil.experiments.motions import CONSTANT_ACCELERATION
from hil.experiments.notch_design import InfeasibleError, NotchDesignOutcome
from hil.experiments.notch_problem import NotchDesignRequest
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.treatment import Knowledge, known_from
from hil.report.pages.design import write_design_report
from hil.report.report_table import value_and_error
from hil.report.writer import write_report_of
from hil.reporter import SILENT, Reporter
from hil.results.base import RESULT_FILE
from hil.results.comparison import TourNotch, TourPart, TourResult, TourStep
from hil.results.revealed import TrueRobot, facts_of

T = TypeVar("T")
Step = Callable[[], tuple[str, str]]
"""A step of a tour: its result in words, and the path of its report."""

NAME = "own-robot"
TREATMENTS: tuple[TreatmentName, ...] = ("none", "notch", "notch-designed", "cancellation")
EXPERIMENTS = ("constant-acceleration", "line-motion")
ROBOT_FILE, BENCH_FILE = "robot.toml", "bench.toml"

_REFERENCE = re.compile(r'reference = "paper"[^\n]*\n')
_MODEL = re.compile(r"\n\[axis\.\d\.model\]\n(?:[^\n]+\n)+")


class UploadFailedError(HilError):
    """Not every drive holds its parameter set."""

    def __init__(self, outcomes: Sequence[UploadResult]) -> None:
        self.outcomes = tuple(outcomes)
        self.exit_code = max(outcome.exit_code for outcome in outcomes) or 6  # type: ignore[misc]  # that of the failure itself
        super().__init__("; ".join(str(outcome) for outcome in outcomes if outcome.kind != "done"))


@dataclass(frozen=True)
class TourOutcome:
    """End of a tour.

    Attributes:
        result: Content of `result.json`: that of a comparison, and the steps.
        comparison: End of the comparison; None if the tour ended before.
    """

    result: TourResult
    failure: Exception | None
    comparison: ComparisonOutcome | None


def bench_without_model() -> str:
    """Return the reference bench file without plants and transmission errors."""
    text = _REFERENCE.sub("", _MODEL.sub("\n", REFERENCE.read_text(encoding="utf-8")))
    return text.replace('name = "reference"', f'name = "{NAME}"')


def better_of(outcome: NotchDesignOutcome) -> tuple[NotchDesignOutcome, str]:
    """Return the outcome with the better filters, and a clause.

    The filters are the designed ones, or those of the bench file if they are predicted to leave less at the tip and keep
    all margins. The clause is on the bench file's.
    """
    given = outcome.given
    if given is None or outcome.designed is None:
        return outcome, ""
    both = _predicted(outcome.request.axis, outcome.designed, given)
    if both.given_mm >= both.designed_mm:
        return outcome, f"; the bench file's notch: {both.given_mm:.3f} mm"
    if not both.missed:
        return replace(outcome, designed=None), f"; the bench file's notch is kept; the designed notch: {both.designed_mm:.3f} mm"
    return outcome, f"; the bench file's notch is not used: {both.given_mm:.3f} mm, but it misses {'; '.join(both.missed)}"


def _predicted(axis: int, designed: NotchVerdict, given: NotchVerdict) -> TourNotch:
    """Predicted peaks of both, and the margins that the given one misses."""
    order = designed.peaks[0].order
    peaks = {"designed_mm": designed.peak(order).rising_mm, "given_mm": given.peak(order).rising_mm}
    return TourNotch(axis=axis, **peaks, missed=tuple(str(check) for check in given.missed if not check.is_tip_limit))


class TourRunner(ABC):
    """Runner of a tour: makes the steps, notes them, and writes the result.

    Attributes:
        request: Request of the comparison that the tour ends with.
        emulated: Whether the robot of each step was emulated, as far as that is known.
    """

    def __init__(self, bench: Bench, out: Path, reporter: Reporter, request: ComparisonRequest) -> None:
        self.bench, self.out, self.reporter, self.request = bench, out, reporter, request
        self.steps: list[TourStep] = []
        self.emulated: list[bool | None] = []
        self.comparisons: list[ComparisonOutcome] = []

    @abstractmethod
    def take_steps(self) -> None:
        """Make all steps, one after the other."""

    @abstractmethod
    def findings(self) -> dict[str, Any]:
        """Return what the tour's part of the result has besides the steps."""

    def step(self, name: str, make: Step, report: str = "") -> None:
        """Make one step, and note name, result, duration and report.

        A step that is refused may have left a report, too. `make` returns its result in words and its report's path from the
        tour's directory; `report` is that of a failure.
        """
        self.reporter.step(name)
        began = time.monotonic()
        what, holds, link = "", False, ""
        try:
            what, link = make()
            holds = True
        except (Exception, KeyboardInterrupt) as error:
            what = str(error) or "interrupted"
            link = report if report and (self.out / report).is_file() else ""
            raise
        finally:
            seconds = round(time.monotonic() - began, 2)
            self.steps.append(TourStep(name=name, what=what, holds=holds, link=link, seconds=seconds))

    def keep(self, outcome: MeasurementOutcome[Any], where: Path) -> None:
        """Write the page of a step's measurement; raise the failure that ended it."""
        self.emulated.append(outcome.result.emulated)
        write_report_of(where)
        if outcome.failure is not None:
            raise outcome.failure

    def run_side_by_side(self, knowledge: Knowledge) -> tuple[str, str]:
        """Run the comparison that a tour ends with, as its last step."""
        planned = plan(KnownRobot(self.bench, knowledge, BENCH_FILE), self.request)
        outcome = compare([planned], self.request, self.out, reporter=self.reporter)
        self.comparisons.append(outcome)
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.not_restored:
            raise NotPossibleError(not_restored_words("; ".join(outcome.not_restored)))
        return f"{len(planned.setups)} runs", "report.html"

    def run(self) -> TourOutcome:
        """Make the steps; `result.json` has them, also after a failure."""
        started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        failure: Exception | None = None
        try:
            self.take_steps()
        except KeyboardInterrupt:
            failure = InterruptedRunError("interrupted")
        except Exception as error:  # noqa: BLE001 - noted in the result, and returned
            failure = error
        result = TourResult(
            started_utc=started,
            request=request_entry(self.request),
            robots=[robot for one in self.comparisons for robot in one.result.robots],
            emulated=any_emulated([*self.emulated, *(one.result.emulated for one in self.comparisons)]),
            tour=TourPart(
                bench_file=BENCH_FILE,
                steps=tuple(self.steps),
                failure=None if failure is None else str(failure),
                **self.findings(),
            ),
        )
        result.write(self.out / RESULT_FILE)
        return TourOutcome(result, failure, self.comparisons[0] if self.comparisons else None)


class _TourRunner(TourRunner):
    """Runner of the tour of an unknown robot.

    Attributes:
        axes: Axes that are identified and get a filter.
        robot: The drawn robot that is served, or None.
        designed: Axes with a designed filter; None for all.
        notches: Both notches of the axes that had one before.
    """

    def __init__(
        self,
        bench: Bench,
        out: Path,
        axes: tuple[int, ...],
        effort: Effort,
        reporter: Reporter,
        experiments: tuple[str, ...] = EXPERIMENTS,
        robot: DrawnRobot | None = None,
    ) -> None:
        super().__init__(bench, out, reporter, ComparisonRequest(experiments, axes, TREATMENTS, frozenset(TREATMENTS)))
        self.axes, self.effort, self.robot = axes, effort, robot
        self.designed: tuple[int, ...] | None = None
        self.notches: list[TourNotch] = []

    @property
    def model(self) -> Path:
        return self.out / "model.toml"

    @property
    def design(self) -> Path:
        return self.out / "design.toml"

    @property
    def _uploaded(self) -> tuple[int, ...]:
        return self.axes if self.designed is None else self.designed

    def parameter_set(self, axis: int) -> Path:
        return self.out / f"notch-axis{axis}.toml"

    def take_steps(self) -> None:
        """Identify, design, upload, and run side by side."""
        for axis in self.axes:
            self.step(f"identify plant, axis {axis}", partial(self.identify_plant, axis), _plant_page(axis))
            self.step(f"identify transmission error, axis {axis}", partial(self.identify_ate, axis), _ate_page(axis))
        designed = []
        for axis in self.axes:
            try:
                self.step(f"design notch, axis {axis}", partial(self.design_notch, axis), _design_page(axis))
                designed.append(axis)
            except InfeasibleError:
                continue
        self.designed = tuple(designed)
        if designed:
            self.step("upload, read back, store", self.upload)
        else:
            left = tuple(name for name in self.request.treatments if treatment(name).needs != "design")
            self.request = replace(self.request, treatments=left, named=frozenset(left))
        self.step("run side by side", self.compare)
        if designed:
            self.step("read back after the runs", self.read_back)

    def findings(self) -> dict[str, Any]:
        """Both notches, and true numbers of the drawn robot beside the identified ones."""
        found: dict[str, Any] = {"notches": tuple(self.notches) or None}
        if self.robot is None:
            return found
        (self.out / ROBOT_FILE).write_bytes(self.robot.robot_file.read_bytes())
        truth = load(self.robot.robot_file, TrueRobot)
        known = load_identified(self.model).axis if self.model.is_file() else {}
        facts = [fact for axis in self.axes for fact in facts_of(axis, truth.axis[axis], known.get(axis, IdentifiedAxis()))]
        return {**found, "robot_file": ROBOT_FILE, "seed": self.robot.seed, "facts": tuple(facts)}

    def identify_plant(self, axis: int) -> tuple[str, str]:
        where = (self.out / _plant_page(axis)).parent
        outcome = run_identify_plant(self.bench, PlantRequest(axis), where, model=self.model, reporter=self.reporter)
        self.keep(outcome, where)
        parameters = outcome.result.parameters
        if parameters is None:
            raise NotPossibleError(f"the plant of axis {axis} was not identified")
        shown = (
            ("f_a", "antiresonance_hz", 1.0, "Hz"),
            ("K_g", "gear_stiffness_nm_rad", 1e-3, "kN·m/rad"),
            ("J_m", "motor_inertia_kg_m2", 1e4, "kg·cm²"),
        )
        what = ", ".join(
            f"{symbol} = {' ± '.join(value_and_error(scale * found.value, scale * found.standard_error))} {unit}"
            for symbol, name, scale, unit in shown
            for found in (parameters[name],)
        )
        return what, _plant_page(axis)

    def identify_ate(self, axis: int) -> tuple[str, str]:
        where = (self.out / _ate_page(axis)).parent
        outcome = identify_ate(self.bench, AteRequest(axis), where, load_identified(self.model), reporter=self.reporter)
        self.keep(outcome, where)
        if outcome.part is None:
            raise NotPossibleError(f"the transmission error of axis {axis} was not identified")
        update_file(self.model, self.bench.name, axis, outcome.part)
        return ", ".join(values_in_words(outcome.part)), _ate_page(axis)

    def design_notch(self, axis: int) -> tuple[str, str]:
        request = NotchDesignRequest(axis=axis, shapes=("switched",), effort=self.effort, jobs=usable_processors())
        outcome = notch_design.design(self.bench, request, load_identified(self.model))
        page = self.out / _design_page(axis)
        notch_design.result_of(outcome).write(page.parent / "design.json")
        write_design_report(outcome, page)
        if outcome.failure is not None and not outcome.is_usable:
            raise outcome.failure
        outcome, before = better_of(outcome)
        if outcome.designed is not None and outcome.given is not None:
            self.notches.append(_predicted(axis, outcome.designed, outcome.given))
        update_designs(self.design, self.bench.name, axis, notch_design.designed_axis(outcome))
        made = notch_design.parameter_set(outcome.bench, axis, outcome.best, outcome.f_al_hz)
        made.save(self.parameter_set(axis), force=True)
        (peak, *_), m_s = outcome.best.peaks, outcome.best.worst("M_s")
        missed = "" if outcome.failure is None else f"; missed: {'; '.join(map(str, outcome.failure.missed))}"
        what = f"predicted tip peak {peak.rising_mm:.3f} mm; M_s {m_s:.2f} at every speed and plant{missed}{before}"
        return what, _design_page(axis)

    def upload(self) -> tuple[str, str]:
        for axis in self._uploaded:
            self._check_same(axis)
        outcomes = self._transact(_written)
        if any(outcome.kind != "done" for outcome in outcomes):
            raise UploadFailedError(outcomes)
        return "; ".join(map(str, outcomes)), self.parameter_set(self._uploaded[0]).name

    def _check_same(self, axis: int) -> None:
        """Check that parameter set and design file have the same filter."""
        wanted = ParameterSet.load(self.parameter_set(axis)).tuning
        for column, table in enumerate(load_designs(self.design).axis[axis].notch, start=1):
            for key, value in vars(table.notch()).items():
                item = wanted.get(f"notch_{column}.{key}")
                if item is None or item.value != value:
                    raise NotPossibleError(f"axis {axis}: notch_{column}.{key} differs between parameter set and design file")

    def compare(self) -> tuple[str, str]:
        """Run the comparison with the identified models and the designed filters."""
        design = self.design if self.design.is_file() else None
        return self.run_side_by_side(known_from(self.out / BENCH_FILE, self.bench, model=self.model, design=design))

    def read_back(self) -> tuple[str, str]:
        """Check that the drives still have the uploaded sets."""
        differing = self._transact(lambda uploads: [str(write.entry) for each in uploads for write, _ in each.changes])
        if differing:
            raise NotPossibleError(f"after the runs the drives no longer hold the uploaded values: {', '.join(differing)}")
        return "after the runs every object holds the uploaded value", self.parameter_set(self._uploaded[-1]).name

    def _transact(self, then: Callable[[list[Upload]], T]) -> T:
        """Prepare the transaction of `drive-profiles upload` for `then`."""
        options = UploadOptions(store=True, journals=self.out / "drive-journals")
        with SdoBus(self.bench.bus.address) as bus:
            uploads = []
            for axis in self._uploaded:
                wanted = ParameterSet.load(self.parameter_set(axis))
                device = device_at(bus, self.bench.axis[axis].node_id, wanted.header.profile or None)
                uploads.append(Upload(device, wanted, options, bus.address))
            fleet.prepare(uploads)
            return then(uploads)


def _plant_page(axis: int) -> str:
    return f"identify-plant-axis{axis}/report.html"


def _ate_page(axis: int) -> str:
    return f"identify-ate-axis{axis}/report.html"


def _design_page(axis: int) -> str:
    return f"design-axis{axis}/design.html"


def _written(uploads: list[Upload]) -> list[UploadResult]:
    """Upload to all drives or none; Ctrl-C waits for that."""
    with Interrupts(is_last=False) as interrupts:
        if threading.current_thread() is threading.main_thread():
            late = "the interrupt came too late: everything has been written; a second one ends the demo"
            interrupts.hold("interrupted: restoring every written value; wait for the outcome", late)
        return fleet.run(uploads, fleet.UploadControl(interrupts.window))


def run(
    address: str,
    out: Path,
    *,
    axes: tuple[int, ...] = (),
    experiments: tuple[str, ...] = EXPERIMENTS,
    effort: Effort | None = None,
    reporter: Reporter = SILENT,
    bench_text: str | None = None,
    robot: DrawnRobot | None = None,
) -> TourOutcome:
    """Identify, design, upload, and run side by side.

    `out/result.json` has the steps, also after a failure.

    Args:
        out: Directory; made if it is missing. Model and design file of an earlier tour are replaced.
        axes: Axes that are identified and get a filter; empty for those of the bench file with a notch.
        experiments: Experiments of the comparison, as far as the bench file has them.
        effort: Effort of the search for a filter; None for that of `hil design notch --quick`.
        bench_text: Text of the bench file; None for the drawn robot's, and without one for the reference bench without any model.
        robot: The drawn robot that is served. Its file is read only at the end, to compare its true numbers with the
        identified ones.
    """
    if bench_text is None:
        bench_text = bench_without_model() if robot is None else robot.bench_file.read_text(encoding="utf-8")
    bench = bench_of_tour(out, bench_text).on(address)
    axes = axes or tuple(number for number, table in sorted(bench.axis.items()) if table.notch)
    experiments = tuple(name for name in experiments if name == CONSTANT_ACCELERATION or bench.line_motion is not None)
    runner = _TourRunner(bench, out, axes, effort or Effort.quick(), reporter, experiments, robot)
    for old in (runner.model, runner.design):
        old.unlink(missing_ok=True)
    return runner.run()


def bench_of_tour(out: Path, text: str) -> Bench:
    """Write the bench file of a tour into its directory, and load it."""
    out.mkdir(parents=True, exist_ok=True)
    (out / BENCH_FILE).write_text(text, encoding="utf-8")
    return load_bench(out / BENCH_FILE)
