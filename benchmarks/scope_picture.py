"""The picture of the scope in its documentation: the page beside a run of the emulated robot, in headless Chromium.

python -m benchmarks.scope_picture docs/scope.png
"""

import argparse
import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from benchmarks.scope import Url
from hil.emulator import EmulatorProcess
from hil.scope.process import ScopeProcess
from tests.hil.report.browser import Browser

WIDTH, HEIGHT, COLOURS = 1180, 980, 192
SHOWN = """
const column = scope.signals.findIndex(each => each.name === "axis 2 speed");
pause(true);
const times = scope.frozen.times, speeds = scope.frozen.columns[column];
const moving = times.filter((_, row) => speeds[row] > 0.3);
scope.figures.zoom(moving[0] - 0.3, moving[moving.length - 1] + 0.3);
byId("title").textContent = "reference on local:/tmp/robot.sock";
for (const [id, value] of [["spectrum-signal", "tip z acceleration"], ["spectrum-axis", "order of axis 2"]]) {
  byId(id).value = value;
  byId(id).dispatchEvent(new Event("change"));
}
"""
"""The motion of axis 2, and beside it the tip's acceleration by order of the motor's angle."""


def wait(browser: Browser, condition: str) -> None:
    """Wait until something is so in the page."""
    deadline = time.monotonic() + 60.0
    while not browser.value(f"Boolean({condition})"):
        if time.monotonic() > deadline:
            raise TimeoutError(condition)
        time.sleep(0.2)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    file = parser.parse_args().file
    with (
        tempfile.TemporaryDirectory() as folder,
        EmulatorProcess("reference") as emulator,
        ScopeProcess(str(emulator.address), "reference", 0) as scope,
        Browser(Path(folder, "profile")) as browser,
    ):
        browser.open(Url(scope.url), width=WIDTH, height=HEIGHT)
        run = [
            sys.executable, "-m", "hil", "run", "constant-acceleration", "--axis", "2", "--bench", "reference", "--no-report",
            "--bus", str(emulator.address), "--out", str(Path(folder, "run")),
        ]  # fmt: skip
        subprocess.run(run, check=True, capture_output=True)  # noqa: S603 - our own interpreter and module
        wait(browser, "scope.signals.some(each => each.name === 'axis 2 speed')")
        time.sleep(1.0)
        browser.value(f"{{{SHOWN}}} 0")
        wait(browser, "scope.spectrum.isOrder")
        time.sleep(2.0)
        picture = Image.open(io.BytesIO(browser.picture())).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        picture.save(file, optimize=True)
    print(f"{file}: {file.stat().st_size} bytes")  # noqa: T201


if __name__ == "__main__":
    main()
