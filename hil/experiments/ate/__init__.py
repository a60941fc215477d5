"""Identification of an axis' transmission error from ramps in both directions.

`request` has the request with its goal and the knowledge of the axis, `motion` the ramps, `checks` the checks of passes and
estimates. `identify` makes the passes on a session, and `on_bus` is the whole of `hil identify ate`.
"""
