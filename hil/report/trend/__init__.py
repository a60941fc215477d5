"""The runs below a folder over their dates: reading of all of them, figures and tables, the page."""
