"""A headless Chromium that is asked over its debugging pipe: no port, no package of its own."""

import base64
import json
import os
import select
import shutil
import subprocess
import time

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
DEADLINE_S = 90.0


class Browser:
    """One page of a headless browser; close it, or use it as a context."""

    def __init__(self, profile):
        if CHROMIUM is None:
            raise RuntimeError("no chromium on this machine")
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        self._rest, self._number = b"", 0
        command = [
            CHROMIUM, "--headless", "--disable-gpu", "--disable-background-networking", "--disable-dev-shm-usage",
            "--no-first-run", f"--user-data-dir={profile}", "--remote-debugging-pipe", "--hide-scrollbars",
            *(["--no-sandbox"] if os.geteuid() == 0 else []), "about:blank",
        ]  # fmt: skip
        # Chromium reads commands on descriptor 3 and answers on 4
        shell = f'exec 3<&{to_browser} 4>&{from_browser}; exec "$@"'
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", shell, "bash", *command],
            pass_fds=(to_browser, from_browser),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.ask("Page.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """End the browser."""
        self._process.terminate()
        self._process.wait(timeout=20)
        os.close(self._write)
        os.close(self._read)

    def ask(self, method, **params):
        """Answer of the page to a command of the DevTools protocol."""
        return self._ask(method, self._session, **params)

    def _ask(self, method, session=None, **params):
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        answer = self._until(lambda found: found.get("id") == self._number)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def _until(self, is_wanted):
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            while b"\0" in self._rest:
                text, self._rest = self._rest.split(b"\0", 1)
                found = json.loads(text)
                if is_wanted(found):
                    return found
            if select.select([self._read], [], [], 1.0)[0]:
                self._rest += os.read(self._read, 1 << 20)
        raise TimeoutError("the browser does not answer")

    def open(self, page, *, width=1400, height=1000, is_dark=False, media=""):
        """Show a file at a width, by day or by night, on a screen or on paper (`media="print"`)."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self.ask("Emulation.setEmulatedMedia", media=media, features=[scheme])
        self.ask("Page.navigate", url=page.as_uri())
        self._until(lambda found: found.get("method") == "Page.loadEventFired")

    def value(self, expression):
        """Value of a JavaScript expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"])
        return answer["result"].get("value")

    def picture(self, *, is_whole=False):
        """PNG of what is shown, or of the whole page."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=is_whole)["data"])

    def print(self):
        """PDF of the page."""
        return base64.b64decode(self.ask("Page.printToPDF", preferCSSPageSize=True, printBackground=True)["data"])
