r"""Logs of a bus: frames as arrays, set-up of nodes, and faults.

Any program may have recorded them. Pure numerics except for the reading of files; no module knows a bench file.

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from hil.logs.explain import explain
>>> from hil.logs.opening import open_log
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "candump.log")
...     _ = path.write_text("".join(f"({0.002 * k:.6f}) can0 080#\n" for k in range(100) if k != 40))
...     found = explain(open_log(path), descriptions={})
>>> found.findings[0].kind, found.findings[0].stamps_s
('sync-missing', (0.078,))
"""
