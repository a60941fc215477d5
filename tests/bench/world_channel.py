"""The older names of `InProcessChannel`, until tests/hil/master/test_{bus_plan,cyclic_wall}.py have changed theirs."""

from collections.abc import Callable

from hil.can.frame import Frame
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.world import World

SYNC_ID = 0x80


class WorldChannel(InProcessChannel):
    """`passes` was `filter`, and `sent` a list."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.sent: list[Frame] = []  # type: ignore[assignment]

    @property
    def filter(self) -> Callable[[Frame], bool]:
        return self.passes

    @filter.setter
    def filter(self, passes: Callable[[Frame], bool]) -> None:
        self.passes = passes
