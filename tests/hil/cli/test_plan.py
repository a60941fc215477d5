"""`hil plan` as a user meets it: exit status, verdict, JSON, and what it says of a wrong option."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles.family.profile import VENDORS
from hil.bench.bench import REFERENCE
from hil.cli.main import app
from hil.robot_tables import Control


def plan(*options, bench="reference"):
    return CliRunner().invoke(app, ["plan", "--bench", str(bench), *options])


def test_the_reference_bench_fits_its_bus_without_bit_times():
    result = plan()
    assert result.exit_code == 0
    assert "125 kbit/s" in result.output
    assert "fits: 2 ms" in result.output.splitlines()[-1].lower()
    assert "drive-closed stable" in result.output.splitlines()[-1]


def test_off_a_terminal_tables_have_a_title_each_and_a_line_for_each_row():
    lines = plan("--bitrate", "1M").stdout.splitlines()
    assert "One cycle, bits on the wire" in lines
    assert ["SYNC", "080h", "0", "47", "51.0", "55"] in [line.split() for line in lines]
    assert not any("─" in line for line in lines)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("options", "status"),
    [
        (["--bitrate", "1M"], 0),
        (["--bitrate", "500k"], 9),
        (["--bitrate", "500k", "--treatment", "none"], 0),
        (["--bitrate", "500k", "--sync-period-s", "0.004"], 0),
        (["--loop", "host"], 0),
        (["--loop", "host", "--bitrate", "1M"], 9),
        (["--loop", "host", "--bitrate", "1M", "--sync-period-s", "0.001"], 9),
        (["--axes", "2,3", "--treatment", "none", "--bitrate", "1M", "--sync-period-s", "0.001"], 0),
        (["--bitrate", "2M"], 2),
        (["--bitrate", "fast"], 2),
        (["--axes", "2,2"], 2),
        (["--axes", "two"], 2),
        (["--axes", "4"], 2),
        (["--sync-period-s", "0"], 2),
        (["--sync-period-s", "nan"], 2),
        (["--loop", "both"], 2),
    ],
)
def test_exit_status(options, status):
    assert plan(*options).exit_code == status


def test_a_plan_that_cannot_run_says_what_would_do():
    last = plan("--loop", "host", "--bitrate", "1M").stdout.splitlines()[-1]
    assert last.startswith("Does not fit: 0.25 ms at 1 Mbit/s")
    assert "close the loop in the drive (--loop drive)" in last.split("Remedies: ")[1]


def bench_with_profile(folder: Path, control: str) -> Path:
    """A bench whose axis 2 has a drive without any gains, and without a torque limit where its control says so."""
    text = (VENDORS / "emulated_drive.toml").read_text(encoding="utf-8")
    gains = tuple(Control.model_fields)
    for name in gains:
        text, count = re.subn(rf"^{name} = \{{ index.*\n", "", text, flags=re.M)
        assert count == 1
    text = re.sub(r"^\[loop\.gains\]\n(?:(?!\[).*\n)*", "", text, flags=re.M)
    (folder / "drive.toml").write_text(text, encoding="utf-8")
    bench = REFERENCE.read_text(encoding="utf-8").replace('profile = "emulated_drive"', 'profile = "drive.toml"', 1)
    bench = re.sub("^control = .*$", control, bench, count=1, flags=re.M) if control else bench
    (folder / "bench.toml").write_text(bench, encoding="utf-8")
    return folder / "bench.toml"


def test_what_a_profile_lacks_is_found_without_a_bus(tmp_path: Path):
    bench = bench_with_profile(tmp_path, "")
    found = plan(bench=bench)
    assert found.exit_code == 9
    assert found.output.splitlines()[-1].startswith("Not possible: 1 need is not met; the bus fits: 2 ms")
    for name in Control.model_fields:
        assert found.output.count(name) == 1
    assert "axis 3: profile" not in found.output
    assert len(json.loads(plan("--json", bench=bench).stdout)["gaps"]) == 1
    assert plan("--axes", "3,5", bench=bench).exit_code == 0, "axis 2 takes no part"


def test_gains_as_found_leave_the_loop_unknown_and_the_host_without(tmp_path: Path):
    bench = bench_with_profile(tmp_path, 'control = "as found"')
    found = json.loads(plan("--json", bench=bench).stdout)
    assert (found["ok"], found["gaps"]) == (True, [])
    assert found["stability"][0]["reason"] == "its gains are as found in the drive"
    by_host = plan("--loop", "host", "--json", bench=bench)
    assert by_host.exit_code == 9
    assert 'axis 2: control = "as found" leaves the gains to the drive' in json.loads(by_host.stdout)["gaps"][0]


def test_the_first_word_is_the_verdict():
    unstable = plan("--loop", "host", "--sync-period-s", "0.001")
    assert unstable.exit_code == 9
    assert unstable.stdout.splitlines()[-1].startswith("Not stable; the bus fits: 1 ms")


def test_a_limit_that_the_master_holds_alone_is_said(tmp_path: Path):
    bench = tmp_path / "bench.toml"
    text = REFERENCE.read_text(encoding="utf-8").replace('profile = "emulated_drive"', 'profile = "elmo_gold"', 1)
    text = re.sub("^control = .*$", 'control = "as found"\nencoder_counts_per_rev = 131072', text, count=1, flags=re.M)
    bench.write_text(text, encoding="utf-8")
    found = plan("--treatment", "none", "--json", bench=bench)
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout)["remarks"] == [
        "axis 2: the master alone holds limits.speed_rps, limits.acceleration_rps_s",
        "axis 2: the drive keeps its own value for limits.quick_stop_rps_s",
    ]


def test_a_ramp_beyond_the_acceleration_limit_is_named_before_anything_moves(tmp_path: Path):
    """A bench file without models, as a new user has it: no inertia tells that the motor cannot do it."""
    bench = tmp_path / "bench.toml"
    text = re.sub(r"\[axis\.\d\.model\]\n(?:.+\n)+", "", REFERENCE.read_text(encoding="utf-8"))
    bench.write_text(text.replace("acceleration_rps_s = 4.0", "acceleration_rps_s = 4000"), encoding="utf-8")
    found = plan("--axes", "2", bench=bench)
    assert found.exit_code == 9
    assert "Not possible: 1 need is not met" in found.stdout
    assert "would be 4000 rev/s²; the limit is 100 rev/s²" in " ".join(found.stdout.split())


def test_a_bad_bench_file_is_told_by_line(tmp_path: Path):
    bad = tmp_path / "bench.toml"
    bad.write_text(REFERENCE.read_text().replace("sync_period_s = 0.002", "sync_period_s = -1"))
    result = plan(bench=bad)
    assert result.exit_code == 3
    assert "sync_period_s" in result.output
    assert plan(bench=tmp_path / "none.toml").exit_code == 3


def test_json_is_one_document_without_nan(tmp_path: Path):
    def refuse(constant):
        raise AssertionError(constant)

    result = plan("--loop", "host", "--sync-period-s", "0.00025", "--bitrate", "1M", "--json")
    assert result.exit_code == 9
    found = json.loads(result.stdout, parse_constant=refuse)
    assert found["ok"] is False
    assert found["bits"] == {"nominal": 712, "typical": pytest.approx(755, abs=10), "worst": 860}
    assert sum(frame["worst_bits"] for frame in found["frames"]) == 860
    assert found["rates"][0]["delay_periods"] is None
    assert {advice["title"] for advice in found["advice"]} >= {"one bus per axis", "close the loop in the drive (--loop drive)"}
    assert all(response["deadline_ns"] for response in found["responses"])
