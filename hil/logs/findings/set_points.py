"""Findings on set-points."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.units import interpolation_period_s
from hil.counting import times
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of, stamps_of
from hil.logs.log import Stream
from hil.logs.nodes import WITH_SYNC, MappedNumber, Node, Pdo
from hil.logs.trace import FEW_FRACTION, LEAST_FRAMES, MISSING_FRACTION, MOVES_COUNTS, Rhythm, Trace

TARGETS = {0x607A: "target position", 0x60FF: "target velocity", 0x6071: "target torque", 0x60C1: "interpolation data"}
"""Set-points of the cyclic modes, by index."""
LATE = 0.25
"""Fraction of the period by which a frame may be off its usual place in the cycle."""
LATE_FRACTION = 0.002
SAME_PERIOD = 0.002
"""Relative difference of two periods that a rounded 60C2h does not explain."""
JUMP_RATIO = 8.0
"""A step is a jump where it differs from those around it by so many times what steps usually change."""
JUMP_COUNTS = 16
LONG = 1.5
"""Usual distances of set-points from which on one is missing in between."""


def set_point_findings(trace: Trace) -> Iterator[Said]:
    """Faults of the set-points of all nodes."""
    for node in trace.nodes.values():
        known = False
        for index, name in TARGETS.items():
            placed = node.pdo_with("rpdo", index, 1 if index == 0x60C1 else 0)
            if placed is not None and len(trace.of(placed[0])) >= LEAST_FRAMES:
                known = True
                yield from _of_one(trace, node, *placed, name)
        if not known and any(pdo.direction == "rpdo" and len(trace.log.of(pdo.can_id)) >= LEAST_FRAMES for pdo in node.pdos):
            yield Untold(
                "set-points", "its RPDO with the set-point is not known; give --description FILE:NODE, "
                "or a log that begins before the drive is set up", node.number,
            )  # fmt: skip


def _of_one(trace: Trace, node: Node, pdo: Pdo, entry: MappedNumber, name: str) -> Iterator[Said]:
    stream = trace.of(pdo)
    rhythm = trace.rhythm(stream)
    if rhythm is not None and trace.cycles is not None:
        yield from _against_sync(stream, rhythm, trace.cycles.period_ns, node, pdo, name)
    del rhythm  # of an hour it is large
    yield from _pace(trace, stream, node, name)
    if entry.address[0] in {0x607A, 0x60C1}:
        yield from _steps(trace, stream, entry.of(stream), node, name)


def _against_sync(stream: Stream, rhythm: Rhythm, period_ns: float, node: Node, pdo: Pdo, name: str) -> Iterator[Said]:
    place = picture_of(
        stream.stamp_ns * 1e-9,
        (rhythm.late_ns + rhythm.usual_ns) * 1e-6,
        ("time [s]", f"{name} of node {node.number} against SYNC [ms]"),
        (("SYNC", 0.0),),
    )
    cycles = rhythm.first + np.arange(len(rhythm.counts))
    empty, several = np.flatnonzero(rhythm.counts == 0), np.flatnonzero(rhythm.counts > 1)
    first = np.searchsorted(rhythm.cycle, cycles)
    if len(empty) > MISSING_FRACTION * len(cycles):
        rows = np.clip(first[empty], 0, len(stream) - 1)
        yield Finding(
            "set-points-missing", Severity.FAULT if len(empty) > FEW_FRACTION * len(cycles) else Severity.WARNING,
            f"no {name} for node {node.number} in {len(empty)} of {len(cycles)} cycles: the drive extrapolates or "
            f"stops there",
            "send one before every SYNC; check for a late sender, full transmit queues, and the bus load",
            stamps_of(stream.stamp_ns, rows), len(empty), node.number, place,
        )  # fmt: skip
    if len(several) > MISSING_FRACTION * len(cycles):
        rows = np.clip(first[several], 0, len(stream) - 1)
        yield Finding(
            "set-points-doubled", Severity.FAULT,
            f"two or more {name}s for node {node.number} in {len(several)} of {len(cycles)} cycles: all but the last are lost",
            "send one set-point per SYNC: a sender with its own clock drifts against SYNC, and two senders conflict",
            stamps_of(stream.stamp_ns, rows), len(several), node.number, place,
        )  # fmt: skip
    # the side of SYNC decides in which cycle a synchronous PDO acts
    side = np.sign(rhythm.usual_ns + rhythm.late_ns)
    across = np.flatnonzero((side != np.sign(np.median(side))) & (np.abs(rhythm.late_ns) < 0.5 * period_ns))
    is_synchronous = pdo.transmission_type is None or pdo.transmission_type in WITH_SYNC or pdo.transmission_type == 0
    if is_synchronous and len(across) > LATE_FRACTION * len(stream):
        yield Finding(
            "set-points-stale", Severity.FAULT,
            f"{len(across)} of {len(stream)} {name}s for node {node.number} arrive on the other side of SYNC than the rest; "
            f"they act a cycle "
            "later or earlier, and the drive repeats or skips one",
            "send them in the middle between two SYNCs, from the same clock",
            stamps_of(stream.stamp_ns, across), len(across), node.number, place,
        )  # fmt: skip
    late = np.flatnonzero(np.abs(rhythm.late_ns) > LATE * period_ns)
    if len(late) > LATE_FRACTION * len(stream):
        is_all = pdo.transmission_type in WITH_SYNC
        yield Finding(
            "set-points-late", Severity.NOTE if is_all else Severity.WARNING,
            f"{len(late)} of {len(stream)} {name}s for node {node.number} deviate from their place in the cycle by more than "
            f"{100 * LATE:.0f} % of it, by {np.max(np.abs(rhythm.late_ns)) * 1e-6:.3g} ms at worst"
            + ("" if is_all else "; they act on arrival, so the motion is equally late"),
            "give the sender real-time priority" + ("" if is_all else f", or make {pdo.name} synchronous (transmission type 1)"),
            stamps_of(stream.stamp_ns, late), len(late), node.number, place,
        )  # fmt: skip


def _pace(trace: Trace, stream: Stream, node: Node, name: str) -> Iterator[Said]:
    """Compare the period of set-points with 60C2h.

    If both differ, the drive waits, or never reaches the set-point in time.
    """
    value, index = node.value(0x60C2, 1), node.value(0x60C2, 2)
    if value is None or not value:
        if (0x60C2, 1) not in node.heard and node.description is None:
            yield Untold("beat", "60C2h is not in the log: the drive's own period is not known", node.number)
        return
    held_s = interpolation_period_s(value, -3 if index is None else index)
    sent_s = float(np.median(np.diff(stream.stamp_ns))) * 1e-9
    if not sent_s > 0.0:  # stamps coarser than a cycle
        return
    cycles = trace.cycles
    if cycles is not None and abs(cycles.period_ns * 1e-9 / sent_s - 1.0) < 0.2:
        sent_s = cycles.period_ns * 1e-9
    if abs(sent_s / held_s - 1.0) > max(SAME_PERIOD, 2e-6 / held_s):
        difference_hz = abs(1.0 / sent_s - 1.0 / held_s)
        step = picture_of(stream.stamp_ns[1:] * 1e-9, np.diff(stream.stamp_ns) * 1e-6,
            ("time [s]", f"interval between {name}s [ms]"), (("60C2h", held_s * 1e3),))  # fmt: skip
        effect = "stops for the rest of each cycle" if held_s < sent_s else "has not arrived when the next one comes"
        yield Finding(
            "set-point-beat", Severity.FAULT,
            f"a {name} for node {node.number} comes every {sent_s * 1e3:.4g} ms, and 60C2h is {held_s * 1e3:.4g} "
            f"ms: the motor {effect}. "
            f"That excites vibration at {1.0 / sent_s:.4g} Hz and at the beat frequency of {difference_hz:.3g} Hz",
            f"set 60C2h to {sent_s * 1e3:.4g} ms, or send every {held_s * 1e3:.4g} ms",
            stamps_of(stream.stamp_ns, np.array([0])), 1, node.number, step,
        )  # fmt: skip


def _steps(trace: Trace, stream: Stream, values: NDArray[np.int64], node: Node, name: str) -> Iterator[Said]:
    """Find repeats and jumps of a moving position from frame to frame."""
    step = np.diff(values).astype(np.float32)
    if len(step) < LEAST_FRAMES or not np.any(np.abs(step) >= MOVES_COUNTS):
        return
    time_s = stream.stamp_ns[1:] * 1e-9
    drawn = picture_of(time_s, step, ("time [s]", f"step of the {name} of node {node.number} [counts]"), is_line=True)
    del values
    around = np.minimum(np.abs(step[:-2]), np.abs(step[2:]))
    still = np.flatnonzero((step[1:-1] == 0.0) & (around >= MOVES_COUNTS) & (np.sign(step[:-2]) == np.sign(step[2:]))) + 1
    del around
    if len(still) > MISSING_FRACTION * len(step):
        yield Finding(
            "set-points-repeated", Severity.FAULT,
            f"{len(still)} {name}s of node {node.number} repeat the one before while the motor moves: the motor stops for a "
            f"cycle, then catches up",
            "calculate a new set-point for every cycle: a planner that is slower than the bus needs interpolation, or "
            "a longer period",
            stamps_of(stream.stamp_ns, still + 1), len(still), node.number, drawn,
        )  # fmt: skip
    change = np.diff(step)
    usual = float(np.percentile(np.abs(change), 99))
    there, back = np.abs(change[:-1]), np.abs(change[1:])
    is_large = (there > JUMP_RATIO * max(usual, 1.0)) & (there >= JUMP_COUNTS)
    pulse = np.flatnonzero(is_large & (change[1:] * change[:-1] < 0.0) & (back > 0.5 * there))
    pulse = pulse[~np.isin(pulse + 1, np.concatenate([still, still + 1, still - 1]))]
    distance = np.diff(stream.stamp_ns)  # over a cycle without a set-point the next step is longer
    pulse = pulse[distance[pulse + 1] < LONG * np.median(distance)]
    # a drive that is not enabled follows no set-point
    enabled = [trace.enabled_at(node, stream.stamp_ns[pulse + each]) for each in (2, 3)]
    pulse = pulse[np.any([each for each in enabled if each is not None], axis=0)] if enabled[0] is not None else pulse
    if len(pulse):
        worst = float(np.max(np.abs(change[pulse])))
        yield Finding(
            "set-point-jump", Severity.FAULT,
            f"the {name} of node {node.number} jumps {times(len(pulse))}, by up to {worst:.0f} counts; "
            f"other steps change by at most {usual:.0f}",
            "a jump of the position is a torque pulse; make the path continuous in position and speed, also where "
            "one path follows another",
            stamps_of(stream.stamp_ns, pulse + 2), len(pulse), node.number, drawn,
        )  # fmt: skip
