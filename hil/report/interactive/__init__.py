"""Figures of a report that can be zoomed, in the same single file: their numbers, and the scripts that draw them with Bokeh."""
