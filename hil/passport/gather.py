"""Reading of results and model files into a passport, each run once."""

import cmath
import datetime
import hashlib
import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drive_profiles.errors import FileError
from hil.bench.bench import Bench
from hil.bench.model import IdentifiedError, LearntBy, load_identified
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.ate.identification import Agreement
from hil.errors import NotPossibleError
from hil.passport.store import MOST_ORDERS, MOST_TEXT, OrderLine, OrderSides, PassportRun
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE
from hil.results.files import ResultFileError, load_any
from hil.results.learning import LearningResult, MotionLearningResult
from hil.results.recorded_ate import OrderEntry, RecordedAteResult, RecordedStretch

_AMPLITUDE = re.compile(r"a(\d+(?:\.\d+)?)_arcsec")


def sides_of_passes(agreement: Sequence[Agreement]) -> tuple[OrderSides, ...]:
    """Orders of an identification by direction, from its ramps."""
    by_name = {each.name: each for each in agreement}
    made = []
    for name, amplitude in by_name.items():
        found = _AMPLITUDE.fullmatch(name)
        phase = by_name.get(f"phi{found[1]}_deg") if found else None
        if found and phase is not None:
            turn = math.remainder(phase.forward - phase.backward, 360.0)
            made.append(OrderSides(float(found[1]), amplitude.forward, amplitude.backward, amplitude.sigma, turn, phase.sigma))
    return tuple(made)


def sides_of_stretches(stretches: Sequence[RecordedStretch]) -> tuple[OrderSides, ...]:
    """Return the orders of recordings in either direction."""
    values: dict[float, dict[int, list[OrderEntry]]] = {}
    for stretch in stretches:
        for entry in stretch.values:
            values.setdefault(entry.order, {}).setdefault(stretch.direction, []).append(entry)
    made = []
    for order, ways in sorted(values.items()):
        if set(ways) == {-1, 1}:
            (one, one_error), (other, other_error) = (_mean(ways[way]) for way in (1, -1))
            error = math.hypot(one_error, other_error)
            least = min(abs(one), abs(other))
            turn = math.degrees(cmath.phase(one / other)) if least > 0.0 else 0.0
            if error > 0.0 and least > 0.0:
                sigmas = abs(math.radians(turn)) * least / error
                made.append(OrderSides(order, abs(one), abs(other), abs(abs(one) - abs(other)) / error, turn, sigmas))
    return tuple(made)


def _mean(entries: Sequence[OrderEntry]) -> tuple[complex, float]:
    """Return the mean of A e^{jφ} and its standard error."""
    points = np.array([each.a_arcsec * cmath.exp(1j * math.radians(each.phi_deg)) for each in entries])
    own = float(np.mean([each.a_error_arcsec**2 for each in entries]))
    scatter = float(np.var(points, ddof=1)) / 2.0 if len(points) > 1 else 0.0
    return complex(np.mean(points)), math.sqrt(max(own, scatter) / len(points))


MOST_FOUND_FILES = 20_000
"""Most files below the folders that are looked at."""
MOST_BYTES = 16_000_000
"""Largest file that is read."""
KINDS = ("identify-ate", "identify-ate-recording", "learn", "learn-motion")
"""Kinds of results that have a transmission error."""

EARLIEST = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
AHEAD = datetime.timedelta(days=1)
"""How far another computer's clock may be ahead of this one's."""

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(?:\.\d+)?(?:Z|[+-]\d{2}:\d{2})?")
_TEMPERATURE = re.compile(r"(?<![\w.])([-−]?\d{1,3}(?:\.\d+)?) ?°C")
_LOAD = re.compile(r"(?<![\w.])(\d{1,4}(?:\.\d+)?) ?kg\b(?!·)")
_NO_LOAD = re.compile(r"\bno load\b", re.IGNORECASE)
_DIRECTION = re.compile(r"\b(forward|backward)s?\b", re.IGNORECASE)


@dataclass(frozen=True)
class Gathered:
    """Identifications below folders.

    Attributes:
        runs: Identifications; one in several files appears once.
    """

    runs: tuple[PassportRun, ...]
    left_out: tuple[str, ...]


def gather(folders: Iterable[Path], note: str = "") -> Gathered:
    """Read all identifications of transmission errors below some folders.

    Symbolic links are not followed. `note` has conditions of all, if their own notes have none: `22 °C, no load`.

    Raises:
        NotPossibleError: There are too many files.
    """
    runs: dict[str, PassportRun] = {}
    left_out = []
    for path in found_files(folders, ".toml"):
        if path.stat().st_size > MOST_BYTES:
            left_out.append(f"{path}: larger than {MOST_BYTES // 1_000_000} MB")
            continue
        try:
            found = list(_of_result(path) if path.name == RESULT_FILE else _of_model(path))
        except (ResultFileError, FileError, OSError, ValueError) as error:
            left_out.append(f"{path}: {str(error).removeprefix(f'{path}: ')}")
            continue
        for run in found:
            runs.setdefault(run.content, _with_conditions(run, note))
    return Gathered(tuple(sorted(runs.values(), key=lambda run: (run.robot, run.axis, run.measured_utc))), tuple(left_out))


def found_files(folders: Iterable[Path], *endings: str) -> list[Path]:
    """Return the results below folders, and the files with these endings behind them; links are not followed.

    Raises:
        NotPossibleError: There are too many.
    """
    found: list[Path] = []
    for folder in folders:
        for here, _, names in os.walk(folder):
            found += [Path(here) / name for name in names if name == RESULT_FILE or name.endswith(endings)]
            if len(found) > MOST_FOUND_FILES:
                raise NotPossibleError(f"more than {MOST_FOUND_FILES} files below {folder}; give folders with fewer")
    return sorted((path for path in found if not path.is_symlink()), key=lambda path: (path.name != RESULT_FILE, str(path)))


def _of_result(path: Path) -> Iterator[PassportRun]:
    with path.open("rb") as file:
        value = json.load(file)
    if not isinstance(value, dict) or value.get("kind") not in KINDS:
        return
    result = load_any(path)
    if isinstance(result, RecordedAteResult) and result.ate is not None:
        run = _run(result.robot, result.axis, result.ate, result.started_utc, path)
        seen = "torque" if result.form == "motor torque" else "motion"
        yield replace(run, emulated=result.ate.emulated, seen_by=seen, sides=sides_of_stretches(result.stretches))
    if isinstance(result, AteResult) and result.ate is not None:
        yield _of_passes(result, result.ate, path)
    if isinstance(result, LearningResult | MotionLearningResult):
        top = max((each.end_rps for each in result.runs), default=None) if isinstance(result, LearningResult) else None
        for learnt in result.learnt:
            run = _run(result.bench.name, learnt.axis, learnt.ate, result.bench.started_utc, path)
            yield replace(run, top_rps=top, emulated=result.emulated, **_motor(result.bench.file, learnt.axis))


def _of_passes(result: AteResult, part: IdentifiedError, path: Path) -> PassportRun:
    """Return an identification by ramps as a run."""
    run = _run(result.bench.name, result.axis, part, result.bench.started_utc, path)
    degrees = 360.0 / result.bench.file.axis[result.axis].reduction_ratio
    return replace(
        run,
        emulated=result.emulated,
        top_rps=max((each.end_rps for each in result.passes), default=None),
        joint_low_deg=min((degrees * each.low_rev for each in result.passes), default=None),
        joint_high_deg=max((degrees * each.high_rev for each in result.passes), default=None),
        seen_by="torque" if result.sensorless else "motion",
        sides=() if result.fit is None else sides_of_passes(result.fit.agreement),
        **_motor(result.bench.file, result.axis),
    )


def _motor(bench: Bench, axis: int) -> dict[str, Any]:
    motor = bench.axis[axis].motor if axis in bench.axis else None
    return {} if motor is None else {"pole_pairs": motor.pole_pairs, "slots": motor.slots}


def _of_model(path: Path) -> Iterator[PassportRun]:
    with path.open("rb") as file:
        value: dict[str, Any] = tomllib.load(file)
    axes = value.get("axis")
    if not isinstance(value.get("robot"), str) or not isinstance(axes, dict):
        return
    if not any(isinstance(axis, dict) and "ate" in axis and "model" not in axis for axis in axes.values()):
        return
    identified = load_identified(path)
    written = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC).isoformat(timespec="seconds")
    for number, known in identified.axis.items():
        if known.ate is not None:
            said = _DATE.search(known.ate.note)
            yield _run(identified.robot, number, known.ate, said[0] if said else written, path)


SEEN_BY: dict[LearntBy, str] = {"identify": "motion", "sensorless": "torque"}
"""In what an error was read, by `learnt_by` of a model file, where that says it."""


def _run(robot: str, axis: int, part: IdentifiedError, date: str, path: Path) -> PassportRun:
    """Return a run of the passport.

    Its hash is that of the measurement, whatever the file.
    """
    content = json.dumps([robot, axis, part.model_dump(mode="json", exclude={"emulated"})], sort_keys=True)
    phases, errors = part.values.phases_deg(), part.standard_error
    lines = tuple(
        OrderLine(
            float(order), amplitude, errors.get(amplitude_key(order), 0.0), phases[order], errors.get(phase_key(order), 0.0)
        )
        for order, amplitude in part.values.amplitudes_arcsec().items()
    )
    longest = max(len(text) for text in (robot, part.note, str(path)))
    if longest > MOST_TEXT or len(lines) > MOST_ORDERS:
        raise ValueError(f"{longest} characters in a text and {len(lines)} orders; the limits are {MOST_TEXT} and {MOST_ORDERS}")
    return PassportRun(
        content=hashlib.sha256(content.encode()).hexdigest(),
        robot=robot,
        axis=axis,
        measured_utc=utc_of(date),
        learnt_by=part.learnt_by,
        note=part.note,
        emulated=part.emulated,
        source=str(path),
        lines=lines,
        seen_by=SEEN_BY.get(part.learnt_by),
    )


def _with_conditions(run: PassportRun, note: str) -> PassportRun:
    """Return the run with the conditions from its note."""
    texts = (run.note, note)
    temperature, load, way = (
        next((found for text in texts if (found := pattern.search(text))), None) for pattern in (_TEMPERATURE, _LOAD, _DIRECTION)
    )
    is_bare = _NO_LOAD.search(run.note) or (_LOAD.search(run.note) is None and _NO_LOAD.search(note))
    return replace(
        run,
        note=", ".join(text for text in texts if text),
        temperature_c=None if temperature is None else float(temperature[1].replace("−", "-")),
        load_kg=0.0 if is_bare else None if load is None else float(load[1]),
        direction=None if way is None else way[1].lower(),
    )


def utc_of(text: str) -> str:
    """Return a date of ISO 8601 in UTC.

    Such dates sort as text.

    Raises:
        ValueError: It is not a date; or it is before the year 2000 or in the future, from a clock that was not set.
    """
    date = datetime.datetime.fromisoformat(text)
    utc = date.replace(tzinfo=datetime.UTC) if date.tzinfo is None else date.astimezone(datetime.UTC)
    if utc < EARLIEST or utc > datetime.datetime.now(datetime.UTC) + AHEAD:
        when = "before 2000" if utc < EARLIEST else "in the future"
        raise ValueError(f"dated {utc:%Y-%m-%d}, which is {when}: the clock of that computer was wrong")
    return utc.isoformat(timespec="seconds")
