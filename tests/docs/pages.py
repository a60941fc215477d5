"""The commands of the documents: read from their shell blocks, and run page by page as they stand there."""

import contextlib
import os
import re
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)\n(?P<body>(?:.*\n)*?)(?P=indent)```$", re.MULTILINE)
PROGRAMS = re.compile(
    r"(?:sudo |env )?(?:make|pip|pytest|python3?|hil|drive-profiles|plant-emulator|can_\w+|apt-get|\.venv/bin/\S+)(?: |$)"
)
SERVER = "plant-emulator serve "
STATUS = re.compile(r"\bends with (\d+)")
PORT = "18000"
LINKED = ("benchmarks", "drive_profiles", "hil", "plant_emulator", "tests", "Makefile", "README.md", "pyproject.toml")
COPIED = ("docs", "examples")
"""Parts of the project that lie beside a reader; what readers write to, or read from, is a copy."""
SHARED = "/tmp/"  # noqa: S108 - where the pages have the robot's socket
BASH = shutil.which("bash")
MARK = "-- status of the command above:"


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    body: str


@dataclass(frozen=True)
class Command:
    """A command of a page.

    Attributes:
        page: Path of the page, from the project's folder.
        line: Its line there.
        text: What a reader types: continued lines joined, the comment behind it left out.
        status: The exit status with which the page says that it ends ("ends with 7"), else 0.
    """

    page: str
    line: int
    text: str
    status: int = 0

    @property
    def is_server(self):
        return self.text.startswith(SERVER)


def name_of(path):
    return str(path.relative_to(ROOT))


def blocks_in(path):
    text = path.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        indent = len(found["indent"])
        body = "".join(line[indent:] if line.strip() else line for line in found["body"].splitlines(keepends=True))
        yield Block(name_of(path), text[: found.start()].count("\n") + 2, found["language"], body)


def without_comment(line):
    """A line up to a # that begins a word outside quotes."""
    quote = ""
    for place, letter in enumerate(line):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter == "#" and (place == 0 or line[place - 1].isspace()):
            return line[:place].rstrip()
    return line.rstrip()


def commands_in(block):
    """The commands of a shell block."""
    line = block.line
    for joined in block.body.replace("\\\n", "\0").splitlines():
        whole = joined.replace("\0", "")
        text = re.sub(r" {2,}", " ", without_comment(whole)) if "\0" in joined else without_comment(whole)
        if text:
            status = STATUS.search(whole[len(without_comment(whole)) :])
            yield Command(block.page, line, text, int(status[1]) if status else 0)
        line += joined.count("\0") + 1


def commands_of(path):
    return [command for block in blocks_in(path) if block.language == "sh" for command in commands_in(block)]


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


class Shell:
    """One shell in a fresh folder, in which the project's own parts and its `.venv` lie as beside a reader.

    Two things are another's on a machine that many share, and are replaced in what is typed: `/tmp/` by a folder of this shell,
    and the TCP port of the pages by a free one. Servers run behind the page, as in a terminal of their own, until another takes
    their bus or the page ends.

    Args:
        folder: Where it works.
        place: Short path that stands for `/tmp/`: a socket's name has about 100 characters.
    """

    def __init__(self, folder, place):
        self.folder, self.place, self._port = folder, place, str(free_port())
        self._servers = {}
        for name in LINKED:
            (folder / name).symlink_to(ROOT / name)
        for name in COPIED:
            shutil.copytree(ROOT / name, folder / name)
        (folder / ".venv").symlink_to(sys.prefix)
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("HIL_", "PYTEST_", "VIRTUAL_ENV"))}
        self._bash = subprocess.Popen(
            [BASH or "bash", "--noprofile", "--norc"], cwd=folder, env=environment | {"COLUMNS": "100"}, text=True, bufsize=1,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._bash.stdin.close()
        for name in list(self._servers):
            self._stop(name)
        try:
            self._bash.wait(10.0)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._bash.pid, signal.SIGKILL)
            self._bash.wait()
            self._bash.stdout.close()

    def local(self, text):
        """What is typed here for what stands on the page."""
        return text.replace(SHARED, f"{self.place}/").replace(PORT, self._port)

    def run(self, text, limit_s):
        """Type a command; its exit status and what it printed.

        Raises:
            TimeoutError: It has not ended in time.
        """
        return self._type(self.local(text), limit_s)

    def _type(self, text, limit_s):
        self._bash.stdin.write(f"{{ {text}\n}} </dev/null\nprintf '\\n%s %d\\n' '{MARK}' $?\n")
        deadline, said = time.monotonic() + limit_s, ""
        with selectors.DefaultSelector() as selector:
            selector.register(self._bash.stdout, selectors.EVENT_READ)
            while (end := re.search(rf"\n{MARK} (\d+)\n", said)) is None:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise TimeoutError(f"{text}: not within {limit_s} s; it said\n{said}")
                more = os.read(self._bash.stdout.fileno(), 65536).decode("utf-8", "replace")
                if not more:
                    raise EOFError(f"{text}: the shell has ended; it said\n{said}")
                said += more
        return int(end[1]), said[: end.start()]

    def serve(self, text, limit_s):
        """Start a server of the page behind it, and wait until it serves."""
        bus = re.search(r"--bus (\S+)", text)
        name = bus[1].partition("@")[0] if bus else ""
        if name in self._servers:
            self._stop(name)
        log = self.place / f"server{len(list(self.place.glob('server*.log')))}.log"
        log.touch()
        status, said = self._type(f"{self.local(text)} </dev/null >{log} 2>&1 & echo $!", limit_s)
        assert status == 0, said
        self._servers[name] = int(said.split()[-1]), log
        deadline = time.monotonic() + limit_s
        while "serving " not in log.read_text(encoding="utf-8"):
            if time.monotonic() > deadline or not _lives(self._servers[name][0]):
                raise TimeoutError(f"{text} does not serve: {log.read_text(encoding='utf-8')}")
            time.sleep(0.05)

    def _stop(self, name):
        process, log = self._servers.pop(name)
        if _lives(process):
            os.kill(process, signal.SIGTERM)
        deadline = time.monotonic() + 10.0
        while _lives(process) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert "Traceback" not in log.read_text(encoding="utf-8"), log.read_text(encoding="utf-8")


def _lives(process):
    """Whether a process of the shell is still at work; one that has ended and waits for its shell is not."""
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] not in {"Z", "X"}
    except FileNotFoundError:
        return False
