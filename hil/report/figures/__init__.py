"""Figures of the reports: each function returns a `hil.report.style.Drawing`, or None without data for it."""
