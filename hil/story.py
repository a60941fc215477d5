"""The user's own robot, from a bench file that knows nothing to a quiet arm: identify, design, upload, run side by side.

Every step is what a command does (`hil identify plant`, `hil identify ate`, `hil design notch`, `drive-profiles upload`,
`hil compare`), with its report in a directory of its own.
"""

import datetime
import os
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from drive_profiles import fleet
from drive_profiles.bus import Bus
from drive_profiles.console import Interrupts
from drive_profiles.outcome import Options, Outcome
from drive_profiles.parameters import ParameterSet
from drive_profiles.target import device_at
from drive_profiles.upload import Upload
from hil.design.notch_search import Effort
from hil.errors import HilError, InterruptedRunError, NotPossibleError
from hil.experiments import identify_ate, notch_design
from hil.experiments.compare import KIND, SCHEMA, Compared, Robot, Selection, compare, plan
from hil.experiments.identify_plant import run_identify_plant
from hil.experiments.plan import Experiment
from hil.experiments.plant_motion import PlantRequest
from hil.experiments.runner import write_json
from hil.experiments.treatment import Knowledge, TreatmentName
from hil.master.bench import REFERENCE, Bench, load_bench
from hil.master.designed import load_designs, update_designs
from hil.master.identified import load_identified, update_file
from hil.report.design_page import write_design_report
from hil.report.page_ate import write_ate_report
from hil.report.page_plant import write_plant_report

T = TypeVar("T")

NAME = "own-robot"
WAYS: tuple[TreatmentName, ...] = ("none", "notch", "notch-optimised", "ate")
AXES = (2, 3)
EXPERIMENTS = ("constant-acceleration", "line-motion")

_MODEL = re.compile(r"\n\[axis\.\d\.model\]\n(?:[^\n]+\n)+")


class UploadFailedError(HilError):
    """Not every drive holds its set."""

    def __init__(self, outcomes: Sequence[Outcome]) -> None:
        """Keep how each ended."""
        self.outcomes = tuple(outcomes)
        self.exit_code = max(outcome.exit_code for outcome in outcomes) or 6  # type: ignore[misc]  # that of the failure itself
        super().__init__("; ".join(str(outcome) for outcome in outcomes if outcome.kind != "done"))


@dataclass
class Story:
    """What came of it.

    Attributes:
        result: What `result.json` holds: that of a comparison, and the steps.
        failure: What ended it early, or None.
        compared: The comparison, where it came to it.
    """

    result: dict[str, Any]
    failure: Exception | None
    compared: Compared | None


def bench_without_model(name: str = NAME) -> str:
    """The reference bench file as someone writes it who knows nothing of plant and transmission error."""
    text = _MODEL.sub("\n", REFERENCE.read_text(encoding="utf-8"))
    return text.replace('name = "reference"', f'name = "{name}"')


@dataclass
class _Teller:
    """Makes the steps and notes them."""

    bench: Bench
    out: Path
    axes: tuple[int, ...]
    effort: Effort
    announce: Callable[[str], None]
    steps: list[dict[str, Any]] = field(default_factory=list)

    @property
    def model(self) -> Path:
        return self.out / "model.toml"

    @property
    def design(self) -> Path:
        return self.out / "design.toml"

    def parameter_set(self, axis: int) -> Path:
        return self.out / f"notch-axis{axis}.toml"

    def step(self, name: str, make: Callable[[], tuple[str, str]]) -> None:
        """One step: its name, what came of it, how long it took, and where its report is."""
        self.announce(name)
        began = time.monotonic()
        kept: dict[str, Any] = {"name": name, "what": "", "holds": False, "link": ""}
        self.steps.append(kept)
        try:
            kept["what"], kept["link"] = make()
            kept["holds"] = True
        except (Exception, KeyboardInterrupt) as error:
            kept["what"] = str(error) or "interrupted"
            raise
        finally:
            kept["seconds"] = round(time.monotonic() - began, 2)

    def identify_plant(self, axis: int) -> tuple[str, str]:
        where = self.out / f"identify-plant-axis{axis}"
        try:
            result = run_identify_plant(self.bench, PlantRequest(axis), where, model=self.model, announce=self.announce)
        finally:
            if (where / "result.json").is_file():
                write_plant_report(where)
        found = result["parameters"]
        f_a, stiffness, inertia = (found[name] for name in ("antiresonance_hz", "gear_stiffness_nm_rad", "motor_inertia_kg_m2"))
        what = (
            f"f_a = {f_a['value']:.3f} ± {f_a['standard_error']:.3f} Hz, K_g = {stiffness['value']:.0f} ± "
            f"{stiffness['standard_error']:.0f} N·m/rad, J_m = {1e4 * inertia['value']:.3f} ± "
            f"{1e4 * inertia['standard_error']:.3f} kg·cm²"
        )
        return what, f"{where.name}/report.html"

    def identify_ate(self, axis: int) -> tuple[str, str]:
        where = self.out / f"identify-ate-axis{axis}"
        outcome = identify_ate.identify_ate(
            self.bench, identify_ate.Request(axis), where, load_identified(self.model), announce=self.announce
        )
        write_ate_report(where)
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.part is None:
            raise NotPossibleError(f"the transmission error of axis {axis} was not identified")
        update_file(self.model, self.bench.name, axis, outcome.part)
        values, errors = outcome.part.values, outcome.part.standard_error
        what = (
            f"A_2 = {values.a2_arcsec:.2f} ± {errors['a2_arcsec']:.2f} arcsec, φ_2 = {values.phi2_deg:.1f} ± "
            f"{errors['phi2_deg']:.1f}°, A_4 = {values.a4_arcsec:.2f} ± {errors['a4_arcsec']:.2f} arcsec"
        )
        return what, f"{where.name}/report.html"

    def design_notch(self, axis: int) -> tuple[str, str]:
        request = notch_design.Request(axis=axis, shapes=("switched",), effort=self.effort, jobs=_processors())
        outcome = notch_design.design(self.bench, request, load_identified(self.model))
        write_json(self.out / f"design-axis{axis}" / "design.json", notch_design.document(outcome))
        write_design_report(outcome, self.out / f"design-axis{axis}" / "design.html")
        if outcome.failure is not None:
            raise outcome.failure
        update_designs(self.design, self.bench.name, axis, notch_design.designed_axis(outcome))
        made = notch_design.parameter_set(outcome.bench, axis, outcome.best, outcome.f_al_hz)
        made.save(self.parameter_set(axis), force=True)
        (peak, *_), worst = outcome.best.peaks, {check.name: check.value for check in outcome.best.checks}
        before = "" if outcome.given is None else f", the bench file's notch {outcome.given.peak(peak.order).rising_mm:.3f} mm"
        what = f"predicted tip peak {peak.rising_mm:.3f} mm{before}; M_s {worst['M_s']:.2f} at every speed and plant"
        return what, f"design-axis{axis}/design.html"

    def upload(self) -> tuple[str, str]:
        for axis in self.axes:
            self._check_same(axis)
        outcomes = self._transact(_written)
        if any(outcome.kind != "done" for outcome in outcomes):
            raise UploadFailedError(outcomes)
        return "; ".join(map(str, outcomes)), self.parameter_set(self.axes[0]).name

    def _check_same(self, axis: int) -> None:
        """A run writes what the design file says: the drive is to hold the very same."""
        wanted = ParameterSet.load(self.parameter_set(axis)).tuning
        for place, table in enumerate(load_designs(self.design).axis[axis].notch, start=1):
            for key, value in vars(table.notch()).items():
                item = wanted.get(f"notch_{place}.{key}")
                if item is None or item.value != value:
                    raise NotPossibleError(f"axis {axis}: notch_{place}.{key} is not the same in parameter set and design file")

    def still_there(self) -> tuple[str, str]:
        """Whether the drives hold what was uploaded: a run of the designed notch writes the same, and every run puts back."""
        differing = self._transact(lambda uploads: [str(write.entry) for each in uploads for write, _ in each.changes])
        if differing:
            raise NotPossibleError(f"after the runs the drives no longer hold what was uploaded: {', '.join(differing)}")
        return "every object of the sets read once more after the runs: as uploaded", self.parameter_set(self.axes[-1]).name

    def _transact(self, then: Callable[[list[Upload]], T]) -> T:
        """The transaction of `drive-profiles upload`, prepared: each drive identified, quiet, and read."""
        options = Options(store=True, journals=self.out / "drive-journals")
        with Bus(self.bench.bus.address) as bus:
            uploads = []
            for axis in self.axes:
                wanted = ParameterSet.load(self.parameter_set(axis))
                device = device_at(bus, self.bench.axis[axis].node_id, wanted.header.profile or None)
                uploads.append(Upload(device, wanted, options, bus.address))
            fleet.prepare(uploads)
            return then(uploads)


def _written(uploads: list[Upload]) -> list[Outcome]:
    """All or none; Ctrl-C waits for the way back."""
    with Interrupts() as interrupts:
        if threading.current_thread() is threading.main_thread():
            interrupts.hold("interrupted: what has been written is put back; wait for the outcome")
        return fleet.run(uploads, fleet.Control(interrupts.event))


def tell(
    address: str,
    out: Path,
    *,
    axes: tuple[int, ...] = AXES,
    experiments: tuple[str, ...] = EXPERIMENTS,
    effort: Effort | None = None,
    announce: Callable[[str], None] = lambda text: None,
    begins: Callable[[Experiment], None] = lambda experiment: None,
    bench_text: str | None = None,
) -> Story:
    """Identify, design, upload, and run side by side; whatever happens, `out/result.json` says how far it came.

    Args:
        address: The bus.
        out: Directory; made if it is not there. Model and design file of an earlier story are written over.
        axes: Which axes are identified and get a filter.
        experiments: In which the treatments are compared.
        effort: How long a filter is searched; None: that of `hil design notch --quick`.
        announce: Called with each step.
        begins: Called before each run of the comparison.
        bench_text: The bench file; None: the reference bench without any model.
    """
    out.mkdir(parents=True, exist_ok=True)
    started = datetime.datetime.now(datetime.UTC)
    bench_file = out / "bench.toml"
    bench_file.write_text(bench_without_model() if bench_text is None else bench_text, encoding="utf-8")
    bench = load_bench(bench_file)
    bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": address})})
    teller = _Teller(bench, out, axes, effort or Effort.quick(), announce)
    for old in (teller.model, teller.design):
        old.unlink(missing_ok=True)
    found: list[Compared] = []
    failure: Exception | None = None
    try:
        for axis in axes:
            teller.step(f"identify plant, axis {axis}", partial(teller.identify_plant, axis))
            teller.step(f"identify transmission error, axis {axis}", partial(teller.identify_ate, axis))
        for axis in axes:
            teller.step(f"design notch, axis {axis}", partial(teller.design_notch, axis))
        teller.step("upload, read back, store", teller.upload)
        teller.step("run side by side", lambda: _side_by_side(teller, experiments, found, begins))
        teller.step("read back after the runs", teller.still_there)
    except KeyboardInterrupt:
        failure = InterruptedRunError("interrupted")
    except Exception as error:  # noqa: BLE001 - told in the result, and returned
        failure = error
    result = found[0].result if found else _empty(started, experiments, axes)
    result["story"] = _told(teller, failure)
    write_json(out / "result.json", result)
    return Story(result, failure, found[0] if found else None)


def _side_by_side(
    teller: _Teller, experiments: tuple[str, ...], found: list[Compared], begins: Callable[[Experiment], None]
) -> tuple[str, str]:
    """The comparison, by what has been identified and designed."""
    selection = Selection(experiments, teller.axes, WAYS, frozenset(WAYS))
    knowledge = Knowledge(load_identified(teller.model), load_designs(teller.design))
    planned = plan(Robot(teller.bench, knowledge, "bench.toml"), selection)
    found.append(compare([planned], selection, teller.out, announce=begins, tell=teller.announce))
    if found[0].failure is not None:
        raise found[0].failure
    if found[0].not_restored:
        raise NotPossibleError(f"not put back as it was found: {'; '.join(found[0].not_restored)}")
    return f"{len(planned.ways)} runs", "report.html"


def _empty(started: datetime.datetime, experiments: tuple[str, ...], axes: tuple[int, ...]) -> dict[str, Any]:
    """A comparison that was not come to."""
    asked = {"experiments": list(experiments), "axes": list(axes), "compensations": list(WAYS), "named": sorted(WAYS)}
    when = started.isoformat(timespec="seconds")
    return {"schema": SCHEMA, "kind": KIND, "started_utc": when, "asked": asked, "robots": []}


def _told(teller: _Teller, failure: Exception | None) -> Mapping[str, Any]:
    return {"bench_file": "bench.toml", "steps": teller.steps, "failure": None if failure is None else str(failure)}


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
