"""hil identify ate --recording as a command, on the recordings of a real robot that come with the project."""

import json
from pathlib import Path

import asammdf
import can
import numpy as np
import pytest
from typer.testing import CliRunner

import drive_profiles
from drive_profiles.cli.application import Tool, mount
from hil.bench.model import load_identified
from hil.cli import identify_ate as cli_identify_ate

app = Tool("identify", "")
mount(app, cli_identify_ate)

EXAMPLES = Path(__file__).parents[3] / "examples" / "lara8"
JOINT_1 = str(EXAMPLES / "joint_1_and_6.csv.gz")


def invoke(*words: str):
    return CliRunner().invoke(app, ["ate", *words])


@pytest.mark.ci
def test_it_writes_model_file_curves_and_report(tmp_path: Path) -> None:
    model = tmp_path / "lara.toml"
    found = invoke(
        "--recording", JOINT_1, "--axis", "1", "--robot", "LARA 8", "--model", str(model), "--out", str(tmp_path / "out")
    )
    assert found.exit_code == 0, found.stderr
    assert "motor: encoder_motorinc_1 (2^24/rev), by its name" in found.stdout
    assert "Reduction ratio: 121\n" in found.stdout
    assert next(line.split()[1:3] for line in found.stdout.splitlines() if line.startswith("joint_1")) == ["forwards", "6.9"]
    assert "Blind scan: highest at order 1.99" in found.stdout
    identified = load_identified(model)
    assert identified.robot == "LARA 8"
    assert identified.axis[1].ate is not None
    assert identified.axis[1].ate.values.a2_arcsec == pytest.approx(7.2, abs=0.6)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for title in ("Order spectrum of axis 1", "The longest stretch of axis 1", "part by part", "Stretches"):
        assert title in page
    assert json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))["kind"] == "identify-ate-recording"


@pytest.mark.slow
def test_a_second_axis_joins_the_model_file_of_the_same_robot_and_no_other(tmp_path: Path) -> None:
    model = str(tmp_path / "lara.toml")
    for axis in ("1", "6"):
        words = ("--recording", JOINT_1, "--axis", axis, "--model", model, "--out", str(tmp_path / axis))
        assert invoke(*words, "--robot", "LARA 8").exit_code == 0
    assert set(load_identified(Path(model)).axis) == {1, 6}
    other = invoke("--recording", JOINT_1, "--axis", "1", "--model", model, "--out", str(tmp_path / "b"), "--robot", "another")
    assert other.exit_code == 3
    assert "is of robot 'LARA 8'" in other.stderr


@pytest.mark.ci
def test_a_layout_file_says_columns_units_and_ratio(tmp_path: Path) -> None:
    layout = tmp_path / "lara.toml"
    layout.write_text(
        'robot = "LARA 8"\n[column]\ntime = "Timestamp"\nmotor = "encoder_motorinc_{axis}"\nload = "encoder_loadinc_{axis}"\n'
        '[unit]\ntime = "s"\nmotor = "2^24/rev"\nload = "2^24/rev"\n[reduction_ratio]\n1 = 121\n6 = 101\n',
        encoding="utf-8",
    )
    found = invoke("--recording", JOINT_1, "--axis", "6", "--layout", str(layout), "--json", "--out", str(tmp_path / "out"))
    assert found.exit_code == 0, found.stderr
    result = json.loads(found.stdout)
    assert (result["robot"], result["reduction_ratio"]) == ("LARA 8", 101.0)
    assert not any("by its name" in words for words in result["files"][0]["columns"])


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--recording", JOINT_1, "--axis", "1", "--ratio", "120"), 3, "the encoders show 120.91; check whether it is 121"),
        (("--recording", JOINT_1, "--axis", "4"), 3, "no column is recognised as motor"),
        (("--recording", "nothing.csv", "--axis", "1"), 3, "there is no such file"),
        (("--recording", JOINT_1, "--axis", "1", "--column", "speed=x"), 2, "is not a column"),
        (("--recording", JOINT_1, "--axis", "1", "--column", "motor=encoder_motorinc_1,furlong"), 3, "is not a unit of motor"),
        (("--recording", JOINT_1, "--axis", "6", "--orders", "0.2,1,2"), 9, "need 10"),
        (("--recording", JOINT_1, "--axis", "1", "--encoder"), 2, "the columns name the encoders"),
        (("--axis", "1"), 2, "no bench file is given"),
        (("--bench", "reference", "--axis", "1", "--ratio", "100"), 2, "it needs --recording"),
    ],
)
def test_what_cannot_be_used_is_said_with_its_exit_status(tmp_path: Path, words, status, said) -> None:
    found = invoke(*words, "--out", str(tmp_path / "out"))
    assert found.exit_code == status, found.output
    assert said in " ".join(found.stderr.replace("│", " ").split())
    assert not (tmp_path / "out" / "model.toml").exists()


EDS = Path(drive_profiles.__file__).parent / "vendors" / "emulated_drive.eds"
NODE, COUNTS, LOAD_COUNTS, RATIO = 5, 2**17, 2**27, 100.0


@pytest.fixture(scope="module")
def decoding(tmp_path_factory) -> dict[str, tuple[str, ...]]:
    """Words that decode frames: by the device's own mapping, its torque in the place of the second encoder, and by a DBC file."""
    folder = tmp_path_factory.mktemp("decoding")
    text = EDS.read_text(encoding="utf-8")
    for entry, mapped in (("1A00sub0", "2"), ("1A00sub1", "0x60640020"), ("1A00sub2", "0x60FF0020")):
        start = text.index("DefaultValue", text.index(f"[{entry}]"))
        text = f"{text[:start]}DefaultValue={mapped}{text[text.index(chr(10), start) :]}"
    (folder / "drive.eds").write_text(text, encoding="utf-8")
    (folder / "robot.dbc").write_text(
        f'VERSION ""\nBU_: A\nBO_ {0x180 + NODE} Drive: 8 A\n SG_ Position : 0|32@1- (1,0) [0|0] "" A\n'
        ' SG_ Joint : 32|32@1- (1,0) [0|0] "" A\n',
        encoding="utf-8",
    )
    named = {"eds": ("6064h", "60FFh"), "dbc": ("Drive.Position", "Drive.Joint")}
    words = {
        kind: (
            "--column",
            f"motor={motor},{COUNTS}/rev",
            "--column",
            f"load={load},{LOAD_COUNTS}/rev",
            "--column",
            "time=time_s,s",
        )
        for kind, (motor, load) in named.items()
    }
    return {
        "": (),
        "eds": ("--description", str(folder / "drive.eds"), "--node", str(NODE), *words["eds"]),
        "dbc": ("--description", str(folder / "robot.dbc"), *words["dbc"]),
    }


def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, motor and joint angle in increments, with A_2 = 8 arcsec at 40°."""
    random = np.random.default_rng(1)
    motor = np.linspace(0.0, 30.0, 1500)
    error = 8.0 * np.cos(2.0 * motor + np.radians(40.0)) + random.normal(0.0, 2.0, len(motor))
    joint = motor / RATIO + error / 3600.0 * np.pi / 180.0
    turn = 2.0 * np.pi
    return 1.7e9 + 0.004 * np.arange(len(motor)), np.round(motor / turn * COUNTS), np.round(joint / turn * LOAD_COUNTS)


def stored(path: Path) -> Path:
    stamps, motor, joint = moved()
    if path.suffix == ".mf4":
        with asammdf.MDF() as mdf:
            for name, counts, of_turn in (("motor_rad", motor, COUNTS), ("load_rad", joint, LOAD_COUNTS)):
                mdf.append([asammdf.Signal(counts / of_turn * 2.0 * np.pi, stamps - stamps[0], name=name)])
            mdf.save(path)
        return path
    with {".log": can.CanutilsLogWriter, ".blf": can.BLFWriter, ".asc": can.ASCWriter}[path.suffix](str(path)) as file:
        for stamp, *counts in zip(stamps, motor, joint, strict=True):
            data = b"".join(int(each).to_bytes(4, "little", signed=True) for each in counts)
            file.on_message_received(
                can.Message(timestamp=float(stamp), arbitration_id=0x180 + NODE, data=data, is_extended_id=False, channel=0)
            )
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"), [("a.mf4", ""), ("a.log", "eds"), ("a.blf", "eds"), ("a.asc", "dbc"), ("a.log", "dbc"), ("a.blf", "dbc")]
)
def test_every_format_gives_the_same_error_by_the_command(tmp_path: Path, decoding, name, kind) -> None:
    words = ("--recording", str(stored(tmp_path / name)), "--axis", "1", "--orders", "2", *decoding[kind], "--json")
    found = invoke(*words, "--out", str(tmp_path / "out"))
    assert found.exit_code == 0, found.stderr
    part = json.loads(found.stdout)["ate"]
    assert part["values"]["a2_arcsec"] == pytest.approx(8.0, abs=0.3)
    assert part["values"]["phi2_deg"] == pytest.approx(40.0, abs=2.0)
