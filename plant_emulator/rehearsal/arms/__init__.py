"""Whole arms: learning on a line, and its effect elsewhere."""
