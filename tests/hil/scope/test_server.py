"""The page is for this machine alone, takes questions only, and never sends on the bus."""

import asyncio
import contextlib
import http.client
import importlib.util
import json
import os
import socket
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect
from typer.testing import CliRunner

from drive_profiles.address import parse_address
from hil.can.listening import open_listener
from hil.cli.live import with_port
from hil.cli.main import app
from hil.errors import NotPossibleError
from hil.scope.process import ScopeProcess
from tests.hil.scope.recorded import RecordedScope
from tests.hil.scope.traffic import Traffic, played
from tests.hil.scope.viewer import leave, look

NODES = (41, 42)


def status(scope, path="/", method="GET", **headers):
    """Status of a real request with these headers."""
    port = urlsplit(scope.url).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    with contextlib.closing(connection):
        answer = connection.getresponse()
        answer.read()
        return answer.status


@pytest.mark.slow
@pytest.mark.parametrize("path", ["/", "/scope.js", "/bokeh.min.js", "/stream"])
def test_a_request_for_another_host_or_from_another_page_is_refused(scope, path):
    port = urlsplit(scope.url).port
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", ""):
        assert status(scope, path, Host=host) == 403, host
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{port}", f"http://127.0.0.1:{port + 1}"):
        assert status(scope, path, Origin=origin) == 403, origin
    if path != "/stream":
        assert status(scope, path) == 200
        assert status(scope, path, Host=f"localhost:{port}", Origin=f"http://localhost:{port}") == 200


@pytest.mark.slow
def test_a_stream_for_another_page_is_refused(scope):
    async def join(origin):
        url = scope.url.replace("http", "ws") + "stream"
        await leave(await websocket_connect(HTTPRequest(url, headers={"Origin": origin})))

    with pytest.raises(HTTPClientError) as refused:
        asyncio.run(join("http://evil.example"))
    assert refused.value.code == 403
    asyncio.run(join(scope.url.rstrip("/")))


def test_nothing_can_be_sent_to_it(scope):
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert status(scope, method=method) == 405, method


def test_it_is_on_loopback_only(scope):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent
        except OSError:
            pytest.skip("this machine has no other address")
        own = probe.getsockname()[0]
    if own.startswith("127."):
        pytest.skip("this machine has no other address")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((own, urlsplit(scope.url).port), timeout=5).close()


def test_one_who_comes_late_sees_what_was_and_a_trigger_and_spectra_are_answered(scope, channel, bus):
    listener = open_listener(parse_address(bus))
    traffic = Traffic(NODES).set_up().run(400).emergency(41, 0x3310).run(400).heard()
    played(channel, traffic, 60.0)
    sent, end = 0, time.monotonic() + 10.0
    while sent < len(traffic) and time.monotonic() < end:  # the last frames are on their way
        sent += len(listener.take())
        time.sleep(0.01)

    async def talk(viewer, connection):
        await viewer.until(lambda one: sum(rows[1].size for rows in one.rows) >= 795)
        values = np.concatenate([rows[2][viewer.names.index("node 41 status word")] for rows in viewer.rows[-1:]])
        assert values[-1] == 0x1637
        assert viewer.kinds().count("events") >= 1
        time_s = np.arange(1000) * 0.001
        wave = np.sin(2 * np.pi * 20 * time_s)
        await connection.write_message(np.concatenate([[0.0, 1000.0], time_s, wave]).tobytes(), binary=True)
        await viewer.until(lambda one: "spectrum" in one.kinds())
        answer = next(each for each in viewer.said if each["kind"] == "spectrum")
        assert answer["x"][int(np.argmax(answer["y"]))] == pytest.approx(20.0)
        for nonsense in ("{", "[]", '{"trigger": 3}', '{"send": "123#00"}'):
            await connection.write_message(nonsense)
        for nonsense in (b"", b"\0" * 7, np.array([0.0, 1e300]).tobytes(), np.array([0.0, np.nan]).tobytes()):
            await connection.write_message(nonsense, binary=True)
        await viewer.until(lambda one: one.kinds().count("refused") == 8)

    look(scope, talk)
    assert len(listener.take()) == 0  # it has sent nothing, whatever was asked
    assert sent > 2400
    listener.close()


def test_a_trigger_tells_when_it_fires(scope, channel):
    traffic = Traffic(NODES).set_up().run(50)
    played(channel, traffic.heard(), 60.0)

    async def talk(viewer, connection):
        await viewer.until(lambda one: one.rows)
        await connection.write_message(json.dumps({"trigger": {"kind": "edge", "signal": "node 41 position", "level": 0.0605}}))
        await connection.write_message("{")
        await viewer.until(lambda one: "refused" in one.kinds())  # what came before it has been heard
        played(channel, traffic.run(50).heard(), 60.0)
        await viewer.until(lambda one: "trigger" in one.kinds())
        time_s = next(each for each in viewer.said if each["kind"] == "trigger")["time_s"]
        await viewer.until(lambda one: one.rows[-1][1][-1] > time_s)
        column = viewer.names.index("node 41 position")
        crossing = [values[column, times == time_s] for _, times, values in viewer.rows]
        assert np.concatenate(crossing).tolist() == [pytest.approx(0.061)]

    look(scope, talk)


@pytest.mark.slow
def test_a_recorded_run_is_shown_whole_in_the_same_page(tmp_path):
    (tmp_path / "runs").mkdir()
    time_s = np.arange(30_000) * 0.001
    table = np.column_stack([time_s, time_s, 0.5 * time_s, np.ones_like(time_s), np.zeros_like(time_s)])
    header = "time_s,axis2_reference_rad,axis2_position_rad,axis2_torque_nm,tip_z_m_s2"
    for name in ("first", "second"):
        np.savetxt(tmp_path / "runs" / f"{name}.csv", table, delimiter=",", header=header, comments="")

    async def talk(viewer, _):
        return await viewer.until(lambda one: one.rows)

    with RecordedScope(tmp_path) as process:
        viewer = look(process, talk, "?run=second")
    [layout] = [each for each in viewer.said if each["kind"] == "layout"]
    assert (layout["title"], layout["runs"], layout["is_live"]) == ("second", ["first", "second"], False)
    [(first, times, values)] = viewer.rows
    assert (first, len(times)) == (0, 30_000)
    assert values[viewer.names.index("axis 2 speed")] == pytest.approx(np.full(30_000, 0.5 / (2 * np.pi)))


@pytest.mark.ci
def test_a_port_in_use_is_said_in_one_line_with_the_remedy(bus):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = rf"nothing has moved: port {port} of 127\.0\.0\.1: .* in use; port 0 takes a free one$"
        with pytest.raises(NotPossibleError, match=said):
            ScopeProcess(bus, "reference", port).__enter__()


@pytest.mark.ci
def test_a_folder_without_recordings_and_a_bus_that_is_not_there_are_said(tmp_path):
    with pytest.raises(NotPossibleError, match=r"no bus at local:/nosuch\.sock"):
        ScopeProcess("local:/nosuch.sock", "reference", 0).__enter__()
    for arguments, code in (([str(tmp_path)], 3), ([], 2), (["--bus", "nosuch:1"], 2), ([str(tmp_path), "--ask", "2"], 2)):
        environment = {name: "" for name in os.environ if name == "HIL_BUS"}
        assert CliRunner(env=environment).invoke(app, ["scope", *arguments]).exit_code == code, arguments


def test_without_the_library_the_extra_that_brings_it_is_named(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "bokeh" else find(name, *more))
    done = CliRunner().invoke(app, ["scope", "--bus", "local:/nosuch.sock"])
    assert done.exit_code == 3
    assert "pip install 'hil-bench[live]'" in done.output


@pytest.mark.ci
def test_asking_nodes_tells_the_mapping_to_one_who_came_late(bus):
    class Asking(ScopeProcess):
        def __init__(self):
            super().__init__(bus, "reference", 0)
            self._command += ["--ask", "2"]

    async def talk(viewer, _):
        return await viewer.until(lambda one: one.kinds())

    listener = open_listener(parse_address(bus))
    with Asking() as process:
        look(process, talk)
    heard = listener.take()
    listener.close()
    assert {0x602, 0x582} <= set(heard["can_id"].tolist()) <= {0x602, 0x582}


def test_a_port_may_be_left_out():
    assert with_port(["--live", "--axis", "2"]) == ["--live=8765", "--axis", "2"]
    assert with_port(["--axis", "2", "--live"]) == ["--axis", "2", "--live=8765"]
    assert with_port(["--live", "9000"]) == ["--live", "9000"]
