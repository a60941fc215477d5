"""A tool calculates with one thread, unless its user says otherwise."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = """
import os
class app:
    def run(): print(os.environ["OPENBLAS_NUM_THREADS"])
"""


@pytest.mark.parametrize(("given", "wanted"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_the_user_asks_for_more(tmp_path: Path, given: str | None, wanted: str) -> None:
    (tmp_path / "thing" / "cli").mkdir(parents=True)
    (tmp_path / "thing" / "cli" / "main.py").write_text(TOOL, encoding="utf-8")
    without = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment = without | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    words = "from drive_profiles.cli.entry import start; start('thing')"
    done = subprocess.run([sys.executable, "-c", words], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == wanted
