"""Orders that a ramp shows, requested or not.

An order k meets the arm if the motor turns f_a/k times a second. Order 1 does so at f_a, which many axes cannot reach: their
ramps show only the foot of its resonance. Such an order is left out of the fit if it is not significant, so that it takes
nothing from the others; its amplitude is reported all the same.

The residual of the fit is scanned for orders that are not in the set: the sine of each order is fitted through the arm by
least squares, and compared with the orders beside it, which are noise.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.bench.model import SIGNIFICANT_SIGMAS
from hil.control.arrays import Real
from hil.control.order_keys import order_keys
from hil.design.ate.identification import JointEstimate, identify, searched
from hil.design.ate.model import Arm, RampsModel, Sensing, Sweep
from hil.design.ate.refinement import shifted
from hil.design.estimation import SEARCHED_SIGMAS
from hil.experiments.ate.checks import VIBRATES, AteNotIdentifiedError, check_estimate
from hil.experiments.ate.ramp import Ramp
from hil.robot_tables import MOST_MORE_ORDERS

LOOKED_AT = (0.5, 10.0)
"""Bound: orders among which others are looked for, from and to."""
SCAN_STEP, FINE_STEP = 0.125, 0.025
"""Accuracy: step of a scan's orders, a quarter of the width of an order that is seen for two turns, and step about the best."""
STANDING_OUT = ((0.003, 20.0), (0.01, 4.0))
"""Measured with `SEEN_FRACTION`: fraction of the vibration's power, and power over that of the orders beside it, from which an
order is fitted to see: high orders are passed within a turn, and show in those beside them too."""
SEEN_FRACTION, SEEN_LEAVES = 0.02, 0.7
"""Measured: fraction of the vibration's power from which an order is seen, and what its fit leaves at most: on 20 recordings it
named every order of 2 % and no false one (docs/theory-orders.md)."""
APART_ORDERS, BESIDE_ORDERS = 0.6, 2.5
"""Bound: orders from which two are told apart, a resonance lasting two or three turns, and to which they are beside it."""
NEARLY_AS_GOOD = 0.9
"""Measured with `SEEN_FRACTION`: power of a whole order, over the best one beside it, from which the whole one is meant."""
TRIED_ORDERS = (1, 2, 3, 4, 5, 6, 8)
"""Bound: orders of which each is fitted where those requested leave much: turns of the wave generator and their harmonics."""
LEAST_OWN = 0.1
"""Accuracy: part of an order's sine that the fitted orders must not explain: a factor of 2 changes nothing in six scans."""


@dataclass(frozen=True)
class SeenOrder:
    """Order that the ramps show and that was not requested.

    Attributes:
        fraction: Fraction of the vibration's power that it explains.
        sigmas: Its amplitude in standard errors.
    """

    order: float
    amplitude_arcsec: float
    fraction: float
    sigmas: float


@dataclass(frozen=True)
class OrderScan:
    """Orders of a vibration.

    Attributes:
        fractions: Fraction of the vibration's power by order of the set.
        seen: Others, the strongest first.
    """

    fractions: Mapping[float, float]
    seen: tuple[SeenOrder, ...]


def identify_orders(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None,
    orders: Sequence[float],
    *,
    is_near: bool = False,
) -> JointEstimate:
    """Identify the requested orders that the ramps show.

    An order whose resonance no ramp passes, and whose amplitude is below `SIGNIFICANT_SIGMAS` standard errors, is fitted once,
    for its amplitude and errors, and left out of the fit that gives everything else.

    `start` is an arm to start from, which may be wrong; `is_near` says that it is of an estimate of most of these recordings.

    Raises:
        ValueError: As `identify`.
    """
    estimate = identify(sweeps, reduction_ratio, sensing, start, orders, is_near=is_near)
    weak = [
        order
        for order in orders
        if not is_passed(sweeps, estimate.arm.resonance_hz, order) and not is_significant(estimate, order)
    ]
    kept = [order for order in orders if order not in weak]
    if not weak or not kept:
        return estimate
    without = identify(sweeps, reduction_ratio, sensing, estimate.arm, kept, is_near=True)
    lone = {key: (estimate.values.value(key), estimate.values.standard_error(key)) for key in order_keys(weak)}
    values = without.values.with_others(lone).part(order_keys(orders))
    return replace(without, orders=tuple(orders), values=values)


def is_significant(estimate: JointEstimate, order: float) -> bool:
    """True if an order's amplitude exceeds the noise."""
    return estimate.error.amplitude_arcsec[order] >= SIGNIFICANT_SIGMAS * estimate.amplitude_error_arcsec[order]


def is_passed(sweeps: Sequence[Sweep], arm_hz: float, order: float) -> bool:
    """True if a ramp passes the speed of an order's resonance."""
    return max(_top_rps(sweep) for sweep in sweeps) >= arm_hz / order


def _top_rps(sweep: Sweep, over_s: float = 0.05) -> float:
    """Largest motor speed of the rows that count."""
    step = max(1, round(over_s / sweep.period_s))
    angle = np.asarray(sweep.motor_angle_rad)
    speed = np.abs(angle[step:] - angle[:-step])[sweep.direction[step:] != 0]
    return float(np.max(speed, initial=0.0)) / (step * sweep.period_s * 2.0 * math.pi)


def scan_orders(sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, estimate: JointEstimate) -> OrderScan:
    """Find the orders of the vibration behind an estimate.

    What is left over is taken off everything that the fitted orders could leave with another arm, each with its own, to first
    order in its frequency, damping and delay: a gear that is softer for small vibrations is not another order. What stands out
    of it is fitted together with the others, and is seen where that fit is much better. An order that has most of the vibration
    leads the fit of the others astray, arm and all: where they explain little, each whole order is tried beside them.
    """
    scan, seen = _Scan(sweeps, reduction_ratio, sensing), list[SeenOrder]()
    if estimate.explained_by_error < 1.0 - VIBRATES:
        tried = scan.with_each(estimate, [order for order in TRIED_ORDERS if order not in estimate.error.amplitude_arcsec])
        better = [fit for fit in tried if scan.is_seen(fit, estimate)]
        if better:
            estimate = max(better, key=lambda fit: fit.explained_by_error)
            seen.append(scan.last_of(estimate))
    while len(seen) < MOST_MORE_ORDERS:  # a model file holds no more
        order = scan.standing_out(estimate)
        if order is None:
            break
        (found,) = scan.with_each(estimate, [order])
        if not scan.is_seen(found, estimate):
            break
        seen.append(scan.last_of(found))
        estimate = found
    others = {each.order for each in seen}
    return OrderScan({k: part for k, part in scan.fractions(estimate).items() if k not in others}, tuple(seen))


@dataclass(frozen=True)
class _Scan:
    """Recordings that are scanned for orders."""

    sweeps: Sequence[Sweep]
    reduction_ratio: float
    sensing: Sensing

    def model(self, estimate: JointEstimate, orders: Sequence[float]) -> RampsModel:
        """Model of some orders in the band of an estimate."""
        return RampsModel(self.sweeps, self.reduction_ratio, self.sensing, tuple(orders), estimate.band_hz)

    def with_each(self, estimate: JointEstimate, tried: Sequence[float]) -> list[JointEstimate]:
        """Fit one more order, which is the last of the fit, for each that is tried."""
        given = self.sweeps, self.reduction_ratio, self.sensing
        choices = [(*estimate.error.amplitude_arcsec, each) for each in tried]
        is_near = estimate.explained_by_error >= 1.0 - VIBRATES
        arms = [estimate.arm] * len(choices) if is_near else searched(*given, choices)
        return [identify(*given, arm, orders, is_near=True) for arm, orders in zip(arms, choices, strict=True)]

    def last_of(self, estimate: JointEstimate) -> SeenOrder:
        """Last order of a fit."""
        order, size = list(estimate.error.amplitude_arcsec.items())[-1]
        sigmas = size / max(estimate.amplitude_error_arcsec[order], 1e-30)
        return SeenOrder(order, size, self.fractions(estimate)[order], sigmas)

    def is_seen(self, found: JointEstimate, before: JointEstimate) -> bool:
        """True if a fit shows its last order, beside the same fit without it."""
        new, left, once = self.last_of(found), 1.0 - found.explained_by_error, 1.0 - before.explained_by_error
        return new.sigmas >= SEARCHED_SIGMAS and new.fraction >= SEEN_FRACTION and left <= SEEN_LEAVES * once

    def fractions(self, estimate: JointEstimate) -> dict[float, float]:
        """Fraction of each order of the tip's motion beyond that of the motor."""
        orders = list(estimate.error.amplitude_arcsec)
        model = self.model(estimate, orders)
        motion, columns = model.columns(estimate.arm)
        vibration = model.signal - motion
        unknowns = np.linalg.lstsq(columns, vibration, rcond=None)[0]
        parts = [columns[:, 2 * i : 2 * i + 2] @ unknowns[2 * i : 2 * i + 2] for i in range(len(orders))]
        total = max(float(np.sum(vibration**2)), 1e-300)
        return {order: float(np.sum(part**2)) / total for order, part in zip(orders, parts, strict=True)}

    def standing_out(self, estimate: JointEstimate) -> float | None:
        """Order that stands out of an estimate's residual, or None."""
        fitted = list(estimate.error.amplitude_arcsec)
        grid = np.arange(LOOKED_AT[0], LOOKED_AT[1] + 1e-9, SCAN_STEP)
        model = self.model(estimate, (*fitted, *map(float, grid)))
        motion, columns = model.columns(estimate.arm)
        own = columns[:, : 2 * len(fitted)]
        basis = np.column_stack([motion, own, *_slopes(self.model(estimate, fitted), estimate.arm)])
        powers = _powers(basis, model.signal, columns[:, 2 * len(fitted) :]) / max(
            float(np.sum((model.signal - motion) ** 2)), 1e-300
        )
        best = max(np.flatnonzero(np.isfinite(powers)), key=lambda row: powers[row], default=None)
        if best is None:
            return None
        distance = np.abs(grid - grid[best])
        beside = powers[(distance >= APART_ORDERS) & (distance <= BESIDE_ORDERS) & np.isfinite(powers)]
        noise = float(np.median(beside)) / math.log(2.0) if len(beside) else math.inf
        if not any(powers[best] >= fraction and powers[best] >= over * noise for fraction, over in STANDING_OUT):
            return None
        return self._named(estimate, basis, float(grid[best]))

    def _named(self, estimate: JointEstimate, basis: Real, order: float) -> float:
        """Refine an order beyond the grid of the scan."""
        fine = [float(each) for each in order + np.arange(-1.2 * SCAN_STEP, 1.2 * SCAN_STEP + 1e-9, FINE_STEP)]
        whole = max(1, round(order))
        model = self.model(estimate, (*fine, whole))
        powers = np.nan_to_num(_powers(basis, model.signal, model.columns(estimate.arm)[1]))
        best = int(np.argmax(powers))
        return whole if powers[-1] >= NEARLY_AS_GOOD * powers[best] else round(fine[min(best, len(fine) - 1)], 2)


def _slopes(model: RampsModel, arm: Arm) -> list[Real]:
    """Slopes of motion and columns by frequency, damping and delay."""
    steps = np.diag([0.01 * arm.resonance_hz, 0.1 * arm.damping, 0.01 / arm.resonance_hz])
    sides = ([np.column_stack(model.columns(shifted(arm, *(sign * step)))) for sign in (1.0, -1.0)] for step in steps)
    return [np.asarray(more - less) for more, less in sides]


def _powers(basis: Real, signal: Real, candidates: Real) -> Real:
    """Power that each candidate explains beyond a basis; shape (pairs,).

    A candidate is a pair of columns; NaN if the basis itself explains it.
    """
    scale = np.sqrt(np.sum(basis**2, axis=0)) + 1e-300
    vectors, sizes, _ = np.linalg.svd(basis / scale, full_matrices=False)
    span = vectors[:, sizes > 1e-6 * sizes[0]]
    left = signal - span @ (span.T @ signal)
    free = candidates - span @ (span.T @ candidates)
    powers = np.full(candidates.shape[1] // 2, math.nan)
    for row in range(len(powers)):
        pair, whole = free[:, 2 * row : 2 * row + 2], candidates[:, 2 * row : 2 * row + 2]
        if np.sum(pair**2) < LEAST_OWN * np.sum(whole**2):
            continue
        orthogonal = np.linalg.qr(pair)[0]
        powers[row] = float(np.sum((orthogonal.T @ left) ** 2))
    return powers


@dataclass
class OrderWatch:
    """Passes of one axis, to be scanned for orders.

    Attributes:
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
        """Sentences on orders that are seen beyond the set, or out of reach."""
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
