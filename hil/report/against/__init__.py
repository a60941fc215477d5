"""Two results side by side, the new one beside the old.

The modules compare settings, numbers and figures, refuse results that cannot be compared, and write the page.
"""
