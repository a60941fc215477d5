"""Comparison of tracking cancellations on drawn robots."""
