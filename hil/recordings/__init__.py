"""Recordings from elsewhere: formats, columns, units, angles.

>>> from pathlib import Path
>>> from hil.recordings import Said, choose_columns
>>> names = ("Timestamp", "encoder_motorinc_1", "encoder_loadinc_1")
>>> choose_columns(Path("joint.csv"), names, Said(), axis=1)["load"].words
'load: encoder_loadinc_1 (2^24/rev)'
"""

from hil.errors import MissingPackageError, RecordingFileError
from hil.recordings.layout import Said, choose_columns, load_layout, said_with
from hil.recordings.reading import Recorded, read_recording

__all__ = [
    "MissingPackageError",
    "Recorded",
    "RecordingFileError",
    "Said",
    "choose_columns",
    "load_layout",
    "read_recording",
    "said_with",
]
