"""What is not a file is refused at once, wherever a user may name one: nothing waits for the other end of a pipe."""

import os
import socket
import subprocess
import sys

import pytest

from drive_profiles import eds
from drive_profiles.errors import FileError
from drive_profiles.files.reading import read_file
from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.upload import journal

BOUND = 1 << 20


def test_the_bytes_of_a_file_come_whole(tmp_path):
    (tmp_path / "a").write_bytes(b"\0\r\n" * 1000)
    (tmp_path / "link").symlink_to("a")
    assert read_file(tmp_path / "link", "a file", max_bytes=BOUND) == b"\0\r\n" * 1000


@pytest.mark.parametrize(
    ("name", "kind"), [("fifo", "a FIFO"), ("folder", "a folder"), ("/dev/zero", "a device"), ("socket", "a socket")]
)
def test_what_is_no_file_is_refused_unopened(name, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    os.mkdir("folder")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        for path in (name, "link"):
            if path == "link":
                os.symlink(name, path)
            with pytest.raises(FileError, match=f"{path}: cannot be read: it is {kind}, not a file; expected a key"):
                read_file(tmp_path / path, "a key", max_bytes=BOUND)


def test_missing_looping_forbidden_and_nameless_files_say_why(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    for path, reason in (
        (tmp_path / "none", "No such file"),
        (tmp_path / "loop", "Too many levels"),
        (tmp_path / "a\0b", "null"),
    ):
        with pytest.raises(FileError, match=reason):
            read_file(path, "a file", max_bytes=BOUND)


def test_a_file_larger_than_its_bound_is_refused(tmp_path):
    (tmp_path / "large").write_bytes(b" " * (BOUND + 1))
    with pytest.raises(FileError, match="larger than 1 MiB"):
        read_file(tmp_path / "large", "a file", max_bytes=BOUND)


def test_a_fifo_that_takes_the_place_of_a_file_meanwhile_is_refused_as_well(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"x")
    opened = os.open

    def replaced(name, *more):
        os.unlink(name)
        os.mkfifo(name)
        return opened(name, *more)

    monkeypatch.setattr(os, "open", replaced)
    with pytest.raises(FileError, match="it is a FIFO"):
        read_file(path, "a file", max_bytes=BOUND)


@pytest.mark.parametrize("load", [eds.load, ParameterSet.load, journal.read])
def test_every_reader_of_a_user_s_file_takes_this_door(load, tmp_path):
    os.mkfifo(tmp_path / "f")
    with pytest.raises(FileError, match="it is a FIFO, not a file"):
        load(tmp_path / "f")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("eds", "check", "PIPE.eds"),
        ("upload", "PIPE.toml", "--node", "5", "--bus", "local:/nowhere"),
        ("convert", "PIPE.cdcf", "--profile", "emulated_drive", "--out", "x.toml"),
        ("restore", "--snapshot", "PIPE.jsonl", "--bus", "local:/nowhere"),
        ("show", "./PIPE.toml"),
    ],
)
def test_no_command_hangs_at_a_fifo(arguments, tmp_path):
    named = next(each for each in arguments if "PIPE" in each)
    os.mkfifo(tmp_path / named)
    command = [sys.executable, "-m", "drive_profiles", *arguments]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    assert ended.returncode == 3, ended.stderr
    assert "it is a FIFO, not a file" in ended.stdout + ended.stderr


def test_a_fifo_is_not_written_over_by_eds_convert(tmp_path):
    (tmp_path / "a.eds").write_bytes(b"[1000]\nParameterName=a\nDataType=7\nAccessType=ro\n")
    os.mkfifo(tmp_path / "out.eds")
    command = [sys.executable, "-m", "drive_profiles", "eds", "convert", "a.eds", "--out", "out.eds", "--force"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    assert (ended.returncode, "is not a regular file and cannot be replaced" in ended.stderr) == (3, True)
