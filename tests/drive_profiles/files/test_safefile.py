"""Files are there whole or not at all, whatever happens while they are written."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drive_profiles.errors import DriveProfileError, FileError, RefusedError
from drive_profiles.files import safefile
from drive_profiles.files.safefile import check_writable, write_atomically

OLD, NEW = b"old contents", b"new contents, and more of them"


@pytest.fixture
def path(tmp_path):
    """A file that is there already, alone in its folder."""
    path = tmp_path / "sets" / "axis 2.toml"
    path.parent.mkdir()
    path.write_bytes(OLD)
    return path


def test_a_new_file_is_written_with_its_folder(tmp_path):
    path = tmp_path / "a" / "b" / "set.toml"
    write_atomically(path, NEW)
    assert path.read_bytes() == NEW
    assert list(path.parent.iterdir()) == [path]


def test_what_is_there_is_replaced_only_when_that_is_asked_for(path):
    with pytest.raises(RefusedError, match=r"axis 2\.toml already exists; choose another name, or give --force"):
        write_atomically(path, NEW)
    assert path.read_bytes() == OLD
    write_atomically(path, NEW, force=True)
    assert path.read_bytes() == NEW
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("call", ["fsync", "fdopen"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()])
def test_a_failure_in_the_middle_leaves_the_old_file_and_nothing_else(path, monkeypatch, call, error):
    def fail(descriptor, *_):
        if call == "fdopen":
            os.close(descriptor)
        raise error

    monkeypatch.setattr(safefile.os, call, fail)
    with pytest.raises(FileError if isinstance(error, OSError) else type(error)) as caught:
        write_atomically(path, NEW, force=True)
    if isinstance(error, OSError):
        assert "axis 2.toml: cannot be written (No space left on device)" in str(caught.value)
    assert path.read_bytes() == OLD
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_at_the_last_moment_leaves_the_old_file_and_nothing_else(path, monkeypatch):
    def fail(self, target):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(FileError, match="Input/output error"):
        write_atomically(path, NEW, force=True)
    assert path.read_bytes() == OLD
    assert list(path.parent.iterdir()) == [path]


def test_the_bytes_are_on_disk_before_the_file_has_its_name(path, monkeypatch):
    events = []
    real_fsync, real_replace = os.fsync, Path.replace
    monkeypatch.setattr(safefile.os, "fsync", lambda file: (events.append("fsync"), real_fsync(file))[1])
    monkeypatch.setattr(Path, "replace", lambda self, target: (events.append("replace"), real_replace(self, target))[1])
    write_atomically(path, NEW, force=True)
    assert events == ["fsync", "replace", "fsync"]  # contents, name, folder


KILLED = """
import os, sys
from pathlib import Path
from drive_profiles.files.safefile import write_atomically
path, moment = Path(sys.argv[1]), sys.argv[2]
def stop(*_):
    print("there", flush=True)
    sys.stdin.read()
if moment == "before the bytes are on disk":
    os.fsync = stop
else:
    Path.replace = stop
write_atomically(path, b"x" * 100_000, force=True)
"""


@pytest.mark.parametrize("moment", ["before the bytes are on disk", "before it has its name"])
def test_a_kill_in_the_middle_leaves_the_old_file(path, moment):
    command = [sys.executable, "-c", KILLED, str(path), moment]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"there\n"
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert path.read_bytes() == OLD
    write_atomically(path, NEW, force=True)  # what the killed one has left is in nobody's way
    assert path.read_bytes() == NEW


WRITING = """
import itertools, sys
from pathlib import Path
from drive_profiles.files.safefile import write_atomically
print("there", flush=True)
for number in itertools.count():
    write_atomically(Path(sys.argv[1]), bytes([number % 256]) * 50_000, force=True)
"""


def test_a_kill_at_any_moment_leaves_one_whole_file(path):
    for after_s in (0.0, 0.011, 0.023, 0.037):
        with subprocess.Popen([sys.executable, "-c", WRITING, str(path)], stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            time.sleep(after_s)
            process.kill()
            process.wait()
        data = path.read_bytes()
        assert data == OLD or (len(data) == 50_000 and len(set(data)) == 1)


@pytest.mark.parametrize("name", ["a" * 300, "nul\0.toml", "file/below.toml", "folder"])
@pytest.mark.parametrize("force", [False, True])
def test_a_place_that_cannot_be_written_is_an_error_with_the_file(tmp_path, name, force):
    (tmp_path / "file").write_bytes(OLD)
    (tmp_path / "folder").mkdir()
    path = tmp_path / name
    with pytest.raises(RefusedError if name == "folder" and not force else FileError) as caught:
        write_atomically(path, NEW, force=force)
    assert str(path) in str(caught.value)
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file", tmp_path / "folder"]


def test_of_a_link_the_file_that_it_names_is_replaced(path):
    link = path.parent / "link.toml"
    link.symlink_to(path)
    write_atomically(link, NEW, force=True)
    assert link.is_symlink()
    assert path.read_bytes() == NEW


@pytest.mark.parametrize("force", [False, True])
def test_what_is_no_file_is_never_replaced(tmp_path, force):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DriveProfileError):
        write_atomically(tmp_path / "pipe", NEW, force=force)
    assert (tmp_path / "pipe").is_fifo()


def test_a_place_is_checked_before_there_is_anything_to_write(tmp_path):
    check_writable(tmp_path / "new.toml")
    assert list(tmp_path.iterdir()) == [], "the check leaves nothing"
    with pytest.raises(FileError, match=r"there is no folder .*missing"):
        check_writable(tmp_path / "missing" / "new.toml")
    with pytest.raises(FileError, match="is not a regular file and cannot be replaced"):
        check_writable(tmp_path)


def test_a_full_disk_is_found_before_there_is_anything_to_write(tmp_path, monkeypatch):
    def fail(**_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(safefile.tempfile, "TemporaryFile", fail)
    with pytest.raises(FileError, match=r"new\.toml: cannot be written \(No space left on device\)"):
        check_writable(tmp_path / "new.toml")
