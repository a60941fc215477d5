"""Two results side by side, the new one beside the old: what may be compared, settings that differ, numbers, figures, page."""
