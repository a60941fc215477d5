"""Web server of the page, on loopback.

It serves requests of this machine's own page only, and accepts nothing but questions.
"""

import contextlib
import json
import struct
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any

import numpy as np
from pydantic import ValidationError
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from hil.control.arrays import Real
from hil.errors import NotPossibleError
from hil.report import palette
from hil.scope.signals import SignalQuantity, state_words
from hil.scope.sources import PageSource
from hil.scope.spectra import SpectrumError, frequency_spectrum, order_spectrum
from hil.scope.trigger import Trigger, TriggerRule

LOOPBACK = "127.0.0.1"
SENDING_MS = 90.0
"""Period in which rows are sent."""
MOST_QUESTION_BYTES = 16 << 20
SPECTRUM = -1
"""In the place of the first row's number: what follows is a spectrum."""
_HEAD = struct.Struct("<ddd")
_PAGE_FILES = {
    "/": ("scope.html", "text/html; charset=utf-8"),
    "/scope.js": ("scope.js", "text/javascript; charset=utf-8"),
    "/drawing.js": ("drawing.js", "text/javascript; charset=utf-8"),
    "/scope.css": ("scope.css", "text/css; charset=utf-8"),
}
_LIBRARY_FILES = {"/bokeh.min.js": "bokeh.min.js", "/bokeh-api.min.js": "bokeh-api.min.js"}
_ICON = (
    "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'>"
    "<path d='M1 8h3l2-6 4 12 2-6h3' fill='none' stroke='#0072b2'/></svg>"
)


def page_files() -> dict[str, tuple[bytes, str]]:
    """Contents and types of everything that the page needs, by path."""
    page, library = resources.files("hil.scope") / "page", resources.files("bokeh") / "server" / "static" / "js"
    found = {path: ((page / name).read_bytes(), kind) for path, (name, kind) in _PAGE_FILES.items()}
    script = "text/javascript; charset=utf-8"
    found |= {path: ((library / name).read_bytes(), script) for path, name in _LIBRARY_FILES.items()}
    found["/plotting.js"] = (resources.files("hil.report.interactive") / "plotting.js").read_bytes(), script
    colours = palette.css(":root").encode()
    return found | {"/colours.css": (colours, "text/css; charset=utf-8"), "/icon.svg": (_ICON.encode(), "image/svg+xml")}


class _Guarded(RequestHandler):
    """A handler that serves this machine's page only."""

    def prepare(self) -> None:
        """Refuse other host names and other origins.

        With them, a foreign page could reach loopback.
        """
        refuse_foreign(self.request, self.settings["port"])

    def set_default_headers(self) -> None:
        """Let the page load nothing from elsewhere."""
        own = f"ws://127.0.0.1:{self.settings['port']} ws://localhost:{self.settings['port']}"
        self.set_header(
            "Content-Security-Policy",
            "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"font-src 'self' data:; connect-src 'self' {own}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        )
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")


def refuse_foreign(request: HTTPServerRequest, port: int) -> None:
    """Refuse a request for another host, or from another page.

    Raises:
        HTTPError: 403.
    """
    hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}
    if request.headers.get_list("Host") not in [[host] for host in hosts]:
        raise HTTPError(403, reason="another host")
    origins = request.headers.get_list("Origin")
    if origins and (len(origins) > 1 or origins[0] not in {f"http://{host}" for host in hosts}):
        raise HTTPError(403, reason="another origin")


class _File(_Guarded):
    def get(self, path: str) -> None:
        content, kind = self.settings["files"][path]
        self.set_header("Content-Type", kind)
        self.finish(content)


class _Viewer(_Guarded, WebSocketHandler):
    """A page's connection: first past rows, then new ones."""

    def open(self, *_args: str, **_kwargs: str) -> None:
        """Choose the source, and send its signals and past rows."""
        name = self.get_query_argument("run", "")
        self.set_nodelay(True)
        self._row, self._events, self._width = 0, 0, -1
        self._is_sending, self._has_ended = False, False
        self._trigger: Trigger | None = None
        self._trigger_row, self._trigger_event = 0, 0
        self.source: PageSource | None = self.settings["choose"](name)
        if self.source is None:
            self.close(1008, "no such run")
            return
        self.settings["viewers"].add(self)
        self.step()

    def check_origin(self, origin: str) -> bool:
        """True: `prepare` has refused all others."""
        return True

    def on_close(self) -> None:
        """Forget the page."""
        self.settings["viewers"].discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Answer a question: a trigger, or a spectrum of the page's samples."""
        if isinstance(message, bytes):
            IOLoop.current().spawn_callback(self._answer, message)
            return
        try:
            asked = json.loads(message)
            rule = asked["trigger"]
            self._trigger = None if rule is None else Trigger(TriggerRule.model_validate(rule))
        except (ValueError, KeyError, TypeError, ValidationError):
            self._tell({"kind": "refused", "words": "no trigger"})
            return
        source = self.source
        if source is not None:
            self._trigger_row = source.past.end if source.is_live else 0
            self._trigger_event = source.event_count if source.is_live else 0
            self.step()

    async def _answer(self, message: bytes) -> None:
        answer = await IOLoop.current().run_in_executor(None, spectrum_answer, message)
        if isinstance(answer, str):
            self._tell({"kind": "refused", "words": answer})
            return
        with contextlib.suppress(WebSocketClosedError):
            self.write_message(answer, binary=True)

    def step(self) -> None:
        """Send new rows, unless the page has not taken the last."""
        source = self.source
        if source is None or self._is_sending:
            return
        if len(source.signals) != self._width:
            self._width = len(source.signals)
            self._row = source.past.first
            self._tell(self.settings["layout"](source))
        fresh = source.event_count - self._events
        if fresh:
            events = list(source.events)[-fresh:]
            self._events = source.event_count
            self._tell({"kind": "events", "events": [[each.time_s, each.kind, each.node, each.words] for each in events]})
        first, time_s, values = source.past.since(self._row)
        if len(time_s):
            self._row = first + len(time_s)
            self._is_sending = True
            IOLoop.current().spawn_callback(self._send, self.settings["encode"](first, time_s, values))
        self._try_trigger(source)
        if source.ended and not self._has_ended:
            self._has_ended = True
            self._tell({"kind": "ended", "words": source.ended})

    async def _send(self, octets: bytes) -> None:
        try:
            await self.write_message(octets, binary=True)
        except WebSocketClosedError:
            return
        self._is_sending = False

    def _try_trigger(self, source: PageSource) -> None:
        if self._trigger is None:
            return
        rule = self._trigger.rule
        first, time_s, values = source.past.since(self._trigger_row)
        self._trigger_row = first + len(time_s)
        fresh = source.event_count - self._trigger_event
        self._trigger_event = source.event_count
        emergencies = [each.time_s for each in list(source.events)[-fresh:] if each.kind == "emcy"] if fresh else []
        columns = [
            column
            for column, signal in enumerate(source.signals[: values.shape[1]])
            if (signal.name == rule.signal if rule.signal else signal.quantity is SignalQuantity.STATUS_WORD)
        ]
        fired_s = self._trigger.feed(time_s, values[:, columns], emergencies)
        if fired_s is not None:
            self._trigger = None
            self._tell({"kind": "trigger", "time_s": fired_s, "before_s": rule.before_s, "after_s": rule.after_s})

    def _tell(self, what: Mapping[str, Any]) -> None:
        try:
            self.write_message(json.dumps(what))
        except WebSocketClosedError:
            return


def encoded(first: int, time_s: Real, values: Real) -> bytes:
    """Encode rows for the page.

    Number of the first row, of rows and of signals, the times, and each signal in turn.
    """
    head = _HEAD.pack(first, len(time_s), values.shape[1])
    return head + time_s.astype("<f8").tobytes() + np.ascontiguousarray(values.T, "<f8").tobytes()


def spectrum_answer(message: bytes) -> bytes | str:
    """Compute the spectrum of samples from the page.

    The samples are 0 or 1 for an order spectrum, their number n, n times, n values, and for orders n angles in rev.

    Returns:
        Numbers as rows are sent, with −1 for the number of the first: of m points, their number, 0 or 1, m frequencies or orders,
        and m amplitudes; or the reason why there are none.
    """
    try:
        numbers = np.frombuffer(message, "<f8")
        is_order, count = bool(numbers[0]), int(numbers[1])
        parts = numbers[2:].reshape(3 if is_order else 2, count)
        x, y = order_spectrum(*parts) if is_order else frequency_spectrum(*parts)
    except SpectrumError as error:
        return str(error)
    except (ValueError, IndexError, OverflowError):
        return "no samples"
    return _HEAD.pack(SPECTRUM, len(x), is_order) + x.astype("<f8").tobytes() + y.astype("<f8").tobytes()


class ScopeServer:
    """Server of one page, of a bus or of recordings, on loopback.

    Args:
        choose: Source by the name of a run; "" for the first, None if there is none of the name.
        runs: Names of the runs; empty for a bus.
        port: Port; 0 for one that is free.

    Raises:
        NotPossibleError: The port is taken.
    """

    def __init__(self, choose: Callable[[str], PageSource | None], runs: tuple[str, ...], port: int) -> None:
        try:
            sockets = bind_sockets(port, LOOPBACK)
        except OSError as error:
            raise NotPossibleError(f"port {port} of {LOOPBACK}: {error.strerror or error}; port 0 takes a free one") from error
        self.port: int = sockets[0].getsockname()[1]
        self._viewers: set[_Viewer] = set()
        self._choose, self._runs = choose, runs
        self._encoded: tuple[tuple[int, int, int], bytes] | None = None
        files = page_files()
        pattern = "(" + "|".join(files) + ")"
        application = Application(
            [(pattern, _File), ("/stream", _Viewer)],
            port=self.port, files=files, choose=choose, viewers=self._viewers, layout=self._layout, encode=self._encode,
            websocket_max_message_size=MOST_QUESTION_BYTES, log_function=lambda handler: None,
        )  # fmt: skip
        self._server = HTTPServer(application)
        self._server.add_sockets(sockets)
        self._sending = PeriodicCallback(self._step_all, SENDING_MS)
        self._sending.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.port}/"

    def _layout(self, source: PageSource) -> dict[str, Any]:
        return {
            "kind": "layout", "title": source.title, "is_live": source.is_live, "runs": self._runs, "states": state_words(),
            "signals": [signal.entry for signal in source.signals],
        }  # fmt: skip

    def _encode(self, first: int, time_s: Real, values: Real) -> bytes:
        """Rows, encoded once for all viewers who are equally far."""
        key = (first, len(time_s), values.shape[1])
        if self._runs or self._encoded is None or self._encoded[0] != key:
            self._encoded = key, encoded(first, time_s, values)
        return self._encoded[1]

    def _step_all(self) -> None:
        if not self._runs and (source := self._choose("")) is not None:
            source.poll()
        for viewer in list(self._viewers):
            viewer.step()

    async def close(self) -> None:
        """Send the remaining rows, and stop."""
        self._sending.stop()
        self._step_all()
        for viewer in list(self._viewers):
            viewer.close(1001, "the scope has ended")
        self._server.stop()
        await self._server.close_all_connections()
