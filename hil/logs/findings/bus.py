"""Findings on the bus itself."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drive_profiles.address import BIT_RATES
from drive_profiles.standard.cia301 import RPDO_BASES, FunctionCode
from hil.can.bits import NOMINAL_BITS
from hil.can.errors_frame import decode
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from hil.counting import counted, times
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of, stamps_of
from hil.logs.trace import LEAST_FRAMES, Trace

BUSY, CROWDED = 0.6, 0.85
"""Loads in a tenth of a second from which on a bus is said to be full: frames wait for each other."""
WINDOW_NS = 100_000_000
EXTENDED_BITS = 20
"""Bits that an identifier of 29 bits adds to a frame."""
STUFFED = 1.1
"""Bits of an average frame on the wire to those without stuff bits."""
MOST_SPEAKERS = 4
IMPOSSIBLE = 1.15
"""Load from which on the bit rate cannot be the bus': stuff bits are estimated."""
TOLERANT = 1.02
"""Load that a bit rate may show at most: stuff bits are estimated."""


def bus_findings(trace: Trace, bitrate: int | None) -> Iterator[Said]:
    """Damage, load and error frames of a bus."""
    yield from _damage(trace)
    yield from _load(trace, bitrate)
    yield from _error_frames(trace)


def _damage(trace: Trace) -> Iterator[Said]:
    damage = trace.log.damage
    if damage.unreadable:
        yield Finding(
            "log-damaged", Severity.NOTE,
            f"lines without a frame: {damage.unreadable}, the first is line {damage.first_unreadable}; they are left out",
            "record the log again: it was cut or mixed while written, and missing lines look like frames that were not sent",
            (), damage.unreadable,
        )  # fmt: skip
    if damage.ended:
        yield Finding("log-damaged", Severity.NOTE, f"the log is cut off: {damage.ended}", "the part before is judged")
    if damage.backwards:
        row = damage.first_backwards
        yield Finding(
            "log-backwards", Severity.WARNING,
            f"stamps decrease {times(damage.backwards)}, first at frame {row + 1}: rhythms are uncertain around them",
            "log one adapter with its own time stamps: two adapters share the log, or the clock was set",
            (), damage.backwards,
        )  # fmt: skip
    if damage.elsewhere:
        yield Untold(
            "other-interfaces",
            f"{damage.elsewhere} frames are from other interfaces than the first, and left out; --interface NAME reads them",
        )
    if damage.flexible:
        yield Finding(
            "can-fd", Severity.NOTE, f"{damage.flexible} frames are CAN FD, and left out", "classic CANopen has no such frames"
        )


def likely_bits(can_id: NDArray[np.uint32] | int, octets: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Bits of frames on the wire with the usual stuff bits, 0 for error messages; shape (n,) as the numbers of data bytes."""
    is_frame, is_long = np.bitwise_and(can_id, CAN_ERR_FLAG) == 0, np.bitwise_and(can_id, CAN_EFF_FLAG) != 0
    sent = np.where(np.bitwise_and(can_id, CAN_RTR_FLAG), 0, octets)
    return np.asarray(is_frame * STUFFED * (NOMINAL_BITS + EXTENDED_BITS * is_long + 8.0 * sent))


def _bits(trace: Trace) -> NDArray[np.float64]:
    """Bits on the wire in each window."""
    windows = trace.log.duration_ns // WINDOW_NS + 1
    bits = np.zeros(windows)
    for can_id, stream in trace.log.streams.items():
        bits += np.bincount(stream.stamp_ns // WINDOW_NS, weights=likely_bits(can_id, stream.length), minlength=windows)
    return bits[:-1]


def _load(trace: Trace, bitrate: int | None) -> Iterator[Said]:
    log = trace.log
    if log.duration_s < 2e-9 * WINDOW_NS:
        yield Untold("bus-load", f"the log lasts {1e3 * log.duration_s:.3g} ms: too short to calculate the bus load")
        return
    bits = _bits(trace)
    commanded = [stream for base in RPDO_BASES for stream in log.near(base) if len(stream) >= LEAST_FRAMES]
    if commanded:  # set-up may fill a bus as it likes: what counts is the time in which something is commanded
        begin = min(int(stream.stamp_ns[0]) for stream in commanded) // WINDOW_NS + 1
        end = max(int(stream.stamp_ns[-1]) for stream in commanded) // WINDOW_NS
        bits[:begin], bits[end:] = 0.0, 0.0
    peak = float(np.max(bits)) / (WINDOW_NS * 1e-9)
    if bitrate is None:
        least = min((rate for rate in BIT_RATES if peak <= TOLERANT * rate), default=BIT_RATES[-1])
        yield Untold("bus-load", f"a log does not contain the bit rate; the frames need up to {peak / 1e3:.0f} kbit/s, so it is "
            f"{least // 1000} kbit/s or more; give --bitrate")  # fmt: skip
        return
    load = bits / (WINDOW_NS * 1e-9) / bitrate
    if peak <= BUSY * bitrate:
        return
    if peak > IMPOSSIBLE * bitrate:
        yield Untold("bus-load", f"{peak / 1e3:.0f} kbit/s in a tenth of a second do not fit on a bus of "
            f"{bitrate // 1000} kbit/s; the bit rate is wrong, or the stamps are not those of the ends of frames")  # fmt: skip
        return
    counts = sorted(((can_id, len(stream)) for can_id, stream in log.streams.items()), key=lambda each: -each[1])[:MOST_SPEAKERS]
    names = ", ".join(f"{can_id & 0x1FFFFFFF:03X}h {100.0 * count / len(log):.0f} %" for can_id, count in counts)
    worst = int(np.argmax(load))
    yield Finding(
        "bus-load", Severity.FAULT if peak > CROWDED * bitrate else Severity.WARNING,
        f"the bus load is {100.0 * peak / bitrate:.0f} % in the worst tenth of a second, "
        f"{100.0 * float(np.mean(load[load > 0.0])):.0f} % on average; "
        f"most frames: {names}",
        "raise the bit rate, lengthen the period, send fewer PDOs, or send them on events with an inhibit time",
        (worst * WINDOW_NS * 1e-9,), int(np.count_nonzero(load > BUSY)), None,
        picture_of(
            np.arange(len(load)) * WINDOW_NS * 1e-9, 100.0 * load, ("time [s]", "bus load [%]"), (("full", 100.0),), is_line=True
        ),
    )  # fmt: skip


def _error_frames(trace: Trace) -> Iterator[Said]:
    streams = trace.log.errors()
    if not streams:
        return
    seen: dict[str, int] = {}
    for stream in streams:
        for data, count in zip(*np.unique(stream.data, return_counts=True), strict=True):
            event = decode(Frame(stream.can_id, int(data).to_bytes(8, "little")))
            if event is not None:
                seen[event.words] = seen.get(event.words, 0) + int(count)
    stamps = np.sort(np.concatenate([stream.stamp_ns for stream in streams]))
    said = "; ".join(f"{count} × {words}" for words, count in sorted(seen.items(), key=lambda each: -each[1])[:MOST_SPEAKERS])
    yield Finding(
        "error-frames", Severity.FAULT,
        f"{counted(len(stamps), 'error frame')} of the controller: {said or 'without a known class'}",
        "check wires, termination (120 Ω at both ends), ground, bit rate and sample point",
        stamps_of(stamps, np.arange(len(stamps))), len(stamps),
    )  # fmt: skip


def sender_findings(trace: Trace) -> Iterator[Said]:
    """Find two senders of one RPDO, or more than one master.

    Every second value then continues the other sender's.
    """
    for node in trace.nodes.values():
        placed = node.pdo_with("rpdo", 0x607A)
        if placed is None:
            continue
        stream = trace.of(placed[0])
        values = placed[1].of(stream)
        if len(values) < LEAST_FRAMES:
            continue
        once, twice = np.abs(np.diff(values).astype(np.float32))[1:], np.abs((values[2:] - values[:-2]).astype(np.float32))
        torn = np.flatnonzero((once > 1000.0) & (twice < 0.1 * once))
        torn = torn[
            np.isin(torn + 1, torn) | np.isin(torn - 1, torn)
        ]  # one alone is a set-point that was reset between two motions
        if len(torn) > LEAST_FRAMES:
            yield Finding(
                "two-masters", Severity.FAULT,
                f"the target position of node {node.number} alternates between two paths in {counted(len(torn), 'frame')}, "
                f"by up to {float(np.max(once[torn])):.0f} counts: two masters send it",
                "stop one of them", stamps_of(stream.stamp_ns, torn), len(torn), node.number,
                picture_of(stream.stamp_ns * 1e-9, values.astype(float),
                    ("time [s]", f"target position of node {node.number} [counts]")),
            )  # fmt: skip
    masters = [number for number in trace.nodes if _is_master(trace, number)]
    if len(masters) > 1:
        yield Finding(
            "two-masters", Severity.FAULT,
            f"nodes {', '.join(map(str, masters))} send heartbeats and nothing else: more than one master",
            "let only one master command NMT", (), len(masters),
        )  # fmt: skip


def _is_master(trace: Trace, number: int) -> bool:
    """A node that sends heartbeats, but neither answers SDOs nor sends process data."""
    log = trace.log
    if log.count(FunctionCode.HEARTBEAT + number) < LEAST_FRAMES:
        return False
    own = (FunctionCode.SDO_RESPONSE, FunctionCode.TPDO1, FunctionCode.TPDO2, FunctionCode.TPDO3, FunctionCode.TPDO4,
        FunctionCode.SDO_REQUEST, FunctionCode.EMERGENCY)  # fmt: skip
    return not any(log.count(base + number) for base in own) and not trace.nodes[number].pdos
