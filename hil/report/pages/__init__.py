"""HTML pages of the reports, one module per kind of result."""
