"""Several modes of a coupled arm behind one motor.

`problem` is a fit with them, `fit` chooses their number.
"""
