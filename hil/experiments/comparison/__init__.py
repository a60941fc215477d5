"""Comparison of treatments, side by side over experiments and robots.

`plan` sorts a request into the runs that are possible and those that are left out, `run` makes them robot after robot, and
`table` gathers their results into rows.
"""
