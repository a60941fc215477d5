"""Identification and filter design in the frequency domain.

The package is pure numerics and uses no bus.

`frequency` has the plant and its loop, with margins and closed-loop poles. `plant_identification` and `ate`
estimate plant and transmission error from recordings. `notch_search` finds a variable notch that meets the requirements of
`notch_design`, and `inverse` computes the tables of the cancellation.

>>> from hil.bench.bench import load_bench
>>> from hil.design.frequency import margins
>>> loop = load_bench("reference").axis[2].loop(period_s=250e-6, delay_samples=0, with_notch=False)
>>> around = margins(loop)
>>> around.stable, round(around.sensitivity_peak, 2), round(loop.peak_hz(), 1)
(True, 1.36, 11.8)
"""
