"""Findings on frames that nodes send."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from drive_profiles.device.target import fault_texts_of
from drive_profiles.standard.cia301 import EmergencyCode, FunctionCode, NmtState, abort_text
from drive_profiles.standard.error_codes import error_text
from drive_profiles.standard.object_address import address_text
from hil.counting import counted, times
from hil.logs.findings.finding import MOST_STAMPS, Finding, Said, Severity, picture_of, stamps_of
from hil.logs.nodes import WITH_SYNC, Node, Pdo
from hil.logs.overheard import AbortedTransfer, OverlappingRequest, UnansweredRequest
from hil.logs.trace import FEW_FRACTION, LEAST_FRAMES, MISSING_FRACTION, MOVES_COUNTS, Trace

TWO_SENDERS, LEAST_DOUBLES = 1.05, 3
"""Frames per cycle from which on a PDO with SYNC has more than one sender."""
FROZEN_CYCLES = 3
"""Equal positions in a row of a motor that turned before and behind: an encoder counts on in between."""
HEARTBEATS = 2.5
"""Usual distances after which a heartbeat is missing."""


def answer_findings(trace: Trace) -> Iterator[Said]:
    """Faults of the nodes' process data and heartbeats."""
    for node in trace.nodes.values():
        for pdo in node.pdos:
            if pdo.direction == "tpdo":
                yield from _process_data(trace, node, pdo)
        yield from _heartbeats(trace, node)


def node_findings(trace: Trace) -> Iterator[Said]:
    """Emergencies, and faults of SDO transfers."""
    for node in trace.nodes.values():
        yield from _emergencies(trace, node)
    yield from _transfers(trace)


def _process_data(trace: Trace, node: Node, pdo: Pdo) -> Iterator[Said]:
    stream, cycles = trace.of(pdo), trace.cycles
    rhythm = trace.rhythm(stream)
    is_synchronous = pdo.transmission_type == 1 if pdo.transmission_type is not None else False
    if rhythm is not None and cycles is not None and (is_synchronous or 0.95 < len(stream) / len(rhythm.counts) < 1.2):
        gone = np.flatnonzero(rhythm.counts == 0)
        if len(gone) > MISSING_FRACTION * len(rhythm.counts):
            rows = np.clip(np.searchsorted(rhythm.cycle, rhythm.first + gone), 0, len(stream) - 1)
            yield Finding(
                "answers-missing", Severity.FAULT if len(gone) > FEW_FRACTION * len(rhythm.counts) else Severity.WARNING,
                f"{pdo.name} is missing or late in {len(gone)} of {len(rhythm.counts)} cycles",
                "check the bus load first, then whether the node is too slow for the period or the receiver loses frames",
                stamps_of(stream.stamp_ns, rows), len(gone), node.number,
                picture_of(stream.stamp_ns * 1e-9, rhythm.late_ns * 1e-6, ("time [s]", "off its place by [ms]")),
            )  # fmt: skip
        # behind a late one the next comes in the same cycle: that is one node
        twice = np.flatnonzero((rhythm.counts > 1) & (np.concatenate([[1], rhythm.counts[:-1]]) > 0))
        if (
            len(twice) >= LEAST_DOUBLES
            and len(stream) > TWO_SENDERS * len(rhythm.counts)
            and pdo.transmission_type in (None, *WITH_SYNC)
        ):
            rows = np.clip(np.searchsorted(rhythm.cycle, rhythm.first + twice), 0, len(stream) - 1)
            yield Finding(
                "two-nodes", Severity.FAULT,
                f"{pdo.name} comes twice in {len(twice)} of {len(rhythm.counts)} cycles: two nodes have the node-ID "
                f"{node.number}, or one "
                "identifier is used twice",
                "give each node an ID of its own, and disconnect one of them to see which is which",
                stamps_of(stream.stamp_ns, rows), len(twice), node.number,
            )  # fmt: skip
    entry = pdo.entry(0x6064)
    if entry is not None and len(stream) >= LEAST_FRAMES:
        position = entry.of(stream)
        step = np.diff(position)
        still = np.concatenate([[0], np.cumsum(step == 0)])
        runs = still[FROZEN_CYCLES:] - still[:-FROZEN_CYCLES] == FROZEN_CYCLES
        moving = np.abs(step) >= MOVES_COUNTS
        begin = np.flatnonzero(runs[1:] & ~runs[:-1] & moving[: len(runs) - 1]) + 1
        jump = [
            row
            for row in begin
            if np.any(np.abs(step[row : row + 20 * FROZEN_CYCLES]) > FROZEN_CYCLES * max(1, abs(int(step[row - 1]))))
        ]
        if jump:
            yield Finding(
                "answers-old", Severity.FAULT,
                f"the position in {pdo.name} stays the same {times(len(jump))} while the motor turns, then jumps: "
                f"the PDO carries old values",
                "set a transmission type with SYNC (1), an inhibit time of 0, and no event timer slower than the loop",
                stamps_of(stream.stamp_ns, np.array(jump)), len(jump), node.number,
                picture_of(stream.stamp_ns * 1e-9, position.astype(float),
                    ("time [s]", f"position of node {node.number} [counts]"), is_line=True),
            )  # fmt: skip


def _heartbeats(trace: Trace, node: Node) -> Iterator[Said]:
    stream = trace.log.of(FunctionCode.HEARTBEAT + node.number)
    states = stream.byte(0) & 0x7F
    boots = np.flatnonzero((states == NmtState.INITIALISING) & (stream.length == 1))
    late_boots = boots[boots > 0]
    worked = [row for row in late_boots if states[row - 1] == NmtState.OPERATIONAL]
    if worked:
        yield Finding(
            "node-restarted", Severity.FAULT,
            f"node {node.number} restarts {times(len(worked))} although it was operational",
            "check supply and watchdog, and look for a reset by NMT in the frames before the restart",
            stamps_of(stream.stamp_ns, np.array(worked)), len(worked), node.number,
        )  # fmt: skip
    gaps = np.diff(stream.stamp_ns)
    held = node.value(0x1017)
    if len(gaps) < (LEAST_FRAMES if not held else 2):
        return
    usual = float(np.median(gaps)) if not held else held * 1e6
    lost = np.flatnonzero(gaps > HEARTBEATS * usual)
    if len(lost):
        yield Finding(
            "heartbeat-lost", Severity.FAULT,
            f"node {node.number} was silent {times(len(lost))} for {np.max(gaps) * 1e-6:.0f} ms at worst; "
            f"otherwise its heartbeat comes every {usual * 1e-6:.0f} ms",
            "check the error frames and the node's next frames: the node hung, or the bus was off",
            stamps_of(stream.stamp_ns, lost), len(lost), node.number,
        )  # fmt: skip
    double = np.flatnonzero((gaps < 0.6 * usual) & (states[1:] == states[:-1]))
    if len(double) > 0.3 * len(gaps):
        yield Finding(
            "two-nodes", Severity.FAULT,
            f"a heartbeat of node {node.number} comes less than {0.6 * usual * 1e-6:.3g} ms after the one before, "
            f"{times(len(double))}: two nodes have the node-ID {node.number}",
            "give each node an ID of its own, and disconnect one of them to see which is which",
            stamps_of(stream.stamp_ns, double), len(double), node.number,
        )  # fmt: skip


def _emergencies(trace: Trace, node: Node) -> Iterator[Said]:
    stream = trace.log.of(FunctionCode.EMERGENCY + node.number)
    codes = stream.byte(0).astype(int) | stream.byte(1).astype(int) << 8
    rows = np.flatnonzero((codes != EmergencyCode.NO_ERROR) & (stream.length >= 3))
    if not len(rows):
        return
    by_code = Counter(codes[rows].tolist())
    own = fault_texts_of(*(node.value(0x1018, subindex) for subindex in (1, 2, 3)))
    said = "; ".join(f"{code:04X}h {count} ×: {error_text(code, own)}" for code, count in by_code.most_common(MOST_STAMPS))
    yield Finding(
        "emergency", Severity.FAULT, f"node {node.number} sends {counted(len(rows), 'emergency', 'emergencies')}: {said}",
        "find the cause of the first of them; later ones often follow from it",
        stamps_of(stream.stamp_ns, rows), len(rows), node.number,
    )  # fmt: skip


def _transfers(trace: Trace) -> Iterator[Said]:
    for number in trace.nodes:
        refusals = [event for event in trace.events if isinstance(event, AbortedTransfer) and event.node == number]
        if refusals:
            by_code = Counter((event.address, event.code) for event in refusals)
            said = "; ".join(
                f"{address_text(address)} {count} ×: {abort_text(code)}"
                for (address, code), count in by_code.most_common(MOST_STAMPS)
            )
            yield Finding(
                "sdo-aborts", Severity.WARNING, f"node {number} refuses {counted(len(refusals), 'SDO transfer')}: {said}",
                "compare the object with the device's EDS: access, type, range, and the state in which it may be written",
                tuple(event.stamp_ns * 1e-9 for event in refusals[:MOST_STAMPS]), len(refusals), number,
            )  # fmt: skip
    asked: dict[int, list[UnansweredRequest]] = {}
    for event in trace.events:
        if isinstance(event, UnansweredRequest):
            asked.setdefault(event.node, []).append(event)
    for number, requests in asked.items():
        if number not in trace.nodes:
            continue  # a scan asks everybody
        yield Finding(
            "sdo-unanswered", Severity.WARNING, f"node {number} does not answer {counted(len(requests), 'SDO request')}",
            "check whether the node restarts, the SDO client waits too short a time, or frames are lost",
            tuple(event.stamp_ns * 1e-9 for event in requests[:MOST_STAMPS]), len(requests), number,
        )  # fmt: skip
    overlaps = [event for event in trace.events if isinstance(event, OverlappingRequest)]
    if overlaps:
        yield Finding(
            "two-masters", Severity.FAULT,
            f"an SDO request begins while another to the same node is open, {times(len(overlaps))}: two clients use one channel",
            "let only one program access a node by SDO: close configuration tools while a controller runs",
            tuple(event.stamp_ns * 1e-9 for event in overlaps[:MOST_STAMPS]), len(overlaps), overlaps[0].node,
        )  # fmt: skip
