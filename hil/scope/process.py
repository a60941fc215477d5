"""The scope as a process beside a run, on the same bus.

The cycle of the run does not depend on it.
"""

import select
import subprocess
import sys
import tempfile
from types import TracebackType
from typing import Self

from hil.emulator import end
from hil.errors import NotPossibleError

SCOPE_START_S = 60.0


class ScopeProcess:
    """A process of `hil scope` that ends with its standard input."""

    def __init__(self, address: str, bench_file: str, port: int) -> None:
        self.url = ""
        self._bus_line = f"bus {address}, from --bus"
        self._command = [
            sys.executable, "-m", "hil", "scope", "--bus", address, "--bench", bench_file, "--port", str(port),
            "--until-stdin-closes",
        ]  # fmt: skip
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        """Start the process and wait until it listens.

        Raises:
            NotPossibleError: It has ended, or does not listen in time; its output is in the message.
        """
        with tempfile.TemporaryFile("w+") as errors:
            process = subprocess.Popen(  # noqa: S603 - our own interpreter and module, no shell
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True
            )
            self._process = process
            stdout = process.stdout
            is_ready = stdout is not None and bool(select.select([stdout], [], [], SCOPE_START_S)[0])
            self.url = stdout.readline().strip() if stdout is not None and is_ready else ""
            if not self.url:
                self.__exit__(None, None, None)
                errors.seek(0)
                own = [line for line in errors if not line.startswith(self._bus_line)]  # the command has said it already
                said = "".join(own).strip() or f"it did not start to listen within {SCOPE_START_S:g} s"
                raise NotPossibleError(f"the live page cannot start, and nothing has moved: {said}")
        return self

    @property
    def pid(self) -> int:
        """Number of the process.

        Raises:
            ValueError: It does not run.
        """
        if self._process is None:
            raise ValueError("the scope is not running")
        return self._process.pid

    def __exit__(self, _type: type[BaseException] | None, _value: BaseException | None, _tb: TracebackType | None) -> None:
        if self._process is not None:
            end(self._process)
            self._process = None
