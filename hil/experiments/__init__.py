"""Experiments on a robot: motions, measurements and verdicts.

`plan` has the paper's experiments with their metrics and claims, and `runner` runs them. `treatment` sets up a treatment of the
vibration. `plant` and `ate` identify an axis, `notch_design` designs its filter, `cancellation` cancels its transmission error
and learns it, and `comparison` runs treatments side by side. All that measure do so by `measurement`: bus, load check, log,
session, recordings and result.

>>> from hil.bench.bench import load_bench
>>> from hil.experiments.plan import Experiment
>>> bench = load_bench("reference")
>>> experiment = Experiment("constant-acceleration", axis=2, treatment="notch")
>>> experiment.title
'constant-acceleration, axis 2, drive-closed, with the notch'
>>> motion = experiment.motion(bench)
>>> motion.axes, motion.period_s, motion.motor_angle_rad.shape
((2,), 0.002, (1851, 1))

`hil.experiments.runner.run_experiments(bench, [experiment], directory)` runs it.
"""
