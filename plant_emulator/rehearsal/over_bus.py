"""The documented path's steps on a served robot, as commands of `hil`."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from drive_profiles.address import Address
from hil.bench.bench import Bench
from hil.control.treatments import TreatmentName
from hil.errors import HilError, RefusalCause
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE, MeasuredResult
from hil.results.files import load_any, load_result
from hil.results.runs import ExperimentsResult
from plant_emulator.rehearsal.steps import Note, PathFiles, RunNote, note_of_error, note_of_run
from plant_emulator.robots.blank_bench import file_text

COMMAND_S = 1800.0
"""Time after which a command is given up: the longest takes some minutes on a busy machine."""
NOT_MET = 9
"""Exit status of a command that has done what it does, and of which a claim does not hold."""


class CommandError(HilError):
    """A command that has ended with another status than 0."""

    def __init__(self, arguments: Sequence[str], status: int, words: str, causes: tuple[RefusalCause, ...] = ()) -> None:
        self.arguments, self.status, self.words, self.causes = tuple(arguments), status, words, causes
        super().__init__(f"{words} (exit status {status})")


class StepsOverBus:
    """Steps by the commands of `hil`, exactly as in docs/tuning.md.

    Args:
        bench: The bench file; written into the folder of the path.
        address: The bus on which the robot is served.
    """

    def __init__(self, bench: Bench, axis: int, files: PathFiles, address: Address) -> None:
        self._axis, self._files = str(axis), files
        self._bench = files.folder / "bench.toml"
        self._bench.write_text(file_text(bench.on(str(address))), encoding="utf-8")

    def plant(self) -> Note:
        """Identify the plant."""
        self._hil("identify", "plant", "--model", str(self._files.model), out="plant")
        return None

    def ate(self) -> Note:
        """Identify the ATE, and add it to the model file."""
        self._hil("identify", "ate", "--model", str(self._files.model), out="ate", may_miss=True)
        return note_of_error(load_result(self._out("ate"), AteResult, "an identification of the transmission error"))

    def design(self) -> Note:
        """Design a notch, and write it into the design file."""
        options = ("--model", str(self._files.model), "--design", str(self._files.designs), "--quick", "--jobs", "1")
        try:
            self._hil("design", "notch", *options, out="design")
        except CommandError as error:
            if error.status != NOT_MET or not self._files.designs.exists():
                raise
            return error.words
        return None

    def run(self, treatment: TreatmentName, *, is_learnt: bool) -> RunNote:
        """Run the user's motion with a treatment."""
        options = ["--treatment", treatment]
        named = {"--model": self._files.model, "--design": self._files.designs}
        for option, path in (named | ({"--learnt": self._files.learnt} if is_learnt else {})).items():
            options += [option, str(path)] if path.exists() else []
        self._hil("run", "constant-acceleration", *options, out=treatment, may_miss=True)
        return note_of_run(load_result(self._out(treatment), ExperimentsResult, "a run"))

    def learn(self) -> Note:
        """Learn the ATE from what is known, into its own model file."""
        known = ("--plant", str(self._files.model)) if self._files.model.exists() else ()
        self._hil("learn", *known, "--model", str(self._files.learnt), out="learn")
        return None

    def _out(self, name: str) -> Path:
        return self._files.folder / name

    def _hil(self, *arguments: str, out: str, may_miss: bool = False) -> None:
        """Run a command of `hil`.

        Raises:
            CommandError: It has not done what was asked.
        """
        whole = (*arguments, "--axis", self._axis, "--bench", str(self._bench), "--out", str(self._out(out)))
        try:
            ended = subprocess.run(  # noqa: S603 - our own interpreter and module, no shell
                [sys.executable, "-m", "hil", *whole], capture_output=True, text=True, timeout=COMMAND_S, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise CommandError(whole, -1, f"not done within {COMMAND_S:g} s") from error
        has_result = (self._out(out) / RESULT_FILE).exists()
        if ended.returncode and not (may_miss and ended.returncode == NOT_MET and has_result):
            result = load_any(self._out(out) / RESULT_FILE) if has_result else None
            causes = result.causes if isinstance(result, MeasuredResult) else None
            raise CommandError(whole, ended.returncode, _last_words(ended.stderr), causes or ())


def _last_words(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("report:")]
    return lines[-1] if lines else "no words"
