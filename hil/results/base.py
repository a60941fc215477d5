"""Base of all result files: writing, schema, measured bench."""

import datetime
import json
import os
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, SerializerFunctionWrapHandler, model_serializer

from drive_profiles.files.safefile import file_instead, naming
from drive_profiles.version import DISTRIBUTION, version_text
from hil.bench.bench import Bench
from hil.errors import NOT_DISABLED, HilError, NotPossibleError, RefusalCause, SafetyStopError, not_restored_words

SCHEMA: Literal[2] = 2

RESULT_FILE = "result.json"
LOG_FILE = "bus.log"
"""Log of all frames, in the folder of every command that moves something."""
_FILES_OF_A_RESULT = (RESULT_FILE, "check.json", "design.json", LOG_FILE, "runs/*.csv")


def result_directory(
    out: str | Path | None, name: str, *, force: bool = False, remedy: str = "--force replaces its files"
) -> Path:
    """Return the directory for a command's files, by default a new one, which is not made yet.

    A directory with the files of another command is refused. `remedy` is for the message.

    Raises:
        NotPossibleError: It holds a result, recordings or a log, or it is a file, or below one.
    """
    if out is None:
        return Path("bench-out") / f"{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%SZ}-{name}"
    folder = Path(out)
    if wrong := file_instead(folder):
        raise NotPossibleError(f"{wrong}; name another one")
    found = next((path for pattern in _FILES_OF_A_RESULT for path in sorted(folder.glob(pattern))), None)
    if found is not None and not force:
        raise NotPossibleError(f"{found} already exists, from an earlier command; name another directory, or {remedy}")
    return folder


class _Written(BaseModel):
    """Base that leaves out absent values.

    An optional field without a value is not a key of the file. A field that has no default always is, with null instead of
    a number.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, defer_build=True)

    @model_serializer(mode="wrap")
    def _without_absent(self, write: SerializerFunctionWrapHandler) -> dict[str, object]:
        values: dict[str, object] = write(self)
        fields = type(self).model_fields
        optional = {field.alias or name for name, field in fields.items() if not field.is_required()}
        return {key: value for key, value in values.items() if value is not None or key not in optional}


class ResultPart(_Written):
    """Base of every table in a result file."""

    model_config = ConfigDict(frozen=True)


class MadeRun(ResultPart):
    """A run as it was made.

    Attributes:
        wall_s: Duration of the whole run on the wall clock.
        recording: Path of the CSV file, from the result's directory.
    """

    cycles: int
    missed_cycles: int
    wall_s: float
    recording: str
    stopped: str | None = None


class MeasuredBench(ResultPart):
    """Bench of a measurement: its file, bus, instant and versions."""

    name: str
    bus: str
    clock: Literal["lock-step", "wall"]
    started_utc: str
    versions: dict[str, str]
    file: Bench

    @classmethod
    def of(cls, bench: Bench, started: datetime.datetime, *, is_lock_step: bool) -> "MeasuredBench":
        """Describe a bench whose measurement has just begun."""
        return cls(
            name=bench.name,
            bus=bench.bus.address,
            clock="lock-step" if is_lock_step else "wall",
            started_utc=started.isoformat(timespec="seconds"),
            versions=versions(),
            file=bench,
        )


def versions() -> dict[str, str]:
    """Return the versions of this project, Python and packages."""
    numbers = {DISTRIBUTION: version_text(), "python": platform.python_version()}
    for package in ("python-can", "canopen", "numpy", "scipy", "cffi"):
        try:
            numbers[package] = version(package)
        except PackageNotFoundError:
            numbers[package] = "not installed"
    return numbers


class Result(_Written):
    """Base of every result file."""

    schema_version: Literal[2] = Field(SCHEMA, alias="schema")
    kind: str

    def dumps(self, indent: int | None = None) -> str:
        """Content of the file as JSON text."""
        value: dict[str, Any] = self.model_dump(mode="json", by_alias=True)
        return json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=False)

    def write(self, path: Path) -> None:
        """Write the file atomically.

        Raises:
            OSError: The file cannot be written.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(path.name + ".part")
        with naming(path):
            temporary.write_text(self.dumps(indent=1) + "\n", encoding="utf-8")
        os.replace(temporary, path)


def aftermath(all_disabled: bool | None, not_restored: Iterable[str]) -> tuple[str, ...]:
    """Return a sentence per setting that was not restored on drives."""
    unconfirmed = () if all_disabled is not False else (NOT_DISABLED,)
    return (*unconfirmed, *(not_restored_words(what) for what in not_restored))


class MeasuredResult(Result):
    """Base of the results of a measurement on one bench.

    Attributes:
        causes: Causes that the error of an early end names.
        all_disabled: After a stop, True if every drive has confirmed that it is disabled; None without a stop.
        drive_remarks: Sentences on limits that a drive does not hold, and on modes with a loss.
        emulated: True if any node is emulated: then this is not a measurement; None if that is not known.
        emulated_parts: Axes and accelerometer that are emulated, if others are not, or do not answer.
    """

    bench: MeasuredBench
    emulated: bool | None = None
    emulated_parts: tuple[str, ...] | None = None
    stopped: str | None = None
    causes: tuple[RefusalCause, ...] | None = None
    all_disabled: bool | None = None
    not_restored: tuple[str, ...] | None = None
    drive_remarks: tuple[str, ...] | None = None
    _unknown_keys: tuple[str, ...] = PrivateAttr(default=())

    @property
    def unknown_keys(self) -> tuple[str, ...]:
        """Keys of the bench file that this version does not know, where another one has written the result."""
        return self._unknown_keys

    def leave_out(self, keys: Iterable[str]) -> None:
        """Note keys of the bench file that this version does not know."""
        self._unknown_keys = tuple(keys)

    def note_emulation(self, answers: Mapping[str, bool | None]) -> None:
        """Note which parts of the bench are emulated."""
        parts = tuple(name for name, answer in answers.items() if answer)
        is_known = bool(answers) and None not in answers.values()
        self.emulated = True if parts else False if is_known else None
        self.emulated_parts = parts if parts and len(parts) < len(answers) else None

    @property
    def aftermath(self) -> tuple[str, ...]:
        """One sentence per setting that was not restored on the drives."""
        return aftermath(self.all_disabled, self.not_restored or ())

    def note_failure(self, error: BaseException) -> None:
        """Note why the measurement ended early."""
        self.causes = (error.causes if isinstance(error, HilError) else ()) or None
        text = str(error) or type(error).__name__
        if isinstance(error, SafetyStopError):
            self.stopped, self.all_disabled = text, error.all_disabled
        else:
            self._note_other_failure(text)

    def _note_other_failure(self, text: str) -> None:
        """Note the reason of a failure without a stopped run."""
        self.stopped = text
