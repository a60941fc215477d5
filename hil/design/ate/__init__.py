"""Transmission error from ramps in both directions, as pure numerics.

`model` has the model of a ramp, `refinement` the arm in it, `motion` the motor's own motion and `misfit` what a gear that is no
spring leaves. `identification` gives the error with its standard errors, `passes` that of several passes.
"""
