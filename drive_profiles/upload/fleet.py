"""Uploads to several drives at once: all of them, or none."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

from drive_profiles.device.memory import store_command
from drive_profiles.errors import DriveProfileError, InterruptedUploadError, NoAnswerError
from drive_profiles.upload.interrupt import InterruptWindow
from drive_profiles.upload.result import UploadReadBackError, UploadResult
from drive_profiles.upload.upload import Upload

RESTART_S = 15.0
"""Time that a drive may take to come back after a reset."""


@dataclass
class UploadControl:
    """Control of running uploads: their progress, and a way to stop them.

    An interrupt in the window stops the uploads, and everything is restored. It is closed where all is written and read back,
    before anything is stored: the last point of return, of all drives together. `progress` is called with a node and the number
    of steps made, from several threads.
    """

    window: InterruptWindow = field(default_factory=InterruptWindow)
    progress: Callable[[int, int], None] = lambda node, count: None


def prepare(uploads: Sequence[Upload]) -> None:
    """Prepare all uploads, in parallel.

    Raises:
        DriveProfileError: An upload failed (the first is reported); nothing has been written to any drive.
    """
    for error in _each(uploads, Upload.prepare).values():
        raise error


def run(uploads: Sequence[Upload], control: UploadControl | None = None) -> list[UploadResult]:
    """Carry out prepared uploads on all drives, or on none.

    Each drive is written, read back and stored; if one fails, all get their former values back. At its end the window is closed.

    Raises:
        DriveProfileError: A journal cannot be written, or a drive cannot store; nothing has been written to any drive.
    """
    control = UploadControl() if control is None else control
    try:
        return _run(uploads, control)
    finally:
        control.window.close()


def _run(uploads: Sequence[Upload], control: UploadControl) -> list[UploadResult]:
    window = control.window
    options = uploads[0].options
    if options.store:
        for upload in uploads:
            store_command(upload.device)
    for error in _each(uploads, Upload.still_as_prepared).values():
        raise error
    for upload in uploads:
        upload.open_journal()
    failures = _each(
        uploads, lambda upload: upload.write(lambda: window.is_interrupted, lambda: control.progress(upload.device.node, 1))
    )
    if not failures and not window.close():
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


def _roll_back(uploads: Sequence[Upload], failures: Mapping[Upload, DriveProfileError]) -> list[UploadResult]:
    first = next(iter(failures.values()))
    outcomes: dict[Upload, UploadResult] = {}

    def back(upload: Upload) -> None:
        error = failures.get(upload) or ElsewhereError(f"another drive failed: {first}", first.exit_code)
        outcomes[upload] = upload.roll_back(error, store_again=upload.stored != "no")

    for upload, error in _each(uploads, back).items():  # a mistake of this program on the way back
        every = tuple(upload.named(address) for address in upload.addresses)
        outcomes[upload] = upload.end("unknown", every, f"restoring it failed: {error}", 1)
    return [outcomes[upload] for upload in uploads]


def _after_reset(uploads: Sequence[Upload]) -> list[UploadResult]:
    """Reset the drives and read everything again, as proof of the storing."""
    failures = _each(uploads, _reset_and_verify)
    outcomes = []
    for upload in uploads:
        error = failures.get(upload)
        if error is None:
            outcomes.append(replace(upload.done(), is_reset=True))
            continue
        objects = (
            error.objects
            if isinstance(error, UploadReadBackError)
            else tuple(upload.named(address) for address in upload.addresses)
        )
        outcomes.append(upload.end("unknown", objects, f"after the reset: {error}", error.exit_code, others="new"))
    return outcomes


def _reset_and_verify(upload: Upload) -> None:
    upload.device.check_quiet()
    upload.device.reset(RESTART_S)
    upload.restarted()
    upload.verify()


class UnexpectedError(DriveProfileError):
    """An error in this program."""

    exit_code = 1


class ElsewhereError(DriveProfileError):
    """Another drive of the same upload failed."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.exit_code = code  # type: ignore[misc]  # that of the failure itself


def _each(uploads: Sequence[Upload], step: Callable[[Upload], None]) -> dict[Upload, DriveProfileError]:
    """Run a step on every drive, in parallel; return the errors."""
    failures: dict[Upload, DriveProfileError] = {}

    def guarded(upload: Upload) -> None:
        try:
            step(upload)
        except DriveProfileError as error:
            failures[upload] = error
        except Exception as error:  # noqa: BLE001 - whatever it is, the drives are restored before anything else
            failures[upload] = UnexpectedError(f"unexpected: {error!r}")
            failures[upload].__cause__ = error

    if len(uploads) == 1:
        guarded(uploads[0])
        return failures
    with ThreadPoolExecutor(max_workers=max(1, len(uploads))) as pool:
        for future in [pool.submit(guarded, upload) for upload in uploads]:
            future.result()
    return {upload: failures[upload] for upload in uploads if upload in failures}
