"""The command line ``hil``."""
