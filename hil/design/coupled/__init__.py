"""Arm behind several motors, frozen in a posture.

`structure` has its dynamics, `loops` the margins of one axis' loop on it.
"""
