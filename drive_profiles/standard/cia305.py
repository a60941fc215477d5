"""Identifiers and bit rates of the layer setting services (CiA 305)."""

from collections.abc import Mapping
from types import MappingProxyType

LSS_REQUEST, LSS_RESPONSE = 0x7E5, 0x7E4
"""CAN-IDs of the master's requests and of the slaves' answers (CiA 305, 3.3)."""
UNCONFIGURED = 0xFF
"""Instead of a node-ID: the node has none, and answers LSS only."""
BIT_TIMINGS: Mapping[int, int] = MappingProxyType(
    {0: 1_000_000, 1: 800_000, 2: 500_000, 3: 250_000, 4: 125_000, 6: 50_000, 7: 20_000, 8: 10_000}
)
"""Bit rates in bit/s by their index in the standard's table of bit timings (selector 0).

Index 5 is reserved; 9, the detection of the rate, is not supported here. An EDS has a key for these rates (CiA 306-1).
"""
