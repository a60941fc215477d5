"""Files of `hil export`, each opened by another reader: the same numbers as in the recording, to the last count."""

import json
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree as Xml

import asammdf
import canmatrix.formats
import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from drive_profiles.standard.cia402 import State
from hil.cli.main import app
from hil.errors import ExportError
from hil.experiments.motions import line_motion
from hil.export.decoded import decoded
from hil.export.plotjuggler import send
from hil.export.series import Series
from hil.export.source import Known, mapping_of, series_in
from hil.export.tables import write_mcap, write_mf4, write_parquet
from hil.logs.opening import open_log
from hil.logs.trace import Trace
from hil.master.session import Session
from hil.recording import BusLog, Recording
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.bench.fault_rig import RATE, T_S, bench

NINE_DIGITS = 6e-9
"""Relative error of a number in a recording, which has nine digits."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Directory of a run: bus.log, and its recording."""
    path = tmp_path_factory.mktemp("run")
    setup, world = bench(), World(load_robot("reference"))
    log = BusLog(path / "bus.log", "can0")
    with Session(setup, InProcessChannel(world, medium_for(world, RATE)), log) as session:
        session.bring_up()
        result = session.run(line_motion(setup, T_S), "none", "drive")
    log.write()
    result.recording.save(path / "runs" / "line.csv")
    return path


@pytest.fixture(scope="module")
def recording(folder):
    return Recording.load(folder / "runs" / "line.csv")


def export(*arguments):
    done = CliRunner().invoke(app, ["export", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done


def place_of(numbers, recorded):
    """Where in a log a recording begins, by its numbers."""
    rows = np.flatnonzero(np.isclose(numbers, recorded[0], rtol=NINE_DIGITS, atol=1e-12))
    found = [
        start
        for start in rows[rows <= len(numbers) - len(recorded)]
        if np.allclose(numbers[start : start + len(recorded)], recorded, rtol=NINE_DIGITS, atol=1e-12)
    ]
    assert found, "the numbers of the recording are not in the log"
    return found[-1]


@pytest.mark.slow
def test_cantools_decodes_a_log_with_our_dbc_to_the_numbers_of_the_recording(folder, recording, tmp_path):
    dbc = tmp_path / "line.dbc"
    export(folder, "--to", dbc, "--bench", "reference")
    command = [str(Path(sys.executable).with_name("cantools")), "decode", "--single-line", str(dbc)]
    with (folder / "bus.log").open("rb") as log:
        text = subprocess.run(command, stdin=log, capture_output=True, text=True, check=True).stdout
    for axis in recording.axes:
        lines = [line for line in text.splitlines() if f"axis{axis}_tpdo1(" in line]
        named = {"position_rad": "position_actual_value_rad", "torque_nm": "torque_actual_value_nm"}
        read = {
            column: np.array([float(found[1]) for line in lines if (found := re.search(rf"{name}: (\S+) ", line))])
            for column, name in named.items()
        }
        begin = place_of(read["position_rad"], recording.axis(axis, "position_rad"))
        torque = read["torque_nm"][begin : begin + len(recording.time_s)]
        assert torque == pytest.approx(recording.axis(axis, "torque_nm"), rel=NINE_DIGITS, abs=1e-12)
    assert f"state: {State.OPERATION_ENABLED.value}" in text
    assert "command: enable operation" in text
    tip = np.array([float(each) for each in re.findall(r"tip_tpdo1\(.*y_m_s2: (\S+) ", text)])
    place_of(tip, recording.columns["tip_y_m_s2"])


def test_a_second_reader_takes_the_dbc_with_its_signs_units_and_tables_and_without_sdos(folder, tmp_path):
    dbc = tmp_path / "line.dbc"
    export(folder, "--to", dbc, "--bench", "reference")
    [matrix] = canmatrix.formats.loadp(str(dbc)).values()
    names = {frame.name for frame in matrix.frames}
    assert {"axis2_rpdo1", "axis2_tpdo1", "tip_tpdo1", "heartbeat_2"} <= names
    assert not [frame for frame in matrix.frames if 0x580 <= frame.arbitration_id.id < 0x680]
    torque = matrix.frame_by_name("axis2_tpdo1").signal_by_name("torque_actual_value_nm")
    assert torque.is_signed
    assert torque.unit == "Nm"
    assert "operation enabled" in matrix.frame_by_name("axis2_tpdo1").signal_by_name("state").values.values()


def test_a_table_in_every_format_holds_the_recordings_numbers(folder, recording, tmp_path):
    files = {suffix: tmp_path / f"line.{suffix}" for suffix in ("mf4", "mcap", "parquet")}
    export(folder, *(part for file in files.values() for part in ("--to", file)))
    with asammdf.MDF(files["mf4"]) as mdf:
        for name, values in recording.columns.items():
            if name != "time_s":
                channel = mdf.get(name)
                assert np.array_equal(channel.samples, values)
                assert np.array_equal(channel.timestamps, recording.time_s)
        assert mdf.get("axis2_torque_nm").unit == "N·m"
    table = pyarrow.parquet.read_table(files["parquet"])
    assert all(np.array_equal(table[name].to_numpy(), values) for name, values in recording.columns.items())
    with files["mcap"].open("rb") as file:
        rows = [(schema, message.log_time, json.loads(message.data)) for schema, _, message in make_reader(file).iter_messages()]
    assert [row["axis2_position_rad"] for _, _, row in rows] == recording.axis(2, "position_rad").tolist()
    assert [stamp for _, stamp, _ in rows] == [round(time * 1e9) for time in recording.time_s]
    schema = json.loads(rows[0][0].data)
    assert rows[0][0].encoding == "jsonschema"
    assert set(schema["properties"]) == set(rows[0][2])


@pytest.mark.ci
@pytest.mark.parametrize("suffix", ["mcap", "parquet"])
def test_a_recording_loads_nothing_that_it_does_not_need(folder, tmp_path, suffix):
    """What reads logs, results and other formats takes several times as long to load as the file to write."""
    heavy = "{'scipy', 'cffi', 'canopen', 'can', 'asammdf', 'pandas'}"
    arguments = ["export", str(folder), "--to", str(tmp_path / f"line.{suffix}")]
    program = (
        f"import sys; from hil.cli.main import app; app({arguments}, standalone_mode=False); print({heavy} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_a_log_becomes_the_same_numbers_each_pdo_with_its_own_stamps(folder, recording, tmp_path):
    file, packed = tmp_path / "bus.mf4", tmp_path / "bus.parquet"
    export(folder / "bus.log", "--to", file, "--to", packed, "--bench", "reference")
    with asammdf.MDF(file) as mdf:
        channel = mdf.get("axis3_position_actual_value_rad")
        begin = place_of(channel.samples, recording.axis(3, "position_rad"))
        stamps = channel.timestamps[begin : begin + len(recording.time_s)]
        assert np.diff(stamps) == pytest.approx(T_S, abs=0.2 * T_S)
    column = pyarrow.parquet.read_table(packed)["axis3_position_actual_value_rad"]
    place_of(column.drop_null().to_numpy(), recording.axis(3, "position_rad"))


@pytest.mark.ci
def test_without_a_bench_file_the_scale_is_that_of_the_overheard_objects(folder):
    known = mapping_of(folder, Known(bench(), {}))
    alone = mapping_of(folder, Known(None, {}))
    factors = {each.unit.name: each.unit.factor for named in known.pdos if named.prefix == "axis2" for each in named.numbers}
    own = {each.unit.name: each.unit.factor for named in alone.pdos if named.prefix == "node2" for each in named.numbers}
    assert own == factors


def test_a_scale_that_nobody_has_said_is_not_guessed(folder, tmp_path):
    lines = (folder / "bus.log").read_text(encoding="ascii").splitlines(keepends=True)
    cut = tmp_path / "cut.log"
    cut.write_text("".join(line for line in lines if "#408F60" not in line and "#438F60" not in line and "8F60" not in line))
    what = decoded(Trace(open_log(cut), {}), None)
    units = {each.unit.name for named in what.pdos if named.prefix == "node2" for each in named.numbers}
    assert "position_actual_value" in units
    assert any("608Fh:1" in note and "give --bench for the scale" in note for note in what.notes)


def test_frames_of_another_mapping_are_not_decoded_by_this_one(folder, tmp_path):
    """A log of two runs with two mappings: the numbers of neither are given for those of the other."""
    lines = (folder / "bus.log").read_text(encoding="ascii").splitlines(keepends=True)
    working = [row for row, line in enumerate(lines) if " 080#" in line]
    row = working[len(working) * 2 // 3]
    stamp = lines[row].split(" ", maxsplit=1)[0]
    other = [f"{stamp} can0 602#23001A0110006440 T\n", f"{stamp} can0 582#60001A0100000000 R\n"]
    other += [f"{stamp} can0 602#2F001A0003000000 T\n", f"{stamp} can0 582#60001A0000000000 R\n"]
    twice = tmp_path / "twice.log"
    twice.write_text("".join([*lines[:row], *other, *lines[row:]]))
    what = mapping_of(twice, Known(bench(), {}))
    assert "axis2_tpdo1" not in {named.name for named in what.pdos}
    assert any("TPDO 1 of node 2 had another mapping" in note for note in what.notes)


def test_numbers_that_were_not_there_are_null_and_no_numbers(tmp_path):
    gap = Series("run", np.array([0.0, 0.001, 0.002]), {"axis2_load_rad": np.array([1.0, np.nan, 3.0])})
    write_mcap(tmp_path / "gap.mcap", [gap])
    with (tmp_path / "gap.mcap").open("rb") as file:
        rows = [json.loads(message.data)["axis2_load_rad"] for _, _, message in make_reader(file).iter_messages()]
    assert rows == [1.0, None, 3.0]


@pytest.mark.parametrize(
    ("module", "write", "extra"),
    [("asammdf", write_mf4, "mf4"), ("mcap.writer", write_mcap, "mcap"), ("pyarrow", write_parquet, "parquet")],
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, module, write, extra):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(Exception, match=rf"pip install 'hil-bench\[{extra}\]'"):
        write(tmp_path / "a.file", [Series("run", np.zeros(2), {"missing": np.zeros(2)})])


def test_plotjuggler_gets_every_row_as_an_object_with_its_time_and_a_layout_names_its_curves(folder, recording, tmp_path):
    [series], _ = series_in(folder, Known(None, {}))
    got = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)

        def listen():
            while len(got) < len(series.time_s):
                got.append(json.loads(receiver.recv(65536)))

        thread = threading.Thread(target=listen)
        thread.start()
        assert send([series], "127.0.0.1", receiver.getsockname()[1], speed=5.0) == len(series.time_s)
        thread.join(20.0)
    assert [row["timestamp"] for row in got] == recording.time_s.tolist()
    assert [row["axis2_torque_nm"] for row in got] == recording.axis(2, "torque_nm").tolist()
    layout = tmp_path / "layout.xml"
    export(folder, "--plotjuggler-layout", layout)
    curves = {curve.get("name") for curve in Xml.parse(layout).iter("curve")}  # noqa: S314 - our own
    assert curves == {f"/{name}" for name in got[0] if name != "timestamp"}


def test_what_cannot_be_exported_is_said(folder, tmp_path):
    with pytest.raises(ExportError, match=r"give bus\.log of its run"):
        mapping_of(folder / "runs" / "line.csv", Known(None, {}))
    with pytest.raises(ExportError, match="no recording 'other'; there are line"):
        series_in(folder, Known(None, {}, run="other"))
    assert CliRunner().invoke(app, ["export", str(folder), "--to", str(tmp_path / "a.bag")]).exit_code == 2
    assert CliRunner().invoke(app, ["export", str(folder)]).exit_code == 2
    assert CliRunner().invoke(app, ["export", str(folder), "--plotjuggler", "nowhere"]).exit_code == 2
    bad = tmp_path / "bad.csv"
    bad.write_text("a,b\n1,2\n")
    assert CliRunner().invoke(app, ["export", str(bad), "--to", str(tmp_path / "a.mcap")]).exit_code == 3
    assert not list(tmp_path.glob("a*"))
