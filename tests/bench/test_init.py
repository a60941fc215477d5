"""hil init on a served robot, the rest typed by hand: a bench on which checks and runs work."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.bench.bench import load_bench
from hil.cli.main import app


def hil(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.output


def typed(text: str) -> str:
    """What an engineer types: here the numbers of the reference bench."""
    known = load_bench("reference")
    motion = known.constant_acceleration
    assert motion is not None
    values: dict[str, float] = {
        "accelerometer.range_m_s2": 19.62, "constant_acceleration.acceleration_rps_s": 8.0,
        "constant_acceleration.end_rps": 4.0, "constant_acceleration.deceleration_rps_s": 20.0,
    }  # fmt: skip
    for number, axis in known.axis.items():
        control, limits = axis.control.model_dump(), axis.limits  # type: ignore[union-attr]
        values |= {f"axis.{number}.control.{key}": value for key, value in control.items()}
        values |= {f"axis.{number}.reduction_ratio": axis.reduction_ratio, f"axis.{number}.tip_lever_m": axis.tip_lever_m}
        values |= {f"axis.{number}.limits.{key}": getattr(limits, key) for key in (
            "speed_rps", "acceleration_rps_s", "position_min_rev", "position_max_rev"
        )}  # fmt: skip
    lines, table = [], ""
    for line in text.splitlines():
        if head := re.match(r"\[([\w.]+)\]", line):
            table = head[1]
        key, _, value = line.partition(" = ")
        lines.append(f"{key} = {values[f'{table}.{key}']}" if value.startswith('"TYPE:') else line)
    return "\n".join(lines)


@pytest.mark.slow
def test_a_scan_and_what_is_typed_give_a_bench_on_which_check_and_run_work(hil_local_bus, tmp_path, monkeypatch):
    monkeypatch.delenv("HIL_BUS", raising=False)
    bench = tmp_path / "bench.toml"
    status, said = hil("init", "--bus", hil_local_bus.address, "--out", str(bench))
    assert status == 0, said
    assert "axis.2.reduction_ratio" in said
    status, said = hil("plan", "--bench", str(bench))
    assert status == 3
    assert f"{bench.name}:" in said.replace("\n", "")

    status, said = hil("init", "--bus", hil_local_bus.address, "--out", str(bench))
    assert (status, "already exists" in said) == (3, True)

    bench.write_text(typed(bench.read_text()))
    status, said = hil("check", "--bench", str(bench), "--axis", "2", "--out", str(tmp_path / "check"))
    assert status == 0, said
    assert "FAIL" not in said
    run = ("run", "constant-acceleration", "--axis", "2", "--bench", str(bench), "--out", str(tmp_path / "run"))
    status, said = hil(*run)
    assert status in {0, 9}, said  # 9: the tip of a robot without a treatment is outside of its specification
    assert (tmp_path / "run" / "result.json").exists()


def test_a_bus_on_which_nobody_answers_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.delenv("HIL_BUS", raising=False)
    status, _ = hil("init", "--bus", f"local:{tmp_path}/nobody.sock", "--out", str(tmp_path / "bench.toml"))
    assert status in {3, 4}
    assert not Path(tmp_path / "bench.toml").exists()
    assert hil("init", "--out", str(tmp_path / "bench.toml"))[0] == 2
