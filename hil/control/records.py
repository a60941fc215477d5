"""Records that compiled functions read and write: a protocol declares the fields, numpy's memory layout follows from it.

mypy then knows the fields inside compiled functions, where a record has no Python type of its own, and refuses a misspelt one.
"""

from typing import Annotated, Any, Protocol, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

Row_co = TypeVar("Row_co", covariant=True)


class Rows(Protocol[Row_co]):
    """An array of equal records."""

    def __len__(self) -> int:
        """Number of records."""

    def __getitem__(self, index: int, /) -> Row_co:
        """One record, live: a change of it changes the array."""


_NUMBERS: dict[Any, type[np.generic]] = {float: np.float64, int: np.int64}


def record_dtype(row: type) -> np.dtype[Any]:
    """The memory layout of a record, in the order in which a protocol declares its fields, without gaps.

    ``float`` is float64, ``int`` is int64, another such protocol is a record inside the record. An array of fixed shape is
    ``Annotated[NDArray[np.float64], (4, 7)]``, several equal records are ``Annotated[Rows[Row], (2,)]``.

    Raises:
        TypeError: A field is declared as anything else.
    """
    fields = get_type_hints(row, include_extras=True)
    return np.dtype([(name, *_layout(row, name, declared)) for name, declared in fields.items()])


def _layout(row: type, name: str, declared: Any) -> tuple[Any, ...]:
    if get_origin(declared) is Annotated:
        array, shape = get_args(declared)
        element = get_args(array)[-1]  # of NDArray it is the dtype, with the type of its numbers
        number = get_args(element)
        return (number[0] if number else record_dtype(element), shape)
    if declared in _NUMBERS:
        return (_NUMBERS[declared],)
    if getattr(declared, "_is_protocol", False):
        return (record_dtype(declared),)
    raise TypeError(f"{row.__name__}.{name} is {declared!r}; a record holds float, int, arrays and records")
