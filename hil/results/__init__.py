"""Result types of all commands, written and read as JSON files.

>>> import tempfile
>>> from pathlib import Path
>>> from hil.results.base import RESULT_FILE
>>> from hil.results.comparison import ComparisonRequestEntry, ComparisonResult
>>> from hil.results.files import load_any
>>> request = ComparisonRequestEntry(experiments=("line-motion",), axes=(), treatments=("none", "notch"), named=())
>>> result = ComparisonResult(started_utc="2025-01-01T12:00:00+00:00", request=request)
>>> with tempfile.TemporaryDirectory() as folder:
...     result.write(Path(folder) / RESULT_FILE)
...     load_any(Path(folder) / RESULT_FILE) == result
True
"""
