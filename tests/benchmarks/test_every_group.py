"""Each group of `make bench` runs to its end."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import groups


@pytest.mark.slow
@pytest.mark.parametrize("group", sorted(groups(1)))
def test_each_group_runs_and_each_of_its_sections_has_a_table(group: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    command = [sys.executable, "-m", "benchmarks", group, "--once", "--out", str(page)]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    sections = page.read_text(encoding="utf-8").split("\n## ")[1:]
    assert [section.partition("\n")[0] for section in sections] == [title for title, _, _ in groups(1)[group]]
    assert all("\n|" in section for section in sections)
