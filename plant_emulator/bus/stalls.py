"""The wall clock of a world, and the handling of stalls.

A process that gets no processor, or has too much to do, falls behind: deadlines of its nodes have passed, and the frames
that meet them are still unread. So a late world first processes the waiting frames, each at its arrival time, and then lets
the rest of the time pass. A stall is not the master's silence: of a stretch without frames only the first `SILENCE_NS` pass;
the rest is lost, as if the robot had been stopped. The loss is reported.
"""

import sys
from collections.abc import Callable, Sequence

LATE_NS = 5_000_000
"""A world that is further behind first processes the waiting frames. A turn of the servers takes 1 ms."""
SILENCE_NS = 50_000_000
"""Longest stretch without a frame that a late world makes up for; a longer one is reported."""
MADE_UP_NS = 500_000_000
"""Longest time that is made up for at once: a world too slow for its clock must not run after it for ever."""
SAY_AGAIN_NS = 1_000_000_000
"""Shortest time between two reports; each report doubles it, up to `QUIET_NS`: a busy machine must not bury what matters."""
QUIET_NS = 600_000_000_000
"""Longest time between two reports; after so long without a stall the next one is reported at once."""


def to_stderr(words: str) -> None:
    """Print a report on standard error."""
    print(words, file=sys.stderr, flush=True)  # noqa: T201 - what a served robot complains of


def made_up(begin_ns: int, end_ns: int, arrivals_ns: Sequence[int]) -> tuple[list[int], int]:
    """Return when a late world processes frames, and its end time.

    Args:
        end_ns: The wall's time, on the scale of the world's.
        arrivals_ns: Arrivals of the frames, in rising order; what lies before `begin_ns` or behind `end_ns` counts as these do.

    >>> made_up(0, 250_000_000, [40_000_000, 240_000_000])  # of the 200 ms in between 50 ms pass
    ([40000000, 90000000], 100000000)
    """
    now, before, last = begin_ns, begin_ns, begin_ns + MADE_UP_NS
    instants = []
    for arrival in (*arrivals_ns, end_ns):
        at = min(max(arrival, before), end_ns)
        now = min(now + min(at - before, SILENCE_NS), last)
        before = at
        instants.append(now)
    return instants[:-1], now


def spread(begin_ns: int, end_ns: int, count: int) -> list[int]:
    """Spread frames of known order evenly between begin and end.

    >>> spread(0, 90, 3)
    [30, 60, 90]
    """
    return [begin_ns + (end_ns - begin_ns) * number // count for number in range(1, count + 1)]


class WallTime:
    """The wall clock, on the scale of a world that follows it.

    Attributes:
        stalls: Number of times that the world was more than `SILENCE_NS` behind.
    """

    def __init__(self, now_ns: Callable[[], int], world_ns: int, say: Callable[[str], None] = to_stderr) -> None:
        """Begin now."""
        self.stalls = self.lost_ns = 0
        self._now_ns, self._say = now_ns, say
        self._say_at_ns, self._pause_ns, self._last_ns = now_ns(), SAY_AGAIN_NS, now_ns()
        self._unsaid: list[tuple[int, int]] = []  # behind, lost
        self.begin(world_ns)

    def begin(self, world_ns: int) -> None:
        """Follow the clock from the world's present time on."""
        self._epoch_ns = self._now_ns() - world_ns

    def __call__(self) -> int:
        """Return the time that the world would have without delay."""
        return self._now_ns() - self._epoch_ns

    def catch_up(self, begin_ns: int, end_ns: int, arrivals_ns: Sequence[int], *, is_used: bool = True) -> tuple[list[int], int]:
        """Return the instants of `made_up`, and drop the lost time.

        Stalls are reported if somebody uses the world, ever more rarely while they go on.
        """
        instants, reached = made_up(begin_ns, end_ns, arrivals_ns)
        lost = end_ns - reached
        self._epoch_ns += lost
        if is_used and end_ns - begin_ns > SILENCE_NS:
            self._note(end_ns - begin_ns, lost)
        return instants, reached

    def _note(self, behind_ns: int, lost_ns: int) -> None:
        now = self._now_ns()
        self.stalls += 1
        self.lost_ns += lost_ns
        self._unsaid.append((behind_ns, lost_ns))
        if now - self._last_ns >= QUIET_NS:
            self._say_at_ns, self._pause_ns = now, SAY_AGAIN_NS
        self._last_ns = now
        if now < self._say_at_ns:
            return
        behind, lost = (1e-6 * sum(each) for each in zip(*self._unsaid, strict=True))
        stalls = "" if len(self._unsaid) == 1 else f" in {len(self._unsaid)} stalls"
        self._say(
            f"the emulator was {behind:.0f} ms late and skipped {lost:.0f} ms{stalls}; "
            "it first processed the frames that had arrived"
        )
        self._unsaid.clear()
        self._say_at_ns, self._pause_ns = now + self._pause_ns, min(2 * self._pause_ns, QUIET_NS)
