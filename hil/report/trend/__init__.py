"""Trend of all runs below a folder over their dates.

The modules read the runs, draw figures and tables, and write the page.
"""
