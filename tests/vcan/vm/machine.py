"""A virtual machine whose kernel has SocketCAN, around one command: user-mode Linux, which any user may start.

    python tests/vcan/vm/machine.py -- python -m pytest -m vcan tests/vcan

The machine's root is this machine's file tree: the command finds the same Python, environment and sources, and what it writes
stays. Output and exit status are the command's own. Debian packages: user-mode-linux busybox-static iproute2.
"""

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

KERNEL = "linux.uml"
NEEDED = {KERNEL: "user-mode-linux", "busybox": "busybox-static", "ip": "iproute2", "tc": "iproute2", "candump": "can-utils"}
INSTALL = "apt-get install --no-install-recommends user-mode-linux busybox-static iproute2 can-utils"
MODULES = ("can", "can-raw", "can-gw", "vcan", "vxcan", "sch_netem")
OPTIONS = {"vcan": "echo=1"}
"""Without echo vcan hands frames back before its queueing discipline, and `tc netem` has nothing to act on."""
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
SHARED_MEMORY = "/dev/shm"  # noqa: S108 - the kernel makes an unnamed file there: the machine's memory
SLOWNESS = 8
"""Seconds that the machine computes in one of its own clock, where a C compiler is: it seems that much faster (own_clock.c)."""
NO_MACHINE, TIMED_OUT = 125, 124
"""Exit statuses: the machine did not come up or did not end as it should; the command took longer than allowed."""


def missing() -> str:
    """What this machine lacks for a virtual machine, with how to get it; empty where it has all."""
    lacking = [program for program in NEEDED if shutil.which(program, path=SYSTEM_PATH) is None]
    if lacking:
        return f"no {', '.join(lacking)} here: {INSTALL}"
    if _has_tiles() and shutil.which("cc") is None:
        return "no C compiler here, and this processor has AMX: see xstate.c"
    return ""


def _has_tiles() -> bool:
    """Whether the processor has AMX, with which the machine's kernel needs help: see xstate.c."""
    return " amx_tile" in Path("/proc/cpuinfo").read_text()


def _environment(job: Path, slowness: int) -> dict[str, str]:
    """The machine's own environment: where its memory lies, and what is loaded before its kernel."""
    environment = dict(os.environ)
    if os.access(SHARED_MEMORY, os.W_OK):
        environment["TMPDIR"] = SHARED_MEMORY
    helps = [_compiled(job, "xstate")] if _has_tiles() else []
    if shutil.which("cc") is not None:
        helps.append(_compiled(job, "own_clock", f"-DSLOWNESS={slowness}"))
    if helps:
        environment["LD_PRELOAD"] = ":".join(helps)
    return environment


def _compiled(job: Path, name: str, *options: str) -> str:
    """A help for the machine's kernel, compiled from its source beside this file."""
    help_, source = job / f"{name}.so", Path(__file__).with_name(f"{name}.c")
    subprocess.run(
        ["cc", "-O2", "-shared", "-fPIC", *options, "-o", str(help_), str(source)],  # noqa: S607 - where cc is depends on the system
        check=True,
    )
    return str(help_)


def module_lines(kernel: str) -> Iterator[str]:
    """Arguments of insmod, each module after those that it needs; modules.dep names them the other way round."""
    release = subprocess.run([kernel, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    directory = Path("/usr/lib/uml/modules") / release
    needs = {}
    for line in (directory / "modules.dep").read_text().splitlines():
        path, _, others = line.partition(":")
        needs[Path(path).stem] = [*reversed(others.split()), path]
    loaded: set[str] = set()
    for module in MODULES:
        for path in needs.get(module, ()):
            if path not in loaded:
                loaded.add(path)
                yield f"{directory / path} {OPTIONS.get(Path(path).stem, '')}".rstrip()


def run(command: list[str], interfaces: str, memory: str, limit_s: float, slowness: int) -> int:
    """Start the machine, run the command in it, and give the command's exit status."""
    lacking = missing()
    if lacking:
        sys.stderr.write(f"{lacking}\n")
        return NO_MACHINE
    kernel = shutil.which(KERNEL, path=SYSTEM_PATH) or KERNEL
    with tempfile.TemporaryDirectory(prefix="vcan-") as name:
        job = Path(name)
        (job / "tmp").mkdir()
        (job / "modules").write_text("".join(f"{line}\n" for line in module_lines(kernel)))
        (job / "interfaces").write_text(interfaces)
        exports = {key: value for key, value in os.environ.items() if key.isidentifier()}
        exports["TMPDIR"] = str(job / "tmp")
        lines = [f"export {key}={shlex.quote(value)}" for key, value in exports.items()]
        (job / "command").write_text("\n".join([*lines, f"cd {shlex.quote(os.getcwd())}", shlex.join(command), ""]))
        with (job / "console").open("w+b") as console, os.fdopen(os.dup(sys.stdout.fileno()), "wb") as output:
            # whatever else computes would hold the machine up at each of its many switches between processes; it needs little
            first = ["nice", "-n", "-10"] if os.geteuid() == 0 else []
            machine = subprocess.Popen(
                [*first, kernel,
                 "rootfstype=hostfs", "rootflags=/", "rw", f"init={Path(__file__).with_name('init.sh')}", "panic=-1",
                 f"mem={memory}", f"uml_dir={job}/", "umid=vm", "quiet", f"bench_job={job}", "con=null", "ssl=null",
                 f"con0=null,fd:{console.fileno()}", f"con1=null,fd:{output.fileno()}"],
                stdin=subprocess.DEVNULL, stdout=console, stderr=console, pass_fds=(console.fileno(), output.fileno()),
                start_new_session=True, env=_environment(job, slowness),
            )  # fmt: skip
            try:
                machine.wait(limit_s)
            except subprocess.TimeoutExpired:
                return TIMED_OUT
            finally:
                if machine.poll() is None:
                    os.killpg(machine.pid, signal.SIGKILL)
                    machine.wait()
            status = job / "status"
            if status.exists():
                return int(status.read_text())
            console.seek(0)
            sys.stderr.write(console.read()[-4000:].decode(errors="replace"))
            return NO_MACHINE


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Run a command on a kernel that has SocketCAN.")
    parser.add_argument("--interfaces", default="vcan0", help="vcan interfaces to make (default: vcan0)")
    parser.add_argument("--memory", default="1024M", help="memory of the machine (default: 1024M)")
    parser.add_argument("--limit-s", type=float, default=600.0, help="longest time (default: 600)")
    parser.add_argument("--slowness", type=int, default=SLOWNESS, help=f"by its clock it is so much faster (default: {SLOWNESS})")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="-- COMMAND [ARGUMENT ...]")
    given = parser.parse_args()
    command = given.command[1:] if given.command[:1] == ["--"] else given.command
    if not command:
        parser.error("no command")
    return run(command, given.interfaces, given.memory, given.limit_s, given.slowness)


if __name__ == "__main__":
    sys.exit(main())
