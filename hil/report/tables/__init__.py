"""Tables of the reports.

Each function returns a `hil.report.tables.paper_runs.ReportTable`, or None without data for it.
"""
