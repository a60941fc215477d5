"""Checks of an axis in their order.

First those of means to stop it, then those that move it. After a failed check, the later ones are not made.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from hil.bench.bench import Bench
from hil.can.channel import Channel
from hil.commissioning.limits import check_limits
from hil.commissioning.seen import Checked
from hil.commissioning.sensing import check_sensing
from hil.commissioning.standing import check_heartbeat, check_standstill
from hil.commissioning.turning import check_quick_stop, check_turn
from hil.errors import NotPossibleError
from hil.experiments.bus_demand import BusDemand
from hil.experiments.measurement import Measurement, MeasurementOutcome
from hil.reporter import SILENT, Reporter
from hil.results.base import MeasuredBench
from hil.results.check import CHECK_FILE, CheckEntry, CheckResult

Step = tuple[str, Callable[[Checked], list[CheckEntry]], tuple[str, ...]]

STEPS: Final[tuple[Step, ...]] = (
    ("standstill and quick stop", check_standstill, ("stands enabled", "quick stop, standing", "brake holds")),
    ("heartbeat loss", check_heartbeat, ("heartbeat loss",)),
    ("a slow third of a turn and back", check_turn, ("brake opens", "encoder sign", "torque sign")),
    ("quick stop out of a slow motion", check_quick_stop, ("quick stop, moving",)),
    ("position limits of the drive", check_limits, ("upper limit", "lower limit")),
    ("a swing for the sensor", check_sensing, ("accelerometer",)),
)
"""Steps in words, with what makes them and the names of the checks that they give where all is well."""


def known_axes(bench: Bench, axes: Sequence[int]) -> tuple[int, ...]:
    """Return the axes to check, each once.

    Raises:
        NotPossibleError: The bench has no such axis.
    """
    numbers = tuple(dict.fromkeys(axes)) or tuple(sorted(bench.axis))
    if unknown := [number for number in numbers if number not in bench.axis]:
        raise NotPossibleError(f"the bench has no axis {unknown[0]}; it has {', '.join(map(str, sorted(bench.axis)))}")
    return numbers


def check_axes(
    bench: Bench,
    axes: Sequence[int],
    out: Path,
    *,
    channel: Channel | None = None,
    reset_faults: bool = False,
    reporter: Reporter = SILENT,
) -> MeasurementOutcome[CheckResult]:
    """Check axes one after the other; the others stay disabled.

    Without axes all are checked. The bus is opened from the bench file's address unless a channel is given.

    Raises:
        NotPossibleError: The bench has no such axis.
        HilError: Nodes or limits do not allow it; nothing has been enabled.
    """
    numbers = known_axes(bench, axes)

    def make(measured: MeasuredBench) -> CheckResult:
        return CheckResult(bench=measured, axes=numbers)

    with Measurement(bench, out, make, channel=channel, reporter=reporter, file_name=CHECK_FILE) as measurement:
        demands = [BusDemand(f"a check of axis {number}", (number,), bench.bus.sync_period_s) for number in numbers]
        with measurement.session(demands, reset_faults=reset_faults) as session:
            for number in numbers:
                _check_axis(Checked(session, number, measurement.keep), measurement.result, reporter)
    return MeasurementOutcome(measurement.result, measurement.failure)


def _check_axis(of: Checked, result: CheckResult, reporter: Reporter) -> None:
    """Make the checks of an axis up to the first failure."""
    ended: str | None = None
    for title, make, names in STEPS:
        if ended is not None:
            result.checks += tuple(of.not_made(name, f"not made: {ended}") for name in names)
            continue
        reporter.step(f"axis {of.number}: {title}")
        found = make(of)
        result.checks += tuple(found)
        ended = next((f"{each.name} failed" for each in found if each.verdict == "FAIL"), None)
        ended = ended or next((f"{each.name} could not be made" for each in found if not each.is_made), None)
