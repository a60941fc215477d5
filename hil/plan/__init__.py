"""The load of a bus: frames of a cycle, verdict, and advice.

`check` gives the verdict on a bench's plan, with the stability of loops that are closed over the bus. `bus_plan` has the frames
of a cycle, `wire` their duration, `response_time` their latest arrival. `advice` lists changes that make the plan fit, with
their effect.

>>> from hil.bench.bench import load_bench
>>> from hil.plan.check import check
>>> plan = check(load_bench("reference"), (2,), "drive", period_s=0.002, bitrate=500_000)
>>> plan.fits, plan.is_good
(True, True)
>>> round(plan.cycle.shortest_period_s(plan.wire) * 1e6)
970
"""
