"""Cancellation of the transmission error: by additions to the set-points, or inside the drives.

`cancellation` makes it from a model file and checks it against the limits, and `trial` tries it on the accelerometer before it is
trusted. `learning` learns it from pass to pass, and `learn_run` is the whole of `hil learn`.
"""
