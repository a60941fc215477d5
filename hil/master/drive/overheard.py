"""Units of a drive from overheard frames, instead of questions to it."""

from drive_profiles.standard.cia301 import DataType, decode
from drive_profiles.standard.objects import OBJECTS
from hil.logs.nodes import Node
from hil.master.drive.needs import Need
from hil.master.drive.scale import Questions

_USUAL_SIZE = 4


class OverheardQuestions(Questions):
    """Answers about a drive from overheard frames.

    The default of an EDS is not an answer: the drive may have other settings by now. The parameter value of a DCF is an answer,
    unless a frame has another.
    """

    def __init__(self, node: Node) -> None:
        """Begin with the overheard values."""
        self._told = node
        self.node, self.missing = node.number, []

    def number(self, need: Need, kind: DataType | None = None, *, is_optional: bool = False) -> int | None:
        """Return the number as the master would have read it, or None."""
        told = self._told
        is_stated = told.description is not None and need.address in told.description.values
        value = told.value(*need.address) if need.address in told.heard or is_stated else None
        if value is None:
            if not is_optional:
                self.missing.append(need)
            return None
        known = OBJECTS.get(need.address)
        size = (kind.size if kind is not None else known[1].size if known is not None else 0) or _USUAL_SIZE
        if kind is None and value >= 0:
            return value
        octets = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        return int.from_bytes(octets, "little") if kind is None else int(decode(kind, octets))
