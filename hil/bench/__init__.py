"""Files that describe a robot: bench, model and design file.

`bench` has the bus, the axes with their limits and assumed models, and the motions. `model` has the identified plants and
transmission errors with their standard errors, `design` the designed filters; either can replace the values of a bench file.

>>> from hil.bench.bench import load_bench
>>> axis = load_bench("reference").axis[2]
>>> axis.limits.speed_rps, round(axis.plant().antiresonance_hz, 2)
(12.0, 12.45)
"""
