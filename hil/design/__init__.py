"""Frequency-domain design and identification. Pure numerics."""
