"""plant-emulator schema: JSON Schema of the emulator's TOML files."""

# ruff: noqa: PLC0415 - --help must not wait for numpy

from typing import Any

import typer

from drive_profiles.cli.schema import mount_schema


def mount(app: typer.Typer) -> None:
    """Add the command to `plant-emulator`."""
    kinds = {"robot": _robot, "tuning": _tuning, "spread": _spread, "faults": _faults}
    mount_schema(app, kinds, "plant-emulator schema robot --out robot.schema.json")


def _robot() -> Any:
    from plant_emulator.robots.robot import ArmRobot, Robot

    return ArmRobot | Robot


def _tuning() -> Any:
    from plant_emulator.robots.tuning import Tuning

    return Tuning


def _spread() -> Any:
    from plant_emulator.studies.spread import PlantSpread

    return PlantSpread


def _faults() -> Any:
    from plant_emulator.bus.faults import FaultsFile

    return FaultsFile
