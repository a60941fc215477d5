"""Passes of ramps, each kept before it is judged."""

from typing import Protocol

from hil.experiments.ate.motion import Ramps
from hil.master.motion import RunResult


class PassKeeper(Protocol):
    """Keeper of the passes of one axis."""

    def __call__(self, number: int, result: RunResult, motion: Ramps) -> None:
        """Keep a pass with the ramps that were requested.

        `number` counts from 1; the pass may have been stopped.
        """


def keep_nothing(number: int, result: RunResult, motion: Ramps) -> None:
    """Keep nothing: for callers who use only the estimate from all passes."""
