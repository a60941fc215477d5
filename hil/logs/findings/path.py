"""Findings on the path of the set-points.

It should remain within the drive's limits, be fine enough, and have no jumps of acceleration.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil.counting import counted, times
from hil.logs.findings.finding import Finding, Said, Severity, picture_of, stamps_of
from hil.logs.nodes import Node
from hil.logs.trace import LEAST_FRAMES, MOVES_COUNTS, Trace

COARSE = 4
"""Counts of which positions are multiples, from which on they are said to be coarse."""
RESTLESS = 0.2
"""Part of the changes of the step that must undo the one before: a constant acceleration may have a common divisor too."""
BLOW, LEAST_BLOW = 0.9, 16.0
"""Part of the acceleration before and behind by which it changes within one cycle, and counts per cycle², for a blow."""
STEADY = 0.3
"""Part of that change by which it may change in the cycles before and behind."""
LEAST_BLOWS = 2
UNLIMITED = 0xFFFFFFFF
NEAR_WINDOW = 0.9
"""Part of 6065h from which on a following error is about to stop the drive."""
SECONDS_PER_MINUTE = 60.0


def path_findings(trace: Trace) -> Iterator[Said]:
    """Faults of the paths of all nodes."""
    for node in trace.nodes.values():
        placed = node.pdo_with("rpdo", 0x607A)
        if placed is None:
            continue
        stream = trace.of(placed[0])
        if len(stream) < LEAST_FRAMES:
            continue
        target = placed[1].of(stream)
        yield from _limits(trace, node, stream.stamp_ns, target)
        yield from _coarse(stream.stamp_ns, target, node, "target position", "0x607A")
        yield from _blows(stream.stamp_ns, target, node)
        measured = node.pdo_with("tpdo", 0x6064)
        if measured is not None:
            answers = trace.of(measured[0])
            yield from _coarse(answers.stamp_ns, measured[1].of(answers), node, "measured position", "0x6064")


def _signed(value: int | None) -> int | None:
    """A number of 32 bits with its sign."""
    return None if value is None else (value + (1 << 31)) % (1 << 32) - (1 << 31)


def _limits(trace: Trace, node: Node, stamp_ns: NDArray[np.int64], target: NDArray[np.int64]) -> Iterator[Said]:
    low, high = _signed(node.value(0x607D, 1)), _signed(node.value(0x607D, 2))
    if low is not None and high is not None and low < high:
        beyond = np.flatnonzero((target < low) | (target > high))
        if len(beyond):
            yield Finding(
                "beyond-limits", Severity.FAULT,
                f"{len(beyond)} target positions of node {node.number} are beyond its software limits of {low} to {high} counts "
                "(607Dh): the drive stops at them, or faults",
                "plan a path within the limits, or widen them if the robot allows it",
                stamps_of(stamp_ns, beyond), len(beyond), node.number,
                picture_of(stamp_ns * 1e-9, target.astype(float), ("time [s]", f"target position of node {node.number} [counts]"),
                    (("607Dh:1", float(low)), ("607Dh:2", float(high))), is_line=True),
            )  # fmt: skip
    most, increments, turns = node.value(0x6080), node.value(0x608F, 1), node.value(0x608F, 2)
    cycles = trace.cycles
    if most and increments and turns and cycles is not None:
        allowed = most / SECONDS_PER_MINUTE * increments / turns * cycles.period_ns * 1e-9
        step = np.diff(target)
        is_even = np.diff(stamp_ns) < 1.5 * cycles.period_ns  # over a missing set-point the next step is longer
        fast = np.flatnonzero((np.abs(step) > allowed + 1.0) & is_even)
        enabled = trace.enabled_at(node, stamp_ns[fast + 1])
        fast = fast if enabled is None else fast[enabled]
        if len(fast) >= LEAST_FRAMES:
            yield Finding(
                "too-fast", Severity.FAULT,
                f"the target position of node {node.number} moves at up to {np.max(np.abs(step[fast])) / allowed * most:.0f} "
                f"rev/min in {counted(len(fast), 'cycle')}, and 6080h allows {most}; the motor falls behind",
                "plan a slower path, or raise the limit if motor and gear allow it",
                stamps_of(stamp_ns, fast), len(fast), node.number,
            )  # fmt: skip
    window, placed = node.value(0x6065), node.pdo_with("tpdo", 0x60F4)
    if window and window != UNLIMITED and placed is not None:
        stream = trace.of(placed[0])
        error = placed[1].of(stream)
        near = np.flatnonzero(np.abs(error) > NEAR_WINDOW * window)
        if len(near):
            yield Finding(
                "following-error-near-limit", Severity.WARNING,
                f"the following error of node {node.number} reaches {np.max(np.abs(error))} of the {window} counts at which the "
                "drive stops (6065h)",
                "add speed feed-forward, accelerate less, raise the gains, or widen the window if the machine allows it",
                stamps_of(stream.stamp_ns, near), len(near), node.number,
            )  # fmt: skip


def _coarse(stamp_ns: NDArray[np.int64], position: NDArray[np.int64], node: Node, name: str, key: str) -> Iterator[Said]:
    """Positions that are multiples of more than one count."""
    step = np.diff(position)
    moving = step[np.abs(step) >= MOVES_COUNTS]
    if len(moving) < 5 * LEAST_FRAMES:
        return
    grain = int(np.gcd.reduce(step))
    if grain < COARSE:
        return
    changes = np.diff(step)
    changes = np.sign(changes[changes != 0])
    if len(changes) < LEAST_FRAMES or np.count_nonzero(changes[1:] != changes[:-1]) < RESTLESS * len(changes):
        return
    is_target = key == "0x607A"
    yield Finding(
        "coarse-set-points" if is_target else "coarse-encoder", Severity.WARNING,
        f"every {name} of node {node.number} is a multiple of {grain} counts away from the first; the speed then has "
        f"steps of {grain} counts per cycle, which cause noise and excite resonances",
        "let the planner calculate with a finer resolution than the encoder's" if is_target
        else "filter the measured speed, or lower the speed gain: the encoder has fewer steps than 608Fh says",
        stamps_of(stamp_ns, np.array([0])), 1, node.number,
        picture_of(stamp_ns[1:] * 1e-9, step.astype(float), ("time [s]", f"step of the {name} of node {node.number} [counts]")),
    )  # fmt: skip


def _blows(stamp_ns: NDArray[np.int64], target: NDArray[np.int64], node: Node) -> Iterator[Said]:
    """Find jumps of acceleration from one cycle to the next."""
    acceleration = np.diff(target, 2).astype(np.float32)
    held = np.float32(0.5) * (acceleration[1:] + acceleration[:-1])
    if len(held) < LEAST_FRAMES:
        return
    long_before, before, after, long_after = held[:-6], held[2:-4], held[4:-2], held[6:]
    change = np.abs(after - before)
    # of a jump of the position, or a set-point that was lost, each change is undone at once: acceleration does not stay
    stays = np.abs(after - long_after) + np.abs(before - long_before) < STEADY * change
    most = np.maximum(np.abs(before), np.abs(after))
    blow = np.flatnonzero((change >= BLOW * most) & (change >= LEAST_BLOW) & stays)
    blow = blow[np.diff(blow, prepend=-10) > 3]
    if len(blow) < LEAST_BLOWS:
        return
    yield Finding(
        "acceleration-jump", Severity.WARNING,
        f"the acceleration of node {node.number}'s target position jumps {times(len(blow))} within one cycle, by "
        f"{float(np.max(change[blow])):.0f} counts per cycle² at worst; each jump excites every resonance of the arm",
        "limit the jerk: let the acceleration change over at least one period of the lowest resonance",
        stamps_of(stamp_ns, blow + 4), len(blow), node.number,
        picture_of(stamp_ns[2:] * 1e-9, acceleration,
            ("time [s]", f"acceleration of node {node.number}'s target [counts/cycle²]"), is_line=True),
    )  # fmt: skip
