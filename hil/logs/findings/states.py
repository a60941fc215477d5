"""Findings on states of drives and nodes.

Source: CiA 402-2, 6040h, 6041h, 6060h, 6061h; CiA 301, 7.2.8.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.cia301 import FunctionCode, NmtCommand
from drive_profiles.standard.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, INTERNAL_LIMIT, Mode, State, state_of
from hil.counting import counted, times
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of, stamps_of
from hil.logs.log import Stream
from hil.logs.nodes import Node
from hil.logs.trace import LEAST_FRAMES, Trace

CYCLIC = {Mode.CSP, Mode.CSV, Mode.CST}
SETTLING = 50
"""Cycles after which a drive that was just enabled must follow."""
AT_LIMIT = 0.999
"""Fraction of a limit from which on the torque is at it."""


def state_findings(trace: Trace) -> Iterator[Said]:
    """Find states that end, active limits, and badly timed NMT commands."""
    yield from _commands(trace)
    for node in trace.nodes.values():
        placed = node.pdo_with("tpdo", 0x6041)
        if placed is None:
            if any(
                pdo.direction == "tpdo" and len(trace.log.of(pdo.can_id)) >= LEAST_FRAMES and not pdo.entries for pdo in node.pdos
            ):
                yield Untold(
                    "state", "its TPDO with the status word is not known; give --description FILE:NODE, or a log that begins "
                    "before the drive is set up", node.number,
                )  # fmt: skip
            continue
        stream = trace.of(placed[0])
        if len(stream):
            yield from _of_drive(trace, node, stream, placed[1].of(stream))


def _of_drive(trace: Trace, node: Node, stream: Stream, words: NDArray[np.int64]) -> Iterator[Said]:
    table = np.array([-1 if (state := state_of(word)) is None else list(State).index(state) for word in range(0x80)])
    states = table[words & 0x7F]
    enabled = states == list(State).index(State.OPERATION_ENABLED)
    ends = np.flatnonzero(enabled[:-1] & ~enabled[1:]) + 1
    faults = {list(State).index(State.FAULT), list(State).index(State.FAULT_REACTION_ACTIVE)}
    fell = [row for row in ends if states[row] in faults]
    if fell:
        yield Finding(
            "drive-fault", Severity.FAULT,
            f"the drive of node {node.number} falls from operation enabled into fault {times(len(fell))}",
            "read its emergency message or 603Fh, which names the cause",
            stamps_of(stream.stamp_ns, np.array(fell)), len(fell), node.number,
        )  # fmt: skip
    stopped = [row for row in ends if states[row] == list(State).index(State.QUICK_STOP_ACTIVE)]
    if stopped:
        yield Finding(
            "quick-stop", Severity.WARNING, f"the drive of node {node.number} makes {counted(len(stopped), 'quick stop')}",
            "check bit 2 of 6040h (0 commands a quick stop), the limit switches and the heartbeat",
            stamps_of(stream.stamp_ns, np.array(stopped)),
            len(stopped), node.number,
        )  # fmt: skip
    limited = np.flatnonzero(enabled & (words & INTERNAL_LIMIT != 0))
    if len(limited):
        yield Finding(
            "internal-limit", Severity.WARNING,
            f"the drive of node {node.number} reports an active limit in {counted(len(limited), 'frame')} (6041h bit 11)",
            "compare the commands with the drive's limits 607Dh, 607Fh, 6080h and 6072h",
            stamps_of(stream.stamp_ns, limited), len(limited), node.number,
        )  # fmt: skip
    mode = node.value(0x6060)
    since = np.arange(len(enabled)) - np.maximum.accumulate(np.where(~enabled, np.arange(len(enabled)), -SETTLING))
    if mode in CYCLIC:
        left = np.flatnonzero(enabled & (since > SETTLING) & (words & FOLLOWS_COMMAND == 0))
        if len(left):
            yield Finding(
                "not-following", Severity.WARNING,
                f"the drive of node {node.number} is enabled and does not follow its set-points in {counted(len(left), 'frame')} "
                f"(6041h bit 12)",
                "check for a halt (6040h bit 8), a mode that ends (6061h), and missing set-points",
                stamps_of(stream.stamp_ns, left), len(left), node.number,
            )  # fmt: skip
        behind = np.flatnonzero(enabled & (words & FOLLOWING_ERROR != 0))
        if mode == Mode.CSP and len(behind):
            yield Finding(
                "following-error", Severity.WARNING,
                f"the drive of node {node.number} reports a following error in {counted(len(behind), 'frame')} (6041h bit 13)",
                "compare 6065h with gains, feed-forward and acceleration",
                stamps_of(stream.stamp_ns, behind), len(behind), node.number,
            )  # fmt: skip
    yield from _torque(trace, node)


def _torque(trace: Trace, node: Node) -> Iterator[Said]:
    limit, placed = node.value(0x6072), node.pdo_with("tpdo", 0x6077)
    if placed is None or not limit:
        return
    stream = trace.of(placed[0])
    torque = placed[1].of(stream)
    full = np.flatnonzero(np.abs(torque) >= AT_LIMIT * limit)
    if len(full) > 1:
        yield Finding(
            "torque-saturated", Severity.FAULT,
            f"the torque of node {node.number} is at its limit of {limit} ‰ (6072h) in {counted(len(full), 'frame')}: the loop "
            f"is open there",
            "accelerate less, reduce the load, or raise the limit if the motor allows it; an integrator winds up meanwhile",
            stamps_of(stream.stamp_ns, full), len(full), node.number,
            picture_of(stream.stamp_ns * 1e-9, torque.astype(float), ("time [s]", f"torque of node {node.number} [‰]"),
                (("6072h", float(limit)), ("−6072h", -float(limit)))),
        )  # fmt: skip


def _commands(trace: Trace) -> Iterator[Said]:
    """Find NMT commands that stop process data in use."""
    stream = trace.log.of(FunctionCode.NMT)
    if trace.cycles is None or not len(stream):
        return
    begin, end = int(trace.cycles.stamp_ns[0]), int(trace.cycles.stamp_ns[-1])
    commands = stream.byte(0)
    taking = {NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION}
    rows = np.flatnonzero(np.isin(commands, list(taking)) & (stream.stamp_ns > begin) & (stream.stamp_ns < end))
    enabled = [each for node in trace.nodes.values() if (each := trace.enabled_at(node, stream.stamp_ns[rows])) is not None]
    rows = rows[np.any(enabled, axis=0)] if enabled else rows[:0]
    if len(rows):
        names = ", ".join(sorted({NmtCommand(int(commands[row])).name.lower().replace("_", " ") for row in rows}))
        yield Finding(
            "nmt-while-working", Severity.FAULT,
            f"NMT commands ({names}) come while a drive is enabled, {times(len(rows))}",
            "disable drives first; check for a second master, or a program that ends without disabling them",
            stamps_of(stream.stamp_ns, rows), len(rows),
        )  # fmt: skip
