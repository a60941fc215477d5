"""Comparison of tracking cancellations on drawn robots.

Each study has one axis, no bus, and the control laws of the product.
"""
