"""Whole arms: learning on a line, and its effect elsewhere.

The learnt cancellation is tested on other lines, with other payloads and at another pace.
"""
