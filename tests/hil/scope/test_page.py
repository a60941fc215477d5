"""The page in a real browser: no sample is lost, the past is there, nothing is asked of anybody else, by day and by night."""

import threading

import numpy as np
import pytest
from typer.testing import CliRunner

from drive_profiles.address import parse_address
from hil.can.opening import open_channel
from hil.cli.main import app
from hil.report import palette
from tests.hil.report.browser import CHROMIUM, Browser
from tests.hil.scope.recorded import RecordedScope
from tests.hil.scope.traffic import FAULT, OPERATION_ENABLED, Traffic, played

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine (Debian: apt-get install chromium)"),
    pytest.mark.slow,
]
NODES = tuple(range(41, 47))
CYCLES = 2000


class Url(str):
    """An address as `Browser.open` takes it."""

    def as_uri(self):
        return str(self)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


@pytest.fixture(scope="module")
def shown(browser, scope, bus):
    """The page, which has looked on while six drives went through some seconds at 1 kHz."""
    browser.open(Url(scope.url))
    wait(browser, "window.scope && scope.isOpen")
    channel = open_channel(parse_address(bus))
    traffic = Traffic(NODES).set_up().run(CYCLES // 2).emergency(41, 0x3310).run(CYCLES // 2).heard()
    thread = threading.Thread(target=played, args=(channel, traffic, 60.0))
    thread.start()
    before = browser.value("[scope.draws, performance.now()]")
    thread.join()
    channel.close()
    wait(browser, f"scope.store.received >= {CYCLES - 1}")
    return scope, before


def wait(browser, condition):
    for _ in range(300):
        if browser.value(f"Boolean({condition})"):
            return
        browser.value("new Promise(done => setTimeout(done, 50))")
    raise AssertionError(f"not so within a while: {condition}: {browser.value('document.body.innerText')}")


def column(name):
    return f"scope.store.view().columns[scope.signals.findIndex(each => each.name === '{name}')]"


def test_no_sample_is_lost(browser, shown):
    assert browser.value("scope.signals.length") >= 30
    assert browser.value("[scope.store.received, scope.store.lost]") == [CYCLES - 1, 0]
    positions = browser.value(f"[...{column('node 46 position')}]")
    assert positions == pytest.approx([count / 1000 for count in range(CYCLES - 1)])
    assert browser.value(f"[...{column('misses')}].reduce((sum, each) => sum + each, 0)") == 0


def test_it_asks_nobody_else_for_anything(browser, shown):
    scope, _ = shown
    asked = browser.value("performance.getEntriesByType('resource').map(each => each.name)")
    assert len(asked) >= 5
    assert [name for name in asked if not name.startswith((scope.url, scope.url.replace("http", "ws")))] == []
    refused = browser.value("fetch('http://127.0.0.1:9/').then(() => 'asked', error => error.name)")
    assert refused is None or refused == "TypeError"


def test_states_and_emergencies_are_words(browser, shown):
    browser.value("tell()")
    text = browser.value("document.body.innerText")
    assert "operation enabled" in text
    assert "node 41: emergency 3310h: output over-voltage" in text


def test_one_who_comes_late_sees_the_past(browser, shown, tmp_path):
    scope, _ = shown
    with Browser(tmp_path / "late") as late:
        late.open(Url(scope.url))
        wait(late, f"window.scope && scope.store.received >= {CYCLES - 1}")
        assert late.value(f"[...{column('node 43 position')}]") == browser.value(f"[...{column('node 43 position')}]")


def test_what_is_zoomed_stands_still_and_its_spectrum_is_shown(browser, shown):
    begin = browser.value("scope.store.times[scope.store.begin]")
    browser.value(f"scope.figures.zoom({begin + 1.0}, {begin + 1.5})")
    assert browser.value("document.querySelector('#pause').textContent") == "resume"
    wait(browser, "Math.abs(scope.window[1] - scope.window[0] - 0.5) < 1e-6")
    wait(browser, "scope.spectrum.source.data.x.length === 126")
    browser.value("document.querySelector('#pause').click()")
    assert browser.value("scope.frozen") is None


def test_cursors_measure_between_two_samples(browser, shown):
    begin = browser.value("scope.store.times[scope.store.begin]")
    browser.value(f"scope.figures.onCursor('A', {begin + 1.0}); scope.figures.onCursor('B', {begin + 2.0})")
    row = browser.value(
        "[...document.querySelectorAll('#signals tbody tr')].find(row => row.innerText.includes('node 42 position')).innerText"
    )
    assert float(row.split()[-1]) == pytest.approx(0.5, abs=0.002)  # a count in each period of 2 ms
    assert "A to B 1 s" in browser.value("document.querySelector('#state').textContent")


@pytest.mark.parametrize(("width", "is_dark"), [(390, True), (900, False), (1400, True)])
def test_it_fits_narrow_and_wide_by_day_and_by_night(browser, shown, width, is_dark):
    scope, _ = shown
    browser.open(Url(scope.url), width=width, is_dark=is_dark)
    wait(browser, f"window.scope && scope.store.received >= {CYCLES - 1} && scope.draws > 1")
    assert browser.value("document.documentElement.scrollWidth") <= width
    ground = palette.PAPER[1 + is_dark]
    colour = browser.value("getComputedStyle(document.body).backgroundColor")
    assert colour == "rgb({}, {}, {})".format(*(int(ground[place : place + 2], 16) for place in (1, 3, 5)))
    assert browser.value("scope.figures.figures[0].background_fill_color") == ground
    assert browser.value("document.querySelectorAll('#figures .bk-GridPlot, #figures div').length") > 0


def frozen(browser, name):
    """Times of the rows that stand still, and their values of a signal."""
    place = f"scope.signals.findIndex(each => each.name === '{name}')"
    return browser.value(f"[[...scope.frozen.times], [...scope.frozen.columns[{place}]]]")


ARMED = """new Promise(done => {
  const heard = said => { if (typeof said === "string" && JSON.parse(said).kind === "refused") done(true); };
  scope.socket.addEventListener("message", message => heard(message.data));
  scope.socket.send("{");
})"""
"""Questions are answered in their order: with the answer to this one the trigger before it is armed."""


@pytest.mark.parametrize("kind", ["edge", "status", "emcy"])
def test_a_trigger_freezes_the_window_with_the_time_before_it(browser, shown, channel, kind):
    """The form arms it; at the event the page stands still, from 0.1 s before to 0.05 s behind."""
    scope, _ = shown
    browser.open(Url(scope.url))
    wait(browser, "window.scope && scope.store.received >= 1 && scope.figures")
    signal = "node 42 position" if kind == "edge" else "node 43 status word"
    form = {"kind": kind, "signal": signal, "level": 7.1495, "slope": "rising", "before": 0.1, "after": 0.05}
    for name, value in form.items():
        browser.value(f"document.querySelector('#trigger-{name}').value = '{value}'")
    browser.value("document.querySelector('#arm').click()")
    assert browser.value(ARMED)
    traffic = Traffic(NODES)
    traffic.cycle = 7000
    traffic.run(150)
    if kind == "emcy":
        traffic.emergency(44, 0x3310)
    status = FAULT if kind == "status" else OPERATION_ENABLED
    played(channel, traffic.run(150, status=status).heard(), 60.0)
    wait(browser, "scope.frozen && document.querySelector('#trigger-state').textContent.startsWith('triggered at')")
    assert browser.value("document.querySelector('#pause').textContent") == "resume"
    line = browser.value("[scope.figures.spans.trigger[0].visible, scope.figures.spans.trigger[0].location]")
    window = browser.value("[...scope.window]")
    assert line == [True, pytest.approx(window[0] + 0.1)]
    assert window[1] - window[0] == pytest.approx(0.15)
    times, positions = frozen(browser, "node 42 position")
    rows = [row for row, time_s in enumerate(times) if window[0] <= time_s <= window[1]]
    assert len(rows) == pytest.approx(0.15 / (times[-1] - times[-2]), abs=2)
    before = [round(1000 * positions[row]) for row in rows if times[row] < window[0] + 0.1]
    assert before[-1] in {7149, 7150}  # what came just before the event
    assert before == list(range(before[0], before[-1] + 1))
    assert len(before) == pytest.approx(len(rows) * 2 / 3, abs=2)
    wait(browser, "scope.figures.ranges[[...scope.figures.seen][0]].start === scope.window[0]")


def test_the_order_axis_has_its_peak_at_the_order_of_the_robots_error(browser, shown, bus, tmp_path):
    """The gear of axis 2 errs at order 2: while the motor speeds up, the tip's acceleration is drawn at k θ_m."""
    scope, _ = shown
    browser.open(Url(scope.url))
    command = ["run", "constant-acceleration", "--axis", "2", "--bench", "reference", "--bus", bus, "--no-report"]
    done = CliRunner().invoke(app, [*command, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    speed = "scope.store.view().columns[scope.signals.findIndex(each => each.name === 'axis 2 speed')]"
    # the page may be behind the run: the motion is all there when the motor has turned and is at rest again
    wait(browser, f"window.scope && scope.spectrum && {speed} && {speed}.some(each => each > 0.5) && !({speed}.at(-1) > 0.5)")
    browser.value("document.querySelector('#pause').click()")
    times, speeds = frozen(browser, "axis 2 speed")
    moving = [time_s for time_s, rps in zip(times, speeds, strict=True) if rps is not None and rps > 0.5]
    browser.value(f"scope.figures.zoom({min(moving)}, {max(moving)})")
    for name, value in (("signal", "tip z acceleration"), ("axis", "order of axis 2")):
        browser.value(f"document.querySelector('#spectrum-{name}').value = '{value}'")
        browser.value(f"document.querySelector('#spectrum-{name}').dispatchEvent(new Event('change'))")
    wait(browser, "scope.spectrum.isOrder === true")
    assert browser.value("scope.spectrum.figure.below[0].axis_label") == "order k of the motor's angle"
    orders, amplitudes = browser.value("[[...scope.spectrum.source.data.x], [...scope.spectrum.source.data.y]]")
    assert orders[int(np.argmax(amplitudes))] == pytest.approx(2.0, abs=0.11)


def test_rows_that_come_with_a_new_signal_are_counted_once(browser, shown):
    """Three rows of one signal; then, with a second signal, these again and two new ones."""
    one, two = [0, 3, 1, 0, 1, 2, 7, 7, 7], [0, 5, 2, 0, 1, 2, 3, 4, *[7] * 10]
    counted = browser.value(
        f"(() => {{ const store = new Store(true); for (const rows of [{one}, {two}]) store.add(Float64Array.from(rows));"
        " return [store.received, store.lost, store.end]; })()"
    )
    assert counted == [5, 0, 5]


def test_a_recording_says_that_it_is_one(browser, tmp_path):
    time_s = np.arange(3000) * 0.001
    table = np.column_stack([time_s, time_s, time_s, np.zeros_like(time_s)])
    header = "time_s,axis2_reference_rad,axis2_position_rad,axis2_torque_nm"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")
    with RecordedScope(tmp_path) as process:
        browser.open(Url(process.url))
        wait(browser, "document.querySelector('#state').textContent === 'recording; 3000 rows'")
