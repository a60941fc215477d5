"""Identification of the transmission error from recordings that others have made.

`request` has the request, `encoders` makes sections of two encoders, `sensed` of a tip's acceleration or a motor's torque,
`identify` fits them and finds words, `curves` is what the page draws.
"""
