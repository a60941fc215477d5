"""Reports: one self-contained HTML file for each directory of results.

>>> import datetime, tempfile
>>> from pathlib import Path
>>> from hil.bench.bench import load_bench
>>> from hil.report.writer import write_report_of
>>> from hil.results.base import RESULT_FILE, MeasuredBench
>>> from hil.results.learning import LearningResult
>>> bench = MeasuredBench.of(load_bench("reference"), datetime.datetime.now(datetime.UTC), is_lock_step=True)
>>> with tempfile.TemporaryDirectory() as folder:
...     LearningResult(bench=bench, model="learnt.toml", not_learnt="no pass").write(Path(folder) / RESULT_FILE)
...     page = write_report_of(Path(folder))
...     page.name, "Not everything was learnt" in page.read_text(encoding="utf-8")
('report.html', True)
"""
