"""python-can is loaded without what only MF4 files need, and reads those all the same."""

import subprocess
import sys

import can
import pytest

pytest.importorskip("asammdf")

PROGRAM = """
import sys
from drive_profiles.python_can import postpone_mf4, with_mf4

postpone_mf4()
postpone_mf4()
import canopen
import can

assert "asammdf" not in sys.modules
assert sum(type(finder).__name__ == "_NotYet" for finder in sys.meta_path) == 1
with_mf4()
with can.LogReader(sys.argv[1]) as reader:
    print([(message.arbitration_id, message.data.hex()) for message in reader])
"""


def log_of(path, frames):
    with can.MF4Writer(str(path)) as writer:
        for i, (can_id, data) in enumerate(frames):
            writer.on_message_received(
                can.Message(arbitration_id=can_id, data=data, timestamp=1000.0 + 0.001 * i, is_extended_id=False, channel=1)
            )


def python(*arguments):
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.ci
def test_a_program_loads_what_mf4_files_need_when_it_opens_one(tmp_path):
    log_of(tmp_path / "log.mf4", [(0x181, b"\1\2\3"), (0x80, b"")])
    done = python("-c", PROGRAM, str(tmp_path / "log.mf4"))
    assert done.stderr == ""
    assert done.stdout.strip() == "[(385, '010203'), (128, '')]"


@pytest.mark.ci
def test_asammdf_itself_is_imported_as_ever():
    done = python("-c", "from drive_profiles.python_can import postpone_mf4; postpone_mf4(); import can, asammdf; asammdf.MDF")
    assert (done.stderr, done.returncode) == ("", 0)


@pytest.mark.slow
def test_the_trace_doctor_reads_an_mf4_log(tmp_path):
    log_of(tmp_path / "log.mf4", [(0x80, b""), (0x181, bytes(8))] * 500)
    done = python("-m", "hil", "explain", str(tmp_path / "log.mf4"))
    assert "1000 frames" in done.stdout.replace(",", ""), done.stdout + done.stderr
