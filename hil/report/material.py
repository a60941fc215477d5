"""Material of a report: result.json, recordings, and computed numbers."""

import math
import warnings
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from hil.analysis import PAPER_BAND_HZ, TipScale, joint_scale, judged_orders, motor_speed_rps
from hil.control.treatments import LoopName
from hil.counting import counted
from hil.design.ate.identification import JointEstimate, identify_one_way
from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.frequency import CONTROL_PERIOD_S, Loop, Margins, margins
from hil.design.transmission_error import TransmissionError
from hil.experiments.judge import line_scale, scale_at, shown_rps
from hil.experiments.motions import CONSTANT_ACCELERATION
from hil.experiments.treatment import TITLES
from hil.recording import Recording
from hil.report.origin import origin_of
from hil.results.acted import FilterSet, notches_of
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult, RunEntry
from hil.robot_tables import NotchTable

FEWEST_ROWS = 64
"""Least number of rows: a shorter recording cannot be filtered."""

MARGIN_SPEEDS_RPS = np.linspace(0.5, 10.5, 41)
"""Motor speeds at which stability and margins are computed."""
FILTER_SPEEDS = 11
"""Motor speeds from f_s to f_e of each filter at which they are, too."""

FIT_BELOW, FIT_ABOVE = 15.0 / 22.0, 1.2
"""Motor speeds of a rising ramp from which the transmission error is identified: from below the window of order 4, in units of
its beginning, to above that of order 2, in units of its end."""


def case_name(experiment: str, axis: int | None) -> str:
    """Name of a motion in words; the axis is None for one of several."""
    return experiment.replace("-", " ") if axis is None else f"axis {axis}, {experiment.replace('-', ' ')}"


def run_name(run: RunEntry, *, with_window: bool = True) -> str:
    """Name of a run in words."""
    window = "" if run.order is None or not with_window else f", k = {run.order} window"
    return f"{case_name(run.experiment, run.axis)}, {treatment_name(run.treatment)}, {run.loop}-closed{window}"


def treatment_name(name: str) -> str:
    """Name of a treatment in words, for the report of runs."""
    names: dict[str, str] = {**TITLES, "none": "untreated"}
    return names.get(name, name)


class Material:
    """Result, bench and recordings of one directory."""

    def __init__(self, directory: Path) -> None:
        """Read result.json.

        Raises:
            OSError: result.json cannot be read.
            ResultFileError: The file is not the result of runs.
        """
        self.directory = directory
        self.result = load_result(directory, ExperimentsResult, "runs")
        self.bench = self.result.bench.file
        self.notes: list[str] = []
        self._recordings: dict[str, Recording | None] = {}
        self._margins: dict[tuple[int, tuple[str, ...]], dict[float, Margins]] = {}
        self._estimates: dict[int, JointEstimate | None] = {}

    @cached_property
    def model_axes(self) -> tuple[int, ...]:
        """Axes with a model and known gains, in order."""
        return tuple(sorted(number for number, axis in self.bench.axis.items() if axis.has_loop))

    @cached_property
    def control_period_s(self) -> float:
        """Period of the loop inside the drives in s."""
        periods = [run.control_period_s for run in self.result.runs if run.loop == "drive" and run.control_period_s]
        return periods[0] if periods else CONTROL_PERIOD_S

    @cached_property
    def f_al_hz(self) -> dict[int, float]:
        """Peak frequency of |G_al| by axis, of the axes with a model."""
        loops = {number: self.loop(number) for number in self.model_axes}
        return {number: loop.peak_hz() for number, loop in loops.items()}

    def scale(self, axis: int | None) -> TipScale | None:
        """Return the scale of an axis, or of the line motion (None)."""
        if axis is None:
            known = line_scale(self.bench, self.control_period_s)
            own = [
                scale_at(self.bench, number, f_al) for number, f_al in self.own_f_al_hz.items() if number in self.bench.chain_axes
            ]
            return known or (joint_scale(own) if own else None)
        f_al_hz = self.f_al_hz.get(axis, self.own_f_al_hz.get(axis))
        return None if f_al_hz is None else scale_at(self.bench, axis, f_al_hz)

    @cached_property
    def own_f_al_hz(self) -> dict[int, float]:
        """f_al by axis, of those whose ramps show it by themselves."""
        return {
            run.axis: run.f_al_hz
            for run in self.result.runs
            if run.f_al_source == "own" and run.axis is not None and run.f_al_hz is not None
        }

    def f_al(self, axis: int | None) -> float | None:
        """Return f_al for displacements; None if unknown, or on an arm's line."""
        scale = self.scale(axis)
        return None if scale is None or (axis is None and self.bench.arm is not None) else scale.f_al_hz

    def band_hz(self, axis: int | None) -> tuple[float, float]:
        """Return the band of a drawn vibration, the paper's without an f_al."""
        scale = self.scale(axis)
        return PAPER_BAND_HZ if scale is None else scale.band_hz

    def window_rps(self, axis: int | None, order: int) -> tuple[float, float] | None:
        """Return the motor speeds in which an order is judged."""
        scale = self.scale(axis)
        return None if scale is None else scale.windows_rps.get(order)

    def judged_orders(self, axis: int) -> tuple[int, ...]:
        """Orders in whose windows the ramps of an axis are judged."""
        return judged_orders(self.scale(axis), shown_rps(self.bench))

    @property
    def word(self) -> str:
        """Word for data of the robot: `measured`, or `emulated`."""
        return origin_of(self.result).word

    @cached_property
    def filter_sets(self) -> tuple[FilterSet, ...]:
        """Filters that acted in the runs, grouped by treatment; filters in the drives come first."""
        found: dict[tuple[LoopName, str], dict[int, tuple[NotchTable, ...]]] = {}
        for run in sorted(self.result.runs, key=lambda run: run.loop):
            notches = notches_of(run.filters)
            if notches:
                loop: LoopName = "host" if run.loop == "host" else "drive"
                found.setdefault((loop, run.treatment), {}).update(notches)
        sets: list[FilterSet] = []
        for (loop, name), notches in found.items():
            alike = (each for each in sets if name in each.treatments or (each.loop, each.notches) == (loop, notches))
            same = next(alike, None)
            if same is None:
                sets.append(FilterSet((name,), loop, notches))
            elif name not in same.treatments:
                sets[sets.index(same)] = same._replace(treatments=(*same.treatments, name))
        return tuple(sets)

    def acting(self, axis: int) -> FilterSet | None:
        """The first filters that acted on an axis; None if none did."""
        return next((each for each in self.filter_sets if axis in each.notches), None)

    @property
    def model_source(self) -> str:
        """File that the model comes from, in words."""
        return "model file" if any(file.role == "model" for file in self.result.files) else "bench file"

    def loop(self, axis: int, filters: FilterSet | None = None) -> Loop:
        """Return the loop of an axis with a model."""
        table, period_s, delay = self.bench.axis[axis], self.control_period_s, 0
        if filters is not None:
            table = table.model_copy(update={"notch": filters.notches.get(axis, ())})
            if filters.loop == "host":
                period_s, delay = next(run.control_period_s for run in self.result.runs if run.loop == "host"), 1
        loop = table.loop(period_s, delay, with_notch=filters is not None)
        if loop is None:
            raise ValueError(f"axis {axis} has no model")
        return loop

    def margins(self, axis: int, filters: FilterSet | None = None) -> dict[float, Margins]:
        """Return the margins of an axis with a model, by motor speed."""
        key = axis, () if filters is None else filters.treatments
        if key not in self._margins:
            loop = self.loop(axis, filters)
            own = [np.linspace(notch.start_rps, notch.end_rps, FILTER_SPEEDS) for notch in loop.notches]
            speeds = np.unique(np.round(np.concatenate([MARGIN_SPEEDS_RPS, *own]), 6))
            self._margins[key] = {float(speed): margins(loop, float(speed), points=1000) for speed in speeds}
        return self._margins[key]

    def transmission_error(self, axis: int) -> TransmissionError | None:
        """θ_sync of an axis in the bench file."""
        model = self.bench.axis[axis].model if axis in self.bench.axis else None
        if model is None:
            return None
        ate = model.ate
        return TransmissionError(ate.amplitudes_arcsec(), ate.phases_deg())

    def amplitude_arcsec(self, axis: int, order: int) -> float:
        """A_k of the bench file; 0 if it is not known."""
        error = self.transmission_error(axis)
        return 0.0 if error is None else error.amplitude_arcsec.get(order, 0.0)

    def find(
        self, experiment: str, axis: int | None = None, treatment: str = "none", loop: str = "drive", order: int | None = None
    ) -> RunEntry | None:
        """Return the entry of a run, or None.

        Without an order, the entry of its first window. The axis is None for a motion of several.
        """
        for run in self.result.runs:
            same = (run.experiment, run.axis, run.treatment, run.loop) == (experiment, axis, treatment, loop)
            if same and order in (None, run.order):
                return run
        return None

    def recording(self, run: RunEntry | None) -> Recording | None:
        """Return the recording of a run, or None."""
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
            self.notes.append(f"{name} cannot be read: {getattr(error, 'strerror', None) or error}")
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
        """Recording without holes: missing samples are interpolated, and a note counts them."""
        holes = {key: ~np.isfinite(column) for key, column in recording.columns.items()}
        count = max(int(np.count_nonzero(hole)) for hole in holes.values())
        if not count:
            return recording
        row = np.arange(len(recording.time_s), dtype=np.float64)
        columns = {
            key: np.interp(row, row[~hole], recording.columns[key][~hole]) if not hole.all() else np.zeros(len(row))
            for key, hole in holes.items()
        }
        self.notes.append(f"{name}: {counted(count, 'sample')} {'is' if count == 1 else 'are'} missing; the figures interpolate.")
        return Recording(columns)

    def estimate(self, axis: int) -> JointEstimate | None:
        """Return θ_sync identified from the run without a notch."""
        if axis not in self._estimates:
            self._estimates[axis] = self._identify(axis)
        return self._estimates[axis]

    def _identify(self, axis: int) -> JointEstimate | None:
        if axis not in self.model_axes:
            return None
        runs = [self.find(CONSTANT_ACCELERATION, axis, loop=loop) for loop in ("drive", "host")]
        recording = next((each for each in map(self.recording, runs) if each is not None), None)
        if recording is None:
            return None
        table = self.bench.axis[axis]
        speed = np.abs(motor_speed_rps(recording, axis))
        scale = self.scale(axis)
        if scale is None:
            return None
        orders = self.judged_orders(axis)
        (low, _), (_, high) = (scale.windows_rps[order] for order in (max(orders), min(orders)))
        low, high = round(FIT_BELOW * low, 6), round(FIT_ABOVE * high, 6)
        rows = (speed > low) & (speed < high) & (np.arange(len(speed)) < int(np.argmax(speed)))
        angle, tip = recording.axis(axis, "position_rad"), recording.felt_m_s2
        plant = cast("Any", table.plant())
        ramp = Sweep(angle, tip, recording.period_s, rows.astype(np.int8))
        try:
            return identify_one_way(ramp, table.reduction_ratio, Sensing(table.tip_lever_m), Arm.of(plant), orders)
        except ValueError as error:
            self.notes.append(f"The transmission error of axis {axis} cannot be identified: {error}.")
            return None


def finite(value: float | None) -> bool:
    """True for a number that is neither infinite nor NaN."""
    return value is not None and math.isfinite(value)


def worst_of(margins: Iterable[Margins]) -> Margins:
    """Return the worst of each margin, over motor speeds."""
    found = list(margins)
    return Margins(
        max(each.sensitivity_peak for each in found),
        min(each.gain_margin_db for each in found),
        min(each.phase_margin_deg for each in found),
        all(each.stable for each in found),
        max(each.pole_radius for each in found),
    )
