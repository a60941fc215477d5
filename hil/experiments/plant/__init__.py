"""Identification of the plant of an axis without previous knowledge of it.

`motion` has the request and the motions, `checks` the checks of the data. `identify` makes the runs and the fit on a session, and
`on_bus` is the whole of `hil identify plant`.
"""
