"""Cancellation of the transmission error.

It acts by additions to the set-points, or inside the drives.

`cancellation` makes it from a model file and checks it against the limits, and `trial` tries it at the tip before it is
trusted. `learning` learns it from pass to pass, and `learn_run` is the whole of `hil learn`; `probing` learns on a motion itself,
and `probing.on_bus` is the whole of `hil learn --motion`.
"""
