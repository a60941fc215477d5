"""The process image: a SYNC of drives that only follow, in one call.

`ProcessImage` lays it out; `image.h` says what it does.
"""
