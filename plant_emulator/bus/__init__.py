"""The virtual wire: a socket server and a python-can interface."""
