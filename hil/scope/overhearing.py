"""Nodes of a bus and their process data, from overheard set-up."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from drive_profiles.eds.description import Description
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import FunctionCode
from drive_profiles.standard.object_address import ObjectAddress
from hil.bench.bench import Bench
from hil.can.listening import FRAME_RECORD, ReceivedFrames
from hil.control.treatments import LoopName
from hil.logs.log import Damage, Log, LogBuilder
from hil.logs.nodes import Node, nodes_of
from hil.logs.overheard import OverheardValue, overheard
from hil.master.drive import mapping
from hil.master.drive.pdo import MappedObject

TRANSFER_NS = 500_000_000
"""Frames of a transfer lie at most so far apart: older ones are forgotten, and their values kept."""
MOST_VALUES = 20_000
"""Objects whose values are kept, of all nodes together."""
_SDO = (FunctionCode.SDO_RESPONSE, FunctionCode.SDO_REQUEST)


class Overhearing:
    """Overheard set-up of the nodes."""

    def __init__(self, bench: Bench | None, descriptions: Mapping[int, Description]) -> None:
        self._bench, self._descriptions = bench, descriptions
        self._values: dict[tuple[int, ObjectAddress], OverheardValue] = {}
        self._recent: ReceivedFrames = np.empty(0, FRAME_RECORD)
        self._first: dict[int, tuple[int, int, int, int]] = {}
        self.nodes: dict[int, Node] = {}

    def take(self, heard: ReceivedFrames) -> bool:
        """Look through frames; True if `nodes` has changed."""
        if not len(heard):
            return False
        fresh = self._note_first(heard)
        base = heard["can_id"] & ~np.uint32(0x7F)
        is_setup = np.isin(base, _SDO) & (heard["can_id"] & 0x7F > 0)
        if not fresh and not is_setup.any():
            return False
        kept = np.concatenate([self._recent, heard[is_setup]])
        # what holds is what was heard last, so that the order of the values is all that counts
        events = [replace(each, stamp_ns=0) for each in overheard(_log(kept)) if isinstance(each, OverheardValue)]
        for event in events:
            if len(self._values) < MOST_VALUES or (event.node, event.address) in self._values:
                self._values[event.node, event.address] = event
        self._recent = kept[kept["stamp_ns"] >= int(heard["stamp_ns"][-1]) - TRANSFER_NS]
        if not fresh and not events:
            return False
        before = self.nodes
        self.nodes = nodes_of(_log(self._seen()), [*self._assumed(), *self._values.values()], self._descriptions)
        return before != self.nodes

    def _note_first(self, heard: ReceivedFrames) -> bool:
        """Keep a frame of each new identifier; True for a new one."""
        ids, rows = np.unique(heard["can_id"], return_index=True)
        fresh = [(int(each), int(row)) for each, row in zip(ids, rows, strict=True) if int(each) not in self._first]
        for can_id, row in fresh:
            one = heard[row]
            self._first[can_id] = (int(one["stamp_ns"]), can_id, int(one["length"]), int(one["data"]))
        return bool(fresh)

    def _seen(self) -> ReceivedFrames:
        """A frame of each identifier, and a SYNC behind them."""
        rows = [each for each in self._first.values() if each[1] != FunctionCode.SYNC]
        last = max((each[0] for each in rows), default=0)
        return np.array(sorted([*rows, (last + 1, int(FunctionCode.SYNC), 0, 0)]), FRAME_RECORD)

    def _assumed(self) -> Iterable[OverheardValue]:
        """Yield this package's own mapping, by the bench file."""
        if self._bench is None:
            return
        for axis in self._bench.axis.values():
            profile = Profile.load(axis.profile)
            yield from self._mapped(axis.node_id, 0x1A00, mapping.feedback(profile))
            length = self._first.get(FunctionCode.RPDO1 + axis.node_id, (0, 0, 0, 0))[2]
            loop: LoopName = "host" if length == mapping.length(mapping.command(mapping.CST)) else "drive"
            mode = mapping.mode_of(loop, profile) or mapping.CSP
            has_offset = length == mapping.length(mapping.command(mapping.CSP, with_torque_offset=True))
            yield from self._mapped(axis.node_id, 0x1600, mapping.command(mode, with_torque_offset=has_offset))
        if self._bench.accelerometer.node_id is not None:
            yield from self._mapped(self._bench.accelerometer.node_id, 0x1A00, mapping.ACCELERATION)

    def _mapped(self, node: int, index: int, objects: tuple[MappedObject, ...]) -> Iterable[OverheardValue]:
        if any((node, (index, subindex)) in self._values for subindex in range(len(objects) + 1)):
            return
        known = self._descriptions.get(node)
        if known is not None and index in known.dictionary:
            return
        for subindex, value in enumerate((len(objects), *(each.value for each in objects))):
            yield OverheardValue(0, node, (index, subindex), value.to_bytes(4, "little"), is_write=True)


def _log(heard: ReceivedFrames) -> Log:
    builder = LogBuilder(Path("bus"))
    builder.add(heard["stamp_ns"].copy(), heard["can_id"].copy(), heard["length"].copy(), heard["data"].copy())
    return builder.log(Damage())
