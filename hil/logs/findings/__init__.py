"""Faults in a log, a module per matter: each function looks at a trace and says what it finds, or that it cannot tell."""
