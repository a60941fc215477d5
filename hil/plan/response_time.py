"""Worst-case response times on CAN: fixed priorities without preemption."""

from collections.abc import Iterable
from dataclasses import dataclass

LIMIT_NS = 10_000_000_000
"""Longest busy period that is followed; a longer one counts as endless."""


@dataclass(frozen=True)
class Message:
    """A frame that is sent periodically, or at most so often.

    Attributes:
        priority: Identifier of the frame: the smaller one wins the bus.
        length_ns: C, the longest time on the wire, intermission included.
        period_ns: T, the shortest time between two instances.
        deadline_ns: D, counted from the same instant as the response time.
        jitter_ns: J, the largest delay with which it is queued.
        ahead_ns: Frames of the same sender that are queued with it and leave before it: a FIFO instead of priorities. Its
            `priority` is then the largest identifier of them all, since the first must win the bus for the last to go.
    """

    name: str
    priority: int
    length_ns: int
    period_ns: int
    deadline_ns: int
    jitter_ns: int = 0
    ahead_ns: int = 0

    @property
    def demand_ns(self) -> int:
        """Time on the bus that one period asks for."""
        return self.ahead_ns + self.length_ns


def response_ns(message: Message, others: Iterable[Message], bit_ns: int) -> int | None:
    """Return the worst-case response time R, or None.

    From the instant at which a message is due to the end of its frame; None if it grows without bound.
    With B = max C of the lower priorities (the frame that has just begun), hp the higher priorities and A the FIFO's part:

        t     = B + ⌈(t + J)/T⌉ (A + C) + Σ_hp ⌈(t + J_k)/T_k⌉ C_k             busy period
        Q     = ⌈(t + J)/T⌉                                                     instances in it
        w(q)  = B + A + q (A + C) + Σ_hp ⌈(w + J_k + τ)/T_k⌉ C_k,  q = 0 … Q − 1
        R     = max_q (J + w(q) − q T + C)

    τ is one bit: a frame that is queued in the first bit of another's arbitration still takes part in it. The analysis of
    1994 looked at q = 0 alone, wrongly: a second instance may be later, since its predecessor has delayed others.

    Source: R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted,
        revisited and revised", Real-Time Systems 35 (2007), 239-272; the FIFO's part simplified from Davis,
        Kollmann, Pollex, Slomka, ECRTS 2011, for frames that are all queued at once.
    """
    others = tuple(others)
    higher = [other for other in others if other.priority < message.priority]
    blocking = max((other.length_ns for other in others if other.priority >= message.priority), default=0)
    demand, period, jitter = message.demand_ns, message.period_ns, message.jitter_ns
    if demand / period + sum(other.demand_ns / other.period_ns for other in higher) >= 1.0:
        return None

    def interference(window: int) -> int:
        return sum(-(-(window + other.jitter_ns) // other.period_ns) * other.demand_ns for other in higher)

    busy, before = demand, -1
    while busy != before:
        before = busy
        busy = blocking + -(-(busy + jitter) // period) * demand + interference(busy)
        if busy > LIMIT_NS:
            return None
    longest = 0
    for instance in range(-(-(busy + jitter) // period)):
        start = blocking + message.ahead_ns + instance * demand
        window, before = start, -1
        while window != before:
            before, window = window, start + interference(window + bit_ns)
        longest = max(longest, jitter + window - instance * period + message.length_ns)
    return longest
