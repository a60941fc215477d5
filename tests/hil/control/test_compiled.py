"""The door to the compiler: the same numbers as Python, and never yesterday's code."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numba.core import config as numba_config

from hil.control.notch import notch_coefficients

ROOT = Path(__file__).parents[3]

INNER = "from hil.control.compiled import compiled\n\n\n@compiled\ndef inner(x):\n    return x + {constant}\n"
OUTER = """
from hil.control.compiled import compiled
from gadget.deep.inner import inner


@compiled
def outer(x):
    return 10.0 * inner(x)


print(outer(1.0), sum(outer.stats.cache_hits.values()))
"""


def run_gadget(folder):
    path = os.pathsep.join([str(folder), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-m", "gadget.outer"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_code_inlined_from_a_folder_below_is_compiled_anew_when_its_source_changes(tmp_path):
    """The compiled period of the emulated drive inlines the plant of `physics/`: an edit there must reach it."""
    deep = tmp_path / "gadget" / "deep"
    deep.mkdir(parents=True)
    (tmp_path / "gadget" / "outer.py").write_text(OUTER, encoding="utf-8")
    (deep / "inner.py").write_text(INNER.format(constant=1.0), encoding="utf-8")
    assert run_gadget(tmp_path) == (20.0, 0)
    assert run_gadget(tmp_path) == (20.0, 1)  # unchanged: from the disk
    (deep / "inner.py").write_text(INNER.format(constant=2.0), encoding="utf-8")
    assert run_gadget(tmp_path) == (30.0, 0)


def test_the_compiler_keeps_ieee_arithmetic_bit_for_bit():
    rng = np.random.default_rng(4)
    for _ in range(200):
        arguments = (*rng.uniform(1.0, 40.0, 2), *rng.uniform(0.01, 0.5, 2), 250e-6)
        assert notch_coefficients(*arguments) == notch_coefficients.py_func(*arguments)


def test_a_division_by_zero_is_a_number_of_ieee_and_no_exception():
    assert not all(math.isfinite(value) for value in notch_coefficients(0.0, 0.0, 0.1, 0.1, 250e-6))


def test_other_users_of_numba_keep_their_own_cache_folder():
    assert "compiled-" not in numba_config.CACHE_DIR
