"""Names of the orders of a transmission error, as pages have them."""

import re
from collections.abc import Iterable

from markupsafe import Markup

BY_ORDER = (("A", "arcsec"), ("φ", "°"))
"""Symbols and units of an order's two numbers."""


def symbol_of(name: str) -> str:
    """Return symbol and unit of a model file's number: `A_2 (arcsec)`."""
    found = re.fullmatch(r"(a|phi)([0-9.]+)_(arcsec|deg)", name)
    if found is None:
        return name
    return f"A_{found[2]} (arcsec)" if found[1] == "a" else f"φ_{found[2]} (°)"


def symbol(letter: str, order: float) -> Markup:
    """Symbol of an order's amplitude or phase: A with its order below."""
    return Markup("{}<sub>{:g}</sub>").format(letter, order)


def order_words(orders: Iterable[float]) -> str:
    """Orders in words: `order 2 and 4`."""
    names = [f"{order:g}" for order in orders]
    return "no order" if not names else "order " + " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
