"""Uploads to several drives at once: all of them, or none."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from drive_profiles.errors import DriveProfileError, InterruptedUploadError, NoAnswerError
from drive_profiles.memory import store_command
from drive_profiles.outcome import Outcome, ReadBackError
from drive_profiles.upload import Upload

RESTART_S = 15.0
"""How long a drive may take to come back after a reset."""


@dataclass
class Control:
    """How a run of uploads is watched and stopped.

    Attributes:
        cancel: Set it to stop; everything is put back.
        progress: Called with a node and the number of steps made, from several threads.
    """

    cancel: threading.Event = field(default_factory=threading.Event)
    progress: Callable[[int, int], None] = lambda node, count: None


def prepare(uploads: Sequence[Upload]) -> None:
    """`Upload.prepare` of all, in parallel.

    Raises:
        DriveProfileError: The first that failed; nothing has been written to any.
    """
    for error in _each(uploads, Upload.prepare).values():
        raise error


def run(uploads: Sequence[Upload], control: Control | None = None) -> list[Outcome]:
    """All or none: what `prepare` has found ready is written, read back and stored on every drive, or put back on every drive.

    Raises:
        DriveProfileError: A journal cannot be written, or a drive cannot store; nothing has been written to any.
    """
    control = Control() if control is None else control
    options = uploads[0].options
    if options.store:
        for upload in uploads:
            store_command(upload.device)
    for error in _each(uploads, Upload.still_as_prepared).values():
        raise error
    for upload in uploads:
        upload.open_journal()
    failures = _each(uploads, lambda upload: upload.write(control.cancel.is_set, lambda: control.progress(upload.device.node, 1)))
    if not failures and control.cancel.is_set():
        failures = {upload: InterruptedUploadError(f"node {upload.device.node}: interrupted") for upload in uploads}
    if not failures and options.store:
        failures = _each(uploads, Upload.store)
    silent = {upload for upload, error in failures.items() if isinstance(error, NoAnswerError) and upload.stored == "unknown"}
    if failures and set(failures) != silent:
        return _roll_back(uploads, failures)
    if failures:  # some do not say whether they have stored: every drive holds the set, and that is said
        return [upload.done() for upload in uploads]
    if options.reset:
        return _after_reset(uploads)
    return [upload.done() for upload in uploads]


def _roll_back(uploads: Sequence[Upload], failures: Mapping[Upload, DriveProfileError]) -> list[Outcome]:
    first = next(iter(failures.values()))
    outcomes: dict[Upload, Outcome] = {}

    def back(upload: Upload) -> None:
        error = failures.get(upload) or ElsewhereError(f"another drive failed: {first}", first.exit_code)
        outcomes[upload] = upload.roll_back(error, store_again=upload.stored != "no")

    for upload, error in _each(uploads, back).items():  # a mistake of this program on the way back
        every = tuple(upload.named(place) for place in upload.places)
        outcomes[upload] = upload.end("unknown", every, f"putting it back failed: {error}", 1)
    return [outcomes[upload] for upload in uploads]


def _after_reset(uploads: Sequence[Upload]) -> list[Outcome]:
    """Read everything once more after a reset: what the drives have kept."""
    failures = _each(uploads, _reset_and_verify)
    outcomes = []
    for upload in uploads:
        error = failures.get(upload)
        if error is None:
            outcomes.append(upload.done())
            continue
        objects = error.objects if isinstance(error, ReadBackError) else tuple(upload.named(place) for place in upload.places)
        outcomes.append(upload.end("unknown", objects, f"after the reset: {error}", error.exit_code, others="new"))
    return outcomes


def _reset_and_verify(upload: Upload) -> None:
    upload.device.check_quiet()
    upload.device.reset(RESTART_S)
    upload.restarted()
    upload.verify()


class UnexpectedError(DriveProfileError):
    """A mistake of this program."""

    exit_code = 1


class ElsewhereError(DriveProfileError):
    """Another drive of the same upload failed."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.exit_code = code  # type: ignore[misc]  # that of the failure itself


def _each(uploads: Sequence[Upload], step: Callable[[Upload], None]) -> dict[Upload, DriveProfileError]:
    """Do a step on every drive, in parallel; who failed, and why."""
    failures: dict[Upload, DriveProfileError] = {}

    def guarded(upload: Upload) -> None:
        try:
            step(upload)
        except DriveProfileError as error:
            failures[upload] = error
        except Exception as error:  # noqa: BLE001 - whatever it is, the drives are put back before anything else
            failures[upload] = UnexpectedError(f"unexpected: {error!r}")
            failures[upload].__cause__ = error

    if len(uploads) == 1:
        guarded(uploads[0])
        return failures
    with ThreadPoolExecutor(max_workers=max(1, len(uploads))) as pool:
        for future in [pool.submit(guarded, upload) for upload in uploads]:
            future.result()
    return {upload: failures[upload] for upload in uploads if upload in failures}
