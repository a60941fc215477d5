"""The bench: a CANopen master for robots with harmonic drives, from the first check of a bus to the report.

A bench file describes a robot on a bus (`bench`). The master (`master`) moves its axes and records them, with the laws of
`control`, over the channels of `can` and with an accelerometer of `sensor`. `design` holds identification and filter design,
`plan` the load of the bus. `experiments`, `report` and `cli` build the commands of `hil` from these.

>>> from hil.bench.bench import load_bench
>>> bench = load_bench("reference")
>>> sorted(bench.axis), bench.bus.sync_period_s
([2, 3, 5], 0.002)
"""
