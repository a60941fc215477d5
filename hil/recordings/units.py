"""Units of recorded columns: SI factor, and counts per revolution."""

import math
import re
from dataclasses import dataclass
from typing import Literal, get_args

Role = Literal["time", "motor", "load", "acceleration", "torque"]
"""Meaning of a column: time, motor angle, joint angle behind the gear, acceleration of the tip, torque of the motor."""
ROLES: tuple[Role, ...] = get_args(Role)

_ANGLES = {
    suffix[1:]: factor
    for suffix, factor in (
        ("_rad", 1.0), ("_mrad", 1e-3), ("_deg", math.pi / 180.0), ("_rev", 2.0 * math.pi), ("_arcsec", math.pi / 648_000.0),
    )
}  # fmt: skip
_PLAIN: dict[Role, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "motor": _ANGLES,
    "load": _ANGLES,
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3, "g": 9.80665},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2},
}
_PER_REV = re.compile(r"([-+]?)(?:2\^(\d{1,2})|(\d{1,12}))/rev")
_SCALED = re.compile(r"(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?) ?([A-Za-z]\S*)")


@dataclass(frozen=True)
class Unit:
    """Unit of a column.

    Attributes:
        factor: SI value of 1.
        per_rev: Numbers in a revolution, after which an angle may begin anew; 0 for other quantities.
    """

    text: str
    factor: float
    per_rev: float = 0.0


def unit_of(role: Role, text: str) -> Unit:
    """Return the unit of a column by its spelling.

    Increments are written with their number per revolution, others with their size.

    >>> unit_of("motor", "2^24/rev").per_rev
    16777216.0
    >>> unit_of("acceleration", "g").factor
    9.80665
    >>> unit_of("torque", "0.0071 Nm").factor
    0.0071

    Raises:
        ValueError: This is not a unit of such a column.
    """
    is_angle = role in {"motor", "load"}
    found = _PER_REV.fullmatch(text.replace(" ", "")) if is_angle else None
    if found is not None:
        count = 2 ** int(found[2]) if found[2] else int(found[3])
        if 4 <= count <= 2**48:
            sign = -1.0 if found[1] == "-" else 1.0
            return Unit(text, sign * 2.0 * math.pi / count, float(count))
    scaled = _SCALED.fullmatch(text)
    number, name = (scaled[1], scaled[2]) if scaled is not None else ("1", text)
    if found is None and name in _PLAIN[role] and float(number) > 0.0:
        factor = float(number) * _PLAIN[role][name]
        return Unit(text, factor, 2.0 * math.pi / factor if is_angle else 0.0)
    known = [*_PLAIN[role], *(("2^24/rev", "-4096/rev") if is_angle else ())]
    raise ValueError(f"{text!r} is not a unit of {role}; expected one of {', '.join(known)}")
