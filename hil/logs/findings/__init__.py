"""Faults in a log, a module per subject.

Each function checks a trace, and yields findings, or reasons why it can find none.
"""
