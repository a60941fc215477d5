"""Learning on a motion itself, by runs of it with small known cancellations."""
