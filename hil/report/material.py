"""What a report is made of: result.json, the recordings it names, and what follows from both."""

import json
import math
import warnings
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.analysis import motor_speed_rps
from hil.design.frequency import Loop, Margins, margins
from hil.design.transmission_error import TransmissionError, TransmissionErrorEstimate, fit_transmission_error
from hil.experiments.treatment import TITLES
from hil.master.bench import Bench
from hil.recording import Recording

CONSTANT_ACCELERATION, LINE_MOTION = "constant-acceleration", "line-motion"

FEWEST_ROWS = 64
"""Below that a recording cannot even be filtered."""

MARGIN_SPEEDS_RPS = np.linspace(0.5, 10.5, 41)
"""Motor speeds at which stability and margins are computed."""

FIT_SPEEDS_RPS = (1.5, 9.0)
"""Motor speeds of a rising ramp from which the transmission error is identified: both resonances with their surroundings."""


class Entry(BaseModel):
    """Base of what result.json holds: what it lacks is None, what is unknown here is left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class Run(Entry):
    """One line of `runs`."""

    experiment: str
    axis: int | None = None
    compensation: str = "none"
    loop: str = "drive"
    sync_period_s: float | None = None
    control_period_s: float | None = None
    order: int | None = None
    tip_peak_mm: float | None = None
    tip_rms_mm: float | None = None
    spectrum_peak_m_s2: float | None = None
    spectrum_peak_hz: float | None = None
    spectrum_area: float | None = None
    within_spec: bool | None = None
    cycles: int | None = None
    missed_cycles: int | None = None
    wall_s: float | None = None
    motion_s: float | None = None
    recording: str | None = None
    stopped: str | None = None
    invalid: str | None = None
    timing: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """The run in words."""
        what = f"axis {self.axis}, constant acceleration" if self.axis is not None else self.experiment.replace("-", " ")
        window = "" if self.order is None else f", k = {self.order} window"
        return f"{what}, {self.compensation_name}, {self.loop}-closed{window}"

    @property
    def compensation_name(self) -> str:
        """The compensation in words."""
        names: dict[str, str] = {**TITLES, "none": "no notch"}
        return names.get(self.compensation, self.compensation)


class Comparison(Entry):
    """One line of `comparisons`: with a treatment against without."""

    experiment: str
    axis: int | None = None
    loop: str = "drive"
    compensation: str = "notch"
    tip_peak_reduction_pct: float | None = None
    spectrum_area_reduction_pct: float | None = None


class Claim(Entry):
    """One line of `paper`: a number of the paper beside the bench's."""

    claim: str
    source: str = ""
    paper: float | str | None = None
    bench: float | str | None = None
    unit: str | None = None
    holds: bool | None = None


class BenchRecord(Entry):
    """Where and with what the runs were made."""

    name: str = ""
    file: dict[str, Any] | None = None
    bus: Any = None
    clock: Any = None
    seed: Any = None
    versions: dict[str, Any] = Field(default_factory=dict)
    started_utc: str | None = None


class Result(Entry):
    """result.json."""

    schema_version: int = Field(1, alias="schema")
    bench: BenchRecord = BenchRecord()
    runs: tuple[Run, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    paper: tuple[Claim, ...] = ()


class Material:
    """Result, bench and recordings of one directory; everything that is computed is computed once."""

    def __init__(self, directory: Path, bench: Bench | None = None) -> None:
        """Read result.json; the bench comes from it unless it is given.

        Raises:
            ValueError: result.json is of another schema, or holds no bench and none is given.
        """
        self.directory = directory
        with (directory / "result.json").open(encoding="utf-8") as file:
            self.result = Result.model_validate(json.load(file))
        if self.result.schema_version != 1:
            raise ValueError(f"{directory / 'result.json'}: schema {self.result.schema_version} is not 1, the one known here")
        if bench is None:
            if self.result.bench.file is None:
                raise ValueError(f"{directory / 'result.json'}: holds no bench file, and none is given")
            # through JSON text, whose rules turn the keys "2", "3" of `axis` back into numbers and lists into tuples
            bench = Bench.model_validate_json(json.dumps(self.result.bench.file))
        self.bench = bench
        self.notes: list[str] = []
        self._recordings: dict[str, Recording | None] = {}
        self._margins: dict[int, dict[float, Margins]] = {}
        self._estimates: dict[int, TransmissionErrorEstimate | None] = {}

    @cached_property
    def model_axes(self) -> tuple[int, ...]:
        """Axes with a model, in order."""
        return tuple(sorted(number for number, axis in self.bench.axis.items() if axis.model is not None))

    @cached_property
    def control_period_s(self) -> float:
        """Period of the loop inside the drives, for what is computed; the paper's where no run tells."""
        periods = [run.control_period_s for run in self.result.runs if run.loop == "drive" and run.control_period_s]
        return periods[0] if periods else 250e-6

    @cached_property
    def f_al_hz(self) -> dict[int, float]:
        """Peak frequency of |G_al| by axis, of the axes with a model."""
        loops = {number: self.loop(number, with_notch=False) for number in self.model_axes}
        return {number: loop.peak_hz() for number, loop in loops.items()}

    @property
    def line_f_al_hz(self) -> float | None:
        """The frequency by which the line motion's acceleration becomes a displacement: that of the first axis with a model."""
        return next(iter(self.f_al_hz.values()), None)

    def loop(self, axis: int, *, with_notch: bool = True) -> Loop:
        """The drive-closed loop of an axis with a model."""
        loop = self.bench.axis[axis].loop(self.control_period_s, with_notch=with_notch)
        if loop is None:
            raise ValueError(f"axis {axis} has no model")
        return loop

    def margins(self, axis: int) -> dict[float, Margins]:
        """Margins of the loop of an axis with a model, by motor speed."""
        if axis not in self._margins:
            loop = self.loop(axis)
            self._margins[axis] = {float(speed): margins(loop, float(speed), points=1000) for speed in MARGIN_SPEEDS_RPS}
        return self._margins[axis]

    def transmission_error(self, axis: int) -> TransmissionError | None:
        """The bench file's θ_sync of an axis."""
        model = self.bench.axis[axis].model if axis in self.bench.axis else None
        if model is None:
            return None
        ate = model.ate
        return TransmissionError({2: ate.a2_arcsec, 4: ate.a4_arcsec}, {2: ate.phi2_deg, 4: ate.phi4_deg})

    def amplitude_arcsec(self, axis: int, order: int) -> float:
        """A_k of the bench file; 0 where it is not known."""
        error = self.transmission_error(axis)
        return 0.0 if error is None else error.amplitude_arcsec.get(order, 0.0)

    def find(
        self, experiment: str, axis: int | None = None, compensation: str = "none", loop: str = "drive", order: int | None = None
    ) -> Run | None:
        """The run, or None; without an order, the first of its windows."""
        for run in self.result.runs:
            same = (run.experiment, run.axis, run.compensation, run.loop) == (experiment, axis, compensation, loop)
            if same and order in (None, run.order):
                return run
        return None

    def comparison(
        self, experiment: str, axis: int | None, loop: str = "drive", compensation: str = "notch"
    ) -> Comparison | None:
        """What a treatment changed, or None."""
        wanted = (experiment, axis, loop, compensation)
        found = ((c.experiment, c.axis, c.loop, c.compensation) for c in self.result.comparisons)
        return next((c for c, key in zip(self.result.comparisons, found, strict=True) if key == wanted), None)

    def recording(self, run: Run | None) -> Recording | None:
        """The recording of a run, or None where it is missing or too short; why is then among the notes."""
        if run is None or run.recording is None:
            return None
        if run.recording not in self._recordings:
            self._recordings[run.recording] = self._load(run.recording, run.axis)
        return self._recordings[run.recording]

    def _load(self, name: str, axis: int | None) -> Recording | None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # numpy warns of a file without rows, which is said below
                recording = Recording.load(self.directory / name)
        except (OSError, ValueError) as error:
            self.notes.append(f"{name} cannot be read: {error}")
            return None
        needed = {"tip_z_m_s2"} | (set() if axis is None else {f"axis{axis}_position_rad"})
        lacking = sorted(needed - set(recording.columns))
        if lacking:
            self.notes.append(f"{name} has no column {', '.join(lacking)}; it is not drawn.")
            return None
        if len(recording.time_s) < FEWEST_ROWS:
            self.notes.append(f"{name} has only {len(recording.time_s)} rows; it is not drawn.")
            return None
        return self._bridged(name, recording)

    def _bridged(self, name: str, recording: Recording) -> Recording:
        """The recording without holes: what did not come in is interpolated, and said."""
        holes = {key: ~np.isfinite(column) for key, column in recording.columns.items()}
        count = max(int(np.count_nonzero(hole)) for hole in holes.values())
        if not count:
            return recording
        row = np.arange(len(recording.time_s), dtype=np.float64)
        columns = {
            key: np.interp(row, row[~hole], recording.columns[key][~hole]) if not hole.all() else np.zeros(len(row))
            for key, hole in holes.items()
        }
        self.notes.append(f"{name}: {count} samples did not come in; the figures bridge them by straight lines.")
        return Recording(columns)

    def estimate(self, axis: int) -> TransmissionErrorEstimate | None:
        """θ_sync identified from the run without a notch, or None where there is none that carries it."""
        if axis not in self._estimates:
            self._estimates[axis] = self._identify(axis)
        return self._estimates[axis]

    def _identify(self, axis: int) -> TransmissionErrorEstimate | None:
        if axis not in self.model_axes:
            return None
        runs = [self.find(CONSTANT_ACCELERATION, axis, loop=loop) for loop in ("drive", "host")]
        recording = next((found for found in map(self.recording, runs) if found is not None), None)
        if recording is None:
            return None
        table = self.bench.axis[axis]
        speed = np.abs(motor_speed_rps(recording, axis))
        low, high = FIT_SPEEDS_RPS
        rows = (speed > low) & (speed < high) & (np.arange(len(speed)) < int(np.argmax(speed)))
        angle, tip = recording.axis(axis, "position_rad"), recording.columns["tip_z_m_s2"]
        plant = cast("Any", table.plant())
        try:
            return fit_transmission_error(angle, tip, recording.period_s, plant, table.tip_lever_m, rows=rows)
        except ValueError as error:
            self.notes.append(f"The transmission error of axis {axis} cannot be identified: {error}.")
            return None


def finite(value: float | None) -> bool:
    """Whether there is a number."""
    return value is not None and math.isfinite(value)
