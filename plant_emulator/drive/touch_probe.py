"""Touch probes: latched positions at edges of inputs.

Function and status share their layout, probe 2 in the upper byte. A probe starts anew with the rising edge of its enable bit,
or of the bit that enables an edge. First event keeps what the first edge gave; continuous, what the last one did. Bits 6 and 7
of the status, the manufacturer's, change with each position that is stored at a positive or negative edge.

Source: CiA 402-2, touch probe functionality: 60B8h to 60BDh, 60D0h.
"""

from collections.abc import Callable, Sequence

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.motion import record
from plant_emulator.slave.dictionary import Dictionary

ENABLE, CONTINUOUS, POSITIVE_EDGE, NEGATIVE_EDGE = 1 << 0, 1 << 1, 1 << 4, 1 << 5
"""Bits of 60B8h, of probe 1."""
SOURCE_SHIFT, INPUT, ZERO_INDEX, SOURCE_OBJECT, RESERVED = 2, 0, 1, 2, 3
"""60B8h, bits 2 and 3."""
POSITIVE_STORED, NEGATIVE_STORED, POSITIVE_TOGGLE, NEGATIVE_TOGGLE = 1 << 1, 1 << 2, 1 << 6, 1 << 7
"""Bits of 60B9h beside ENABLE, of probe 1."""

_STORED = {POSITIVE_EDGE: POSITIVE_STORED, NEGATIVE_EDGE: NEGATIVE_STORED}
_TOGGLES = (POSITIVE_TOGGLE, NEGATIVE_TOGGLE)
_PROBE = {
    1: (1 << record.PROBE_1_RISING, 1 << record.PROBE_1_FALLING),
    2: (1 << record.PROBE_2_RISING, 1 << record.PROBE_2_FALLING),
}
SOURCES: dict[int, tuple[int, int]] = {
    **_PROBE,
    5: (1 << record.INDEX, 0),
    -1: (1 << record.HOME_RISING, 1 << record.HOME_FALLING),
    -2: (1 << record.NEGATIVE_RISING, 1 << record.NEGATIVE_FALLING),
    -3: (1 << record.POSITIVE_RISING, 1 << record.POSITIVE_FALLING),
}
"""60D0h: bits of the positive and of the negative edge; 5 is the encoder's index pulse, below 0 the switches (manufacturer's)."""

_POSITIONS = {
    1: (Object.TOUCH_PROBE_1_POSITIVE, Object.TOUCH_PROBE_1_NEGATIVE),
    2: (Object.TOUCH_PROBE_2_POSITIVE, Object.TOUCH_PROBE_2_NEGATIVE),
}


class TouchProbe:
    """One of the two probes.

    Attributes:
        status: Its byte of 60B9h.
    """

    def __init__(self, number: int, dictionary: Dictionary, inputs: DigitalInputs, to_user: Callable[[float], int]) -> None:
        """Bind the objects of the positions.

        Args:
            number: 1 or 2.
            to_user: The position that the user reads at these counts of the encoder.
        """
        self.number = number
        self.status = 0
        self._function = self._edges = 0
        self._sources = _PROBE[number]
        self._inputs, self._to_user = inputs, to_user
        self._cells = [dictionary.cell(index) for index in _POSITIONS[number]]

    def set_function(self, function: int, sources: tuple[int, int]) -> None:
        """Process a byte of 60B8h.

        Args:
            sources: Bits of the positive and of the negative edge.
        """
        before = self._function if sources == self._sources else 0
        self._function, self._sources = function, sources
        rising = function & ~before
        if not function & ENABLE:
            self.status = 0
        elif rising & ENABLE:
            self.status = ENABLE
        else:
            for edge, stored in _STORED.items():
                if rising & edge:
                    self.status &= ~stored
        self._arm()

    def _arm(self) -> None:
        """Register for the edges that are still to be stored."""
        wanted = 0
        for (edge, stored), source in zip(_STORED.items(), self._sources, strict=True):
            is_open = self._function & CONTINUOUS or not self.status & stored
            if self._function & ENABLE and self._function & edge and is_open:
                wanted |= source
        if wanted != self._edges:
            self._edges = wanted
            self._inputs.listen(f"touch probe {self.number}", wanted, self._take)

    def _take(self, edges: int, latches: Sequence[float]) -> None:
        for source, cell, stored, toggle in zip(self._sources, self._cells, _STORED.values(), _TOGGLES, strict=True):
            if edges & source & self._edges:
                cell.value = self._to_user(latches[source.bit_length() - 1])
                self.status = (self.status | stored) ^ toggle
        self._arm()


class TouchProbes:
    """Both probes of a drive, and their objects."""

    def __init__(self, dictionary: Dictionary, inputs: DigitalInputs, to_user: Callable[[float], int]) -> None:
        """Bind 60B8h, 60B9h and 60D0h."""
        self._dictionary = dictionary
        self._probes = first, second = tuple(TouchProbe(number, dictionary, inputs, to_user) for number in (1, 2))
        dictionary.on_write(Object.TOUCH_PROBE_FUNCTION, 0, self._write_function)
        dictionary.on_read(Object.TOUCH_PROBE_STATUS, 0, lambda: first.status | second.status << 8)
        for number in (1, 2):
            # 60D0h takes effect with the next 60B8h, so it is written first
            dictionary.on_write(
                Object.TOUCH_PROBE_SOURCE, number, lambda source: None if source in SOURCES else SdoAbortCode.INVALID_VALUE
            )

    def reset(self) -> None:
        """Apply 60B8h, after a reset."""
        self._set(self._dictionary.get_int(Object.TOUCH_PROBE_FUNCTION))

    def _write_function(self, value: int) -> SdoAbortCode | None:
        if any(value >> shift + SOURCE_SHIFT & 3 == RESERVED for shift in (0, 8)):
            return SdoAbortCode.INVALID_VALUE
        self._set(value)
        return None

    def _set(self, value: int) -> None:
        for probe in self._probes:
            function = value >> 8 * (probe.number - 1) & 0xFF
            match function >> SOURCE_SHIFT & 3:
                case 0:
                    sources = _PROBE[probe.number]
                case 1:
                    sources = SOURCES[5]
                case _:
                    source = self._dictionary.get_int(Object.TOUCH_PROBE_SOURCE, probe.number)
                    sources = SOURCES.get(source, _PROBE[probe.number])
            probe.set_function(function, sources)
