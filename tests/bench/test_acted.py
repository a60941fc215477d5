"""result.json of `hil run` says what acted: filters as the drives held them, cancelled orders, and the files behind them."""

import hashlib
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hil.bench.bench import REFERENCE, load_bench
from hil.cli.main import app
from hil.control.notch import FixedFilter
from plant_emulator.pytest_plugin.target import ServedBus


def result_of(tmp_path: Path, bus: ServedBus, treatment: str, *more: str) -> Any:
    """result.json of a ramp of axis 2."""
    bench, out = tmp_path / "bench.toml", tmp_path / treatment
    bench.write_text(REFERENCE.read_text(encoding="utf-8"), encoding="utf-8")
    done = CliRunner().invoke(app, [
        "run", "constant-acceleration", "--axis", "2", "--treatment", treatment, "--bench", str(bench), "--bus", bus.address,
        "--out", str(out), "--no-report", *more,
    ])  # fmt: skip
    assert done.exit_code in {0, 9}, done.output
    return json.loads((out / "result.json").read_text(encoding="utf-8"))


@pytest.mark.ci
def test_a_result_holds_the_filter_as_the_drive_held_it_and_the_file_it_came_from(
    tmp_path: Path, hil_local_bus: ServedBus
) -> None:
    found = result_of(tmp_path, hil_local_bus, "notch")
    asked = load_bench("reference").axis[2].notch[0].model_dump()
    for run in found["runs"]:
        (acted,) = run["filters"]
        assert (acted["axis"], acted["held_by"]) == (2, "drive")
        assert acted["notch"].pop("shape") == asked["shape"]
        numbers = {key: value for key, value in asked.items() if key != "shape"}
        assert acted["notch"] == pytest.approx(numbers, rel=1e-6), "a REAL32 rounds"
        assert run["cancelled"] == []
    content = (tmp_path / "bench.toml").read_bytes()
    assert found["files"] == [
        {"role": "bench", "path": str(tmp_path / "bench.toml"), "sha256": hashlib.sha256(content).hexdigest()}
    ]


@pytest.mark.slow
def test_a_result_holds_the_orders_that_were_cancelled(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    model = load_bench("reference").axis[2].model
    assert model is not None
    for treatment, held_by in (("cancellation", "host"), ("cancellation-inside", "drive")):
        (first, *_) = result_of(tmp_path, hil_local_bus, treatment)["runs"]
        assert first["filters"] == []
        assert {each["order"]: each["amplitude_arcsec"] for each in first["cancelled"]} == pytest.approx(
            model.ate.amplitudes_arcsec(), rel=1e-6
        )
        assert {each["order"]: each["phase_deg"] for each in first["cancelled"]} == pytest.approx(model.ate.phases_deg())
        assert {each["held_by"] for each in first["cancelled"]} == {held_by}


@pytest.mark.slow
def test_a_loop_that_the_host_closes_tells_its_own_filters(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    (first, *_) = result_of(tmp_path, hil_local_bus, "notch", "--loop", "host")["runs"]
    assert [(each["axis"], each["held_by"]) for each in first["filters"]] == [(2, "host")]
    (first, *_) = result_of(tmp_path, hil_local_bus, "fixed-notch", "--loop", "host")["runs"]
    assert first["filters"][0]["fixed"].keys() == {each.name for each in fields(FixedFilter)}
