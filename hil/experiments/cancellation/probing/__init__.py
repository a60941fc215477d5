"""Learning on a motion itself.

The motion runs with small known cancellations.
"""
