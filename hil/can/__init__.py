"""Frames in, frames out: one record, one channel protocol, several buses."""
