"""Commissioning: bench file from a scan, and first checks of each axis.

>>> from hil.bench.bench import load_bench
>>> from hil.commissioning.held import narrowed
>>> limits = narrowed(load_bench("reference"), 2, start_rev=1.0).axis[2].limits
>>> limits.position_min_rev, limits.position_max_rev, limits.speed_rps
(0.25, 1.75, 2.0)
"""
