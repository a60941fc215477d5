"""Sentences on the orders in the passes of an axis.

They name orders that are seen but not in the set, and orders out of reach.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Sensing, Sweep
from hil.experiments.ate.checks import AteNotIdentifiedError, check_estimate
from hil.experiments.ate.order_scan import OrderScan, SeenOrder, is_passed, scan_orders
from hil.experiments.ate.ramp import Ramp


@dataclass
class OrderWatch:
    """Passes of one axis, to be scanned for orders.

    Attributes:
        reduction_ratio: N.
        sensing: The kind of signal.
        ramp: Ramp of the last pass.
        sweeps: Passes so far.
    """

    reduction_ratio: float
    sensing: Sensing
    ramp: Ramp
    sweeps: list[Sweep] = field(default_factory=list)

    def scan(self, estimate: JointEstimate) -> OrderScan:
        """Scan these passes for the orders of an estimate's vibration."""
        return scan_orders(self.sweeps, self.reduction_ratio, self.sensing, estimate)

    def notes(self, estimate: JointEstimate, scan: OrderScan) -> list[str]:
        """Sentences on orders that are seen or out of reach.

        Seen orders are those that are not in the set.
        """
        orders = tuple(estimate.error.amplitude_arcsec)
        return [*seen_words(scan.seen, orders), *self._out_of_reach(estimate, orders)]

    def _out_of_reach(self, estimate: JointEstimate, orders: Sequence[float]) -> list[str]:
        words = []
        for order in orders:
            needed_rps = estimate.arm.resonance_hz / order
            if is_passed(self.sweeps, estimate.arm.resonance_hz, order):
                continue
            why = self.ramp.short_of(needed_rps) or "no pass reached that speed"
            words.append(
                f"order {order:g} meets the arm at {needed_rps:.2f} rev/s, which the ramps do not reach ({why}): A_{order:g} "
                f"comes from the lower edge of its resonance"
            )
        return words


def seen_words(seen: Sequence[SeenOrder], orders: Sequence[float]) -> list[str]:
    """Sentences on orders that are seen and not in the set."""
    if not seen:
        return []
    names = ",".join(f"{order:g}" for order in sorted({*orders, *(each.order for each in seen)}))
    return [
        f"order {each.order:g} is significant but not in the set: {each.amplitude_arcsec:.2g}″, "
        f"{100.0 * each.fraction:.0f} % of the vibration; add it with --orders {names}"
        for each in seen
    ]


def checked(watch: OrderWatch, estimate: JointEstimate, *, sensorless: bool, passes_left: int = 0) -> None:
    """Check an estimate; a failure names the unrequested orders seen.

    See `check_estimate`.

    Raises:
        AteNotIdentifiedError: One of the checks fails.
    """
    try:
        check_estimate(estimate, sensorless=sensorless, passes_left=passes_left)
    except AteNotIdentifiedError as error:
        if not error.is_of_orders:
            raise
        words = seen_words(watch.scan(estimate).seen, tuple(estimate.error.amplitude_arcsec))
        if not words:
            raise
        remedy = "; ".join(filter(None, (*words, error.remedy)))
        raise AteNotIdentifiedError(
            error.what, error.value, error.needed, error.unit, remedy, at_most=error.at_most, causes=error.causes
        ) from error
