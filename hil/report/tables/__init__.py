"""Tables of the reports.

Each function returns a `hil.report.report_table.ReportTable`, or None without data for it.
"""
