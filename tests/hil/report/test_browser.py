"""The page in a real browser: it is shown, it asks nobody for anything, it prints."""

import os
import shutil
import subprocess

import pytest

from hil.report.pages.demo import write_report

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine (Debian: apt-get install chromium)")


def browse(tmp_path, *arguments):
    command = [
        CHROMIUM, "--headless", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage", "--no-first-run",
        f"--user-data-dir={tmp_path / 'profile'}", *(["--no-sandbox"] if os.geteuid() == 0 else []), *arguments,
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=True)


@pytest.fixture(scope="module")
def page(full_directory):
    return write_report(full_directory)


@pytest.mark.parametrize("width", [390, 900])
def test_it_is_shown(page, tmp_path, width):
    picture = tmp_path / "page.png"
    found = browse(tmp_path, f"--window-size={width},1400", "--hide-scrollbars", f"--screenshot={picture}", page.as_uri())
    assert picture.stat().st_size > 20_000
    assert "Refused to" not in found.stderr


def test_the_browser_reads_it_as_it_was_written(page, tmp_path):
    text = browse(tmp_path, "--dump-dom", page.as_uri()).stdout
    assert text.count("<svg") == text.count("</svg>") == 13
    assert text.count("</figure>") == 13
    assert "&lt;svg" not in text


def test_it_prints(page, tmp_path):
    sheet = tmp_path / "page.pdf"
    browse(tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={sheet}", page.as_uri())
    data = sheet.read_bytes()
    assert data.startswith(b"%PDF")
    assert 6 <= data.count(b"/Type /Page\n") + data.count(b"/Type /Page ") <= 25
