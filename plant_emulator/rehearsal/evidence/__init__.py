"""Recordings of drawn robots with their truth, and replayed estimates.

`recordings` makes the recordings once, `replay` estimates from them again without a robot, `table` compares with the truth.
"""
