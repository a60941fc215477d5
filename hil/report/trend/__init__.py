"""Trend of all runs below a folder over their dates."""
