"""hil schema: the JSON Schema of the TOML files that `hil` reads."""

# ruff: noqa: PLC0415 - --help must not wait for numpy and pydantic

from typing import Any

import typer

from drive_profiles.cli.schema import mount_schema


def mount(app: typer.Typer) -> None:
    """Add the command to `hil`."""
    kinds = {"bench": _bench, "model": _model, "design": _design, "layout": _layout}
    mount_schema(app, kinds, "hil schema bench --out bench.schema.json")


def _bench() -> Any:
    from hil.bench.bench import Bench

    return Bench


def _model() -> Any:
    from hil.bench.model import Identified

    return Identified


def _design() -> Any:
    from hil.bench.design import Designs

    return Designs


def _layout() -> Any:
    from hil.recordings.layout import LayoutFile

    return LayoutFile
