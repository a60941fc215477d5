"""Commands on a running bus.

They show values and faults of nodes, and give services of CiA 301 and 305 to whole nodes.
"""
