"""Commands before the first run: bench file, checks."""
