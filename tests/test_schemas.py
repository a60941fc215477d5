"""The JSON Schemas of all kinds of TOML files know every key of every such file of the project, and say what keys are for."""

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app as drive_profiles
from hil.cli.main import app as hil
from plant_emulator.cli.main import app as plant_emulator

PROJECT = Path(__file__).parents[1]
KINDS = {
    "bench": hil, "model": hil, "design": hil, "layout": hil, "profile": drive_profiles, "parameters": drive_profiles,
    "robot": plant_emulator, "tuning": plant_emulator, "spread": plant_emulator, "faults": plant_emulator,
}  # fmt: skip
FILES = {
    "bench": [*sorted((PROJECT / "hil" / "bench").glob("*.toml")), PROJECT / "examples" / "load-encoder.toml"],
    "profile": sorted((PROJECT / "drive_profiles" / "vendors").glob("*.toml")),
    "tuning": [PROJECT / "plant_emulator" / "robots" / "reference_tuning.toml"],
    "robot": [PROJECT / "plant_emulator" / "robots" / name for name in ("reference.toml", "reference_arm.toml")],
    "faults": sorted((PROJECT / "examples" / "faults").glob("*.toml")),
}


def unknown_keys(schema: dict[str, Any], document: Any) -> Iterator[str]:
    """Keys of a document that its schema does not know, with their tables: what an editor would underline."""
    yield from _unknown(schema, schema, document, "")


def _unknown(root: dict[str, Any], part: dict[str, Any], value: Any, where: str) -> Iterator[str]:
    part = _resolved(root, part)
    choices = [_resolved(root, each) for each in (*part.get("anyOf", ()), *part.get("oneOf", ()))]
    if choices:
        found = [list(_unknown(root, each, value, where)) for each in choices if _fits(each, value)]
        yield from min(found, key=len, default=[where or "the file"])
        return
    if isinstance(value, dict):
        patterns = part.get("patternProperties", {})
        for key, each in value.items():
            below = part.get("properties", {}).get(key) or next((s for p, s in patterns.items() if re.search(p, key)), None)
            below = below if below is not None else part.get("additionalProperties", True)
            path = f"{where}.{key}" if where else key
            if below is False:
                yield path
            elif isinstance(below, dict):
                yield from _unknown(root, below, each, path)
    elif isinstance(value, list) and isinstance(part.get("items"), dict):
        for number, each in enumerate(value):
            yield from _unknown(root, part["items"], each, f"{where}[{number}]")


def _resolved(root: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in part:
        found = root
        for name in part["$ref"].removeprefix("#/").split("/"):
            found = found[name]
        part = found
    return part


_KINDS: dict[str, type | tuple[type, ...]] = {
    "object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)
}  # fmt: skip


def _fits(part: dict[str, Any], value: Any) -> bool:
    kind = part.get("type")
    return kind is None or isinstance(value, _KINDS[kind])


def schema_of(kind: str) -> dict:
    result = CliRunner().invoke(KINDS[kind], ["schema", kind])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_every_toml_file_of_the_project_is_of_a_kind():
    skipped = {PROJECT / "drive_profiles" / "family" / "runs.toml"}  # a program writes it, nobody edits it
    folders = ("drive_profiles", "hil", "plant_emulator", "examples")
    there = {path for folder in folders for path in (PROJECT / folder).rglob("*.toml")} - skipped
    assert there == {path for paths in FILES.values() for path in paths}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "path"), [(kind, path) for kind, paths in FILES.items() for path in paths],
                         ids=lambda each: getattr(each, "stem", each))  # fmt: skip
def test_the_schema_knows_every_key_of_the_file(kind, path):
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    schema = schema_of(kind)
    assert list(unknown_keys(schema, document)) == []
    if kind != "tuning":  # which is read out of a file that has more
        assert list(unknown_keys(schema, document | {"no_such_key": 1})) == ["no_such_key"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_has_its_title_its_draft_and_only_references_that_lead_somewhere(kind):
    schema = schema_of(kind)
    assert schema["$schema"].endswith("2020-12/schema")
    assert kind in schema["title"]
    for name in re.findall(r'"#/\$defs/([^"]+)"', json.dumps(schema)):
        assert name in schema["$defs"]


def test_an_editor_says_what_a_key_is_for():
    axis = schema_of("bench")["$defs"]["AxisTable"]
    assert axis["properties"]["reduction_ratio"]["description"] == "Reduction ratio N of the gear."
    assert "Attributes:" not in axis["description"]


def test_a_mistyped_table_deep_in_a_bench_is_found():
    schema = schema_of("bench")
    document = tomllib.loads((PROJECT / "hil" / "bench" / "reference.toml").read_text())
    document["axis"]["2"]["limits"]["sped_rps"] = 3.0
    assert list(unknown_keys(schema, document)) == ["axis.2.limits.sped_rps"]


def test_a_schema_is_written_to_a_file_that_is_not_there_yet(tmp_path):
    out = tmp_path / "bench.schema.json"
    assert CliRunner().invoke(hil, ["schema", "bench", "--out", str(out)]).exit_code == 0
    assert json.loads(out.read_text()) == schema_of("bench")
    assert CliRunner().invoke(hil, ["schema", "bench", "--out", str(out)]).exit_code == 3
    assert CliRunner().invoke(hil, ["schema", "robot"]).exit_code == 2
