"""Two results side by side, the new one beside the old."""
