"""HTML pages of the reports, one module per kind of result.

`page` renders all of them with one template.
"""
