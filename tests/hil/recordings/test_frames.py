"""Recordings as frames of a bus, written by python-can and decoded by a device's own description."""

from pathlib import Path

import can
import numpy as np
import pytest

import drive_profiles
from hil.recordings import MissingPackageError, RecordingFileError, Said, read_recording

EDS = Path(drive_profiles.__file__).parent / "vendors" / "emulated_drive.eds"
NODE, COUNTS = 5, 131072
STAMPS = 1.7e9 + np.arange(300) * 0.004
MOTOR = np.linspace(-3.0, 40.0, 300)


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    """The drive as it was set up: position and torque in its first TPDO."""
    text = EDS.read_text(encoding="utf-8")
    for entry, mapped in (("1A00sub0", "2"), ("1A00sub1", "0x60640020"), ("1A00sub2", "0x60770010")):
        start = text.index("DefaultValue", text.index(f"[{entry}]"))
        text = f"{text[:start]}DefaultValue={mapped}{text[text.index(chr(10), start) :]}"
    path = tmp_path_factory.mktemp("eds") / "drive.eds"
    path.write_text(text, encoding="utf-8")
    return path


def logged(path, node=NODE):
    writer = can.CanutilsLogWriter if path.suffix == ".log" else can.BLFWriter
    with writer(str(path)) as file:
        for stamp, angle in zip(STAMPS, MOTOR, strict=True):
            counts = round(angle / (2.0 * np.pi) * COUNTS)
            data = counts.to_bytes(4, "little", signed=True) + round(-10.0 * angle).to_bytes(2, "little", signed=True)
            for identifier, content in ((0x80, b""), (0x180 + node, data)):
                file.on_message_received(
                    can.Message(timestamp=stamp, arbitration_id=identifier, data=content, is_extended_id=False, channel=0)
                )
    return path


def said(description, node=NODE):
    columns = {"time": "time_s", "motor": "6064h", "torque": "6077h"}
    return Said(columns, {"motor": f"{COUNTS}/rev", "torque": "0.0071 Nm"}, description=description, node_id=node)


@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_frames_are_decoded_by_the_drives_own_mapping(tmp_path, description, suffix):
    recorded = read_recording(logged(tmp_path / f"bus{suffix}"), said(description), 2)
    assert recorded.motor_rad == pytest.approx(MOTOR, abs=2.0 * np.pi / COUNTS)
    assert recorded.value["torque"] == pytest.approx(-0.071 * MOTOR, abs=0.0036)
    assert recorded.time_s == pytest.approx(STAMPS - STAMPS[0], abs=1e-5)


def test_frames_without_a_description_say_what_is_needed(tmp_path):
    with pytest.raises(RecordingFileError, match=r"--description drive\.eds --node 2"):
        read_recording(logged(tmp_path / "bus.log"), Said(), 2)


def test_another_node_is_named_with_its_identifier(tmp_path, description):
    with pytest.raises(RecordingFileError, match="0 frames with the identifier 0x187 hold '6064h'"):
        read_recording(logged(tmp_path / "bus.log"), said(description, node=7), 2)


def test_what_is_no_log_is_refused(tmp_path, description):
    path = tmp_path / "bus.blf"
    path.write_bytes(b"no log at all" * 40)
    with pytest.raises(RecordingFileError, match="not a log of frames"):
        read_recording(path, said(description), 2)


def test_a_log_that_no_writer_of_ours_has_made_is_read_alike(tmp_path, description):
    lines = []
    for stamp, angle in zip(STAMPS, MOTOR, strict=True):
        counts, torque = round(angle / (2.0 * np.pi) * COUNTS), round(-10.0 * angle)
        data = (counts % 2**32).to_bytes(4, "little") + (torque % 2**16).to_bytes(2, "little")
        lines.append(f"({stamp:.6f}) vcan0 {0x180 + NODE:03X}#{data.hex().upper()}")
    path = tmp_path / "by_hand.log"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    assert read_recording(path, said(description), 2).motor_rad == pytest.approx(MOTOR, abs=2.0 * np.pi / COUNTS)


@pytest.mark.parametrize("left", [0.5, 0.97])
def test_a_blf_file_that_was_cut_off_is_refused_with_its_size(tmp_path, description, left):
    path = logged(tmp_path / "bus.blf")
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[: int(left * size)])
    with pytest.raises(RecordingFileError, match=f"cut off: the file has {int(left * size)} bytes, but its header says {size}"):
        read_recording(path, said(description), 2)


def test_a_blf_file_with_wrong_bytes_is_refused(tmp_path, description):
    path = logged(tmp_path / "bus.blf")
    data = bytearray(path.read_bytes())
    data[400:440] = bytes(range(40))
    path.write_bytes(data)
    with pytest.raises(RecordingFileError, match="not a log of frames"):
        read_recording(path, said(description), 2)


def test_a_dbc_file_without_its_package_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cantools", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'hil-bench\[dbc\]'"):
        read_recording(logged(tmp_path / "bus.log"), Said(description=tmp_path / "robot.dbc"), 2)


def test_a_dbc_file_decodes_the_same_frames(tmp_path):
    dbc = tmp_path / "robot.dbc"
    dbc.write_text(
        f'VERSION ""\nBU_: A\nBO_ {0x180 + NODE} Drive: 6 A\n SG_ Position : 0|32@1- (1,0) [0|0] "" A\n'
        ' SG_ Torque : 32|16@1- (0.0071,0) [0|0] "Nm" A\n',
        encoding="utf-8",
    )
    columns = {"time": "time_s", "motor": "Drive.Position", "torque": "Drive.Torque"}
    spoken = Said(columns, {"motor": f"{COUNTS}/rev", "torque": "Nm"}, description=dbc)
    recorded = read_recording(logged(tmp_path / "bus.log"), spoken, 2)
    assert recorded.motor_rad == pytest.approx(MOTOR, abs=2.0 * np.pi / COUNTS)
    assert recorded.value["torque"] == pytest.approx(-0.071 * MOTOR, abs=0.0036)
