"""Figures of the reports.

Each function returns a `hil.report.style.Drawing`, or None without data for it.
"""
