"""Signals derived from others: speed from positions, following error from set-points."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.scope.signals import Signal, SignalQuantity

Real = NDArray[np.float64]
ROWS_BEHIND = 2
"""Rows between a position set-point and the position that it asks for: one that is sent before SYNC n takes effect with it, is
reached at SYNC n + 1, and stands in the row before n."""
LONGEST_GAP = 1.5
"""Rows further apart than so many of the usual ones do not tell a speed."""


@dataclass
class AxisPast:
    """The last rows of an axis, which those to come need."""

    time_s: float = np.nan
    position: float = np.nan
    targets: Real = field(default_factory=lambda: np.full(ROWS_BEHIND, np.nan))


def derived(
    name: str, time_s: Real, found: Mapping[Signal, Real], target: Real | None, past: AxisPast
) -> dict[Signal, Real]:  # fmt: skip
    """Compute speed and following error of an axis, unless it sends them.

        v_n = (p_n − p_{n−1}) / (t_n − t_{n−1}),   e_n = p*_{n−2} − p_n.

    Args:
        name: Name of the axis.
        time_s: Times of the rows; shape (n,).
        found: Signals that it sends.
        target: Position set-points, in the unit of the position; shape (n,); None if none are sent.
        past: Its last rows; they are replaced.
    """
    sent = {signal.quantity: signal for signal in found if signal.of == name}
    position_signal = sent.get(SignalQuantity.POSITION)
    if position_signal is None or not len(time_s):
        return {}
    position = found[position_signal]
    new: dict[Signal, Real] = {}
    if SignalQuantity.SPEED not in sent:
        steps_s = np.diff(time_s, prepend=past.time_s)
        usual = np.nanmedian(steps_s) if not np.all(np.isnan(steps_s)) else np.nan
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = np.diff(position, prepend=past.position) / np.where(steps_s < LONGEST_GAP * usual, steps_s, np.nan)
        new[Signal(name, SignalQuantity.SPEED, f"{position_signal.unit}/s")] = speed
    targets = np.concatenate([past.targets, np.full(len(time_s), np.nan) if target is None else target])
    if SignalQuantity.FOLLOWING_ERROR not in sent and target is not None:
        new[Signal(name, SignalQuantity.FOLLOWING_ERROR, position_signal.unit)] = targets[: len(time_s)] - position
    past.time_s, past.position, past.targets = float(time_s[-1]), float(position[-1]), targets[-ROWS_BEHIND:]
    return new
