"""Recordings of drawn robots with their truth, and replayed estimates."""
