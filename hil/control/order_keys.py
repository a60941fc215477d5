"""Names of an order's amplitude and phase, in files and among estimates."""

from collections.abc import Iterable


def amplitude_key(order: float) -> str:
    """Name of an order's amplitude among the standard errors: `a2_arcsec`.

    >>> amplitude_key(2), amplitude_key(0.5)
    ('a2_arcsec', 'a0.5_arcsec')
    """
    return f"a{order:g}_arcsec"


def phase_key(order: float) -> str:
    """Name of an order's phase among the standard errors: `phi2_deg`.

    >>> phase_key(2.0)
    'phi2_deg'
    """
    return f"phi{order:g}_deg"


def order_keys(orders: Iterable[float]) -> tuple[str, ...]:
    """Names of amplitude and phase of each order in turn."""
    return tuple(key(order) for order in orders for key in (amplitude_key, phase_key))
