"""The first hour with a robot: its bench file from a scan, and what is to be seen of each axis before anything else moves it.

`scan` and `draft` write the file. `held` has one enabled axis under limits that are narrower than the bench file's; `standing`,
`turning`, `limits` and `sensing` are the checks, from those that move nothing to those that need all before them; `check` puts
them in their order.

>>> from hil.bench.bench import load_bench
>>> from hil.commissioning.held import narrowed
>>> limits = narrowed(load_bench("reference"), 2, start_rev=1.0).axis[2].limits
>>> limits.position_min_rev, limits.position_max_rev, limits.speed_rps
(0.25, 1.75, 2.0)
"""
