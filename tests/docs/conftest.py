"""The shell in which the commands of a page are typed."""

import shutil
import sys
import tempfile
from pathlib import Path

import pytest

from tests.docs.pages import BASH, Shell


@pytest.fixture
def shell(tmp_path):
    if not (Path(sys.prefix) / "bin" / "activate").is_file() or BASH is None:
        pytest.skip("no virtual environment, or no bash")
    place = Path(tempfile.mkdtemp(prefix="docs"))
    with Shell(tmp_path, place) as opened:
        yield opened
    shutil.rmtree(place, ignore_errors=True)
