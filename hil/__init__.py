"""Hardware-in-the-loop bench for robots with harmonic drives.

A bench file describes a robot on a bus (`bench`). The CANopen master (`master`) moves its axes and records them, with the
control laws of `control`, over the channels of `can` and with an accelerometer of `sensor`. `design` has identification and
filter design, `plan` the load of the bus. `experiments`, `report` and `cli` build the commands of `hil` from these, and `run`
is one of them for Python (docs/python.md).

>>> from hil.bench.bench import load_bench
>>> bench = load_bench("reference")
>>> sorted(bench.axis), bench.bus.sync_period_s
([2, 3, 5], 0.002)
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.running import ExperimentRun, run

__all__ = ["ExperimentRun", "run"]


def __getattr__(name: str) -> Any:
    """Load `run` on request.

    An import of this package alone then does not load numpy and scipy.
    """
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hil import running  # noqa: PLC0415

    return getattr(running, name)
