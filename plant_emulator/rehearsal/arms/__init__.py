"""Whole arms: learning on a line, and what of it holds on other lines, with other payloads and at another pace."""
