"""Records of the core as plain objects, for the specification in Python."""

from types import SimpleNamespace
from typing import Any

import numpy as np


def plain(record: Any) -> Any:
    """Fields of a record as an object; records in it become objects too, rows lists, and matrices stay arrays of their own."""
    if isinstance(record, np.void) and record.dtype.names:
        return SimpleNamespace(**{name: plain(record[name]) for name in record.dtype.names})
    if isinstance(record, np.ndarray) and record.ndim > 1 and not record.dtype.names:
        return record.copy()
    if isinstance(record, np.ndarray):
        return [plain(each) for each in record]
    return record.item()


def numbers(record: Any) -> list[float]:
    """All numbers of a record, of a plain object or of lists of these, in the order of the fields."""
    if isinstance(record, np.ndarray) and not record.dtype.names:
        return [float(each) for each in record.ravel()]
    if isinstance(record, np.void | np.ndarray):
        return numbers(plain(record))
    if isinstance(record, SimpleNamespace):
        return [number for value in vars(record).values() for number in numbers(value)]
    if isinstance(record, list):
        return [number for value in record for number in numbers(value)]
    return [record]
