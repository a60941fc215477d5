"""Cancellations that follow, compared on robots that are drawn: one axis, no bus, the laws that ship."""
