"""Differences between the settings of two results.

Settings are the bench file with gains, filters and model, the request, and the versions.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

from hil.report.report_table import NONE, Cell, ReportTable
from hil.results.ate import AteResult
from hil.results.base import MeasuredResult
from hil.results.plant import PlantResult

MOST_DIFFERING = 200
"""Most settings that are shown."""
GROUPS = ("Control", "Model", "Bench file", "Request", "Bus and versions")


class Setting(NamedTuple):
    """A setting that differs: its group, its key, both values as text."""

    group: str
    key: str
    old: str
    new: str


def differing(new: MeasuredResult, old: MeasuredResult) -> list[Setting]:
    """Return the settings that differ, by groups.

    A setting of one result alone has a dash for the other.
    """
    own, other = dict(_settings(new)), dict(_settings(old))
    found = [
        Setting(_group(key), key, _text(other.get(key)), _text(own.get(key)))
        for key in dict.fromkeys((*own, *other))
        if own.get(key) != other.get(key)
    ]
    return sorted(found, key=lambda each: GROUPS.index(each.group))


def settings_table(found: list[Setting]) -> ReportTable:
    """Table of the settings that differ."""
    rows: list[list[Cell]] = []
    groups: dict[int, str] = {}
    for setting in found[:MOST_DIFFERING]:
        if setting.group not in groups.values():
            groups[len(rows)] = setting.group
        rows.append([f"`{setting.key}`", setting.old, setting.new])
    more = len(found) - MOST_DIFFERING
    caption = f"{more} more are not shown." if more > 0 else "" if found else "No setting differs."
    header = ("Setting", "old", "new")
    return ReportTable("settings", "Settings that differ", "", header, rows, frozenset({0, 1, 2}), caption, True, groups)


def _settings(result: MeasuredResult) -> Iterator[tuple[str, Any]]:
    bench = result.bench
    yield from _flat(bench.file.model_dump(mode="json"), "")
    if isinstance(result, PlantResult):
        yield from _flat(result.request.model_dump(mode="json"), "request.")
    if isinstance(result, AteResult):
        yield from _flat(result.known_before.model_dump(mode="json"), "request.known_before.")
        yield "request.sensorless", result.sensorless
    yield "run.bus", bench.bus
    yield "run.clock", bench.clock
    yield from _flat(dict(bench.versions), "run.versions.")


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield the single values in a value, with their dotted keys.

    Places in a list count from 1.
    """
    if isinstance(value, dict):
        parts = [(str(key), each) for key, each in value.items()]
    elif isinstance(value, list | tuple) and any(isinstance(each, dict | list | tuple) for each in value):
        parts = [(str(place), each) for place, each in enumerate(value, 1)]
    else:
        yield path.removesuffix("."), value
        return
    for key, each in parts:
        yield from _flat(each, f"{path}{key}.")


def _group(key: str) -> str:
    parts = key.split(".")
    if parts[0] in {"request", "run"}:
        return "Request" if parts[0] == "request" else "Bus and versions"
    if parts[0] == "axis" and len(parts) > 2:
        return {"control": "Control", "notch": "Control", "model": "Model"}.get(parts[2], "Bench file")
    return "Bench file"


def _text(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:.10g}".replace("-", "−")
    return ", ".join(map(_text, value)) if isinstance(value, list | tuple) else str(value)
