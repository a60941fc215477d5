"""Node guarding and life guarding by polls (CiA 301, 7.2.8.2.2.1 and 7.2.8.2.2.2)."""

from collections.abc import Callable

from plant_emulator.slave.dictionary import Dictionary

GUARD_TIME, LIFE_TIME_FACTOR = 0x100C, 0x100D
_NS_PER_MS = 1_000_000
_TOGGLE = 0x80


class NodeGuarding:
    """Answers to the NMT master's remote requests, and their supervision.

    Life guarding begins with the first request: a node without a guard misses no requests. It is in use while neither 100Ch nor
    100Dh is 0; after a change of either it waits for a first request again.

    Args:
        dictionary: Must have 100Ch and 100Dh.
        on_lost: Called once when no request has come for guard time × life time factor.
        on_found: Called when one comes again, or when none is expected any more.

    Attributes:
        due: End of the life time in ns, or None.
    """

    def __init__(self, dictionary: Dictionary, on_lost: Callable[[], None], on_found: Callable[[], None]) -> None:
        self.due: int | None = None
        self._on_lost, self._on_found, self._dictionary = on_lost, on_found, dictionary
        self._times = {GUARD_TIME: 0, LIFE_TIME_FACTOR: 0}
        self._life_time = 0
        self._toggle = 0
        self._is_lost = False
        dictionary.on_write(GUARD_TIME, 0, lambda time_ms: self._set(GUARD_TIME, time_ms))
        dictionary.on_write(LIFE_TIME_FACTOR, 0, lambda factor: self._set(LIFE_TIME_FACTOR, factor))

    def load(self) -> None:
        """Read the times after a reset; the next toggle bit is 0."""
        self._toggle = 0
        for index in self._times:
            self._set(index, self._dictionary.get_int(index))

    def stop(self) -> None:
        """Expect no request until the next one comes."""
        self.due = None
        if self._is_lost:
            self._is_lost = False
            self._on_found()

    def answer(self, state: int, now: int) -> bytes:
        """Return the answer: the NMT state and a bit that alternates."""
        if self._life_time:
            self.due = now + self._life_time
        if self._is_lost:
            self._is_lost = False
            self._on_found()
        data = bytes((self._toggle | state,))
        self._toggle ^= _TOGGLE
        return data

    def advance(self, now: int) -> None:
        """Report the master as lost if its requests are overdue."""
        if self.due is not None and now >= self.due:
            self.due = None
            self._is_lost = True
            self._on_lost()

    def _set(self, index: int, value: int) -> None:
        self._times[index] = value
        self._life_time = self._times[GUARD_TIME] * self._times[LIFE_TIME_FACTOR] * _NS_PER_MS
        self.stop()
