"""Zoomable figures of a report, in the same single file.

The file contains the figures' numbers as JSON, and the scripts that draw them with Bokeh.
"""
