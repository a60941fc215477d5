"""Opening of a recording by the suffix of its name."""

from pathlib import Path

from hil.recordings.errors import RecordingFileError
from hil.recordings.source import Source


def open_source(path: Path, description: Path | None = None, node_id: int | None = None) -> Source:
    """A recording, by the suffix of its name.

    Args:
        path: The file.
        description: What decodes frames of a bus: EDS, DCF, XDD or DBC file.
        node_id: Node-ID of the drive that has sent them.

    Raises:
        RecordingFileError: The format is not known, or the file cannot be read.
        MissingPackageError: The format needs a package that is not installed.
    """
    if not path.is_file():
        raise RecordingFileError(path, "there is no such file")
    if path.stat().st_size == 0:
        raise RecordingFileError(path, "the file is empty; check that the recording was stopped and copied whole")
    name = path.name.lower()
    if name.endswith((".csv", ".csv.gz", ".txt", ".tsv")):
        from hil.recordings.delimited import DelimitedFile  # noqa: PLC0415 - a reader is loaded where it is needed

        return DelimitedFile(path)
    if name.endswith((".parquet", ".pq")):
        from hil.recordings.parquet import ParquetFile  # noqa: PLC0415

        return ParquetFile(path)
    if name.endswith((".mf4", ".mdf")):
        from hil.recordings.mdf import MdfFile  # noqa: PLC0415

        return MdfFile(path)
    if name.endswith((".log", ".blf", ".asc")):
        from hil.recordings.frames import FrameFile  # noqa: PLC0415

        return FrameFile(path, description, node_id)
    raise RecordingFileError(path, "unknown format; expected .csv, .csv.gz, .tsv, .parquet, .mf4, .log, .blf or .asc")
