"use strict";
// The page: rows as they come, the window that is shown, cursors, trigger and spectrum. It sends questions only.

const KEPT_S = 10, DRAW_MS = 60, SPECTRUM_MS = 500, MOST_ASKED = 4, SPECTRUM = -1;
const byId = id => document.getElementById(id);

// The rows of the last seconds, as arrays that grow and are moved to the front when they are full.
class Store {
  constructor(isLive) { this.isLive = isLive; this.begin = this.end = 0; this.width = 0; this.size = 0; this.next = null; this.received = this.lost = 0; }

  add(numbers) {
    const [first, count, width] = numbers;
    if (this.next !== null && first > this.next) this.lost += first - this.next;
    const again = this.next !== null && first < this.next;
    if (again || width !== this.width) { this.begin = this.end = 0; this.width = width; this.size = 0; }
    const times = numbers.subarray(3, 3 + count);
    if (this.end > this.begin && times[0] <= this.times[this.end - 1]) this.begin = this.end = 0; // the bus has begun anew
    this.room(count);
    this.times.set(times, this.end);
    for (let column = 0; column < width; column++)
      this.columns[column].set(numbers.subarray(3 + count * (1 + column), 3 + count * (2 + column)), this.end);
    this.end += count;
    this.received += again ? Math.max(0, first + count - this.next) : count;
    this.next = first + count;
    if (this.isLive) {
      const oldest = this.times[this.end - 1] - KEPT_S;
      while (this.begin < this.end && this.times[this.begin] < oldest) this.begin++;
    }
  }

  room(count) {
    if (this.end + count <= this.size) return;
    const kept = this.end - this.begin, size = Math.max(4096, 2 * (kept + count));
    const moved = old => { const grown = new Float64Array(size); if (old && kept) grown.set(old.subarray(this.begin, this.end)); return grown; };
    this.times = moved(this.times);
    this.columns = Array.from({ length: this.width }, (_, column) => moved(this.columns && this.columns[column]));
    this.begin = 0; this.end = kept; this.size = size;
  }

  view() {
    if (!this.end) return { times: new Float64Array(0), columns: [] };
    return { times: this.times.subarray(this.begin, this.end), columns: this.columns.map(each => each.subarray(this.begin, this.end)) };
  }

  copy() {
    const { times, columns } = this.view();
    return { times: times.slice(), columns: columns.map(each => each.slice()) };
  }
}

const scope = { store: new Store(true), frozen: null, signals: [], layout: null, figures: null, spectrum: null, span: KEPT_S, window: [0, 1], cursors: { A: null, B: null }, pending: null, draws: 0, started: performance.now(), ended: "", isOpen: false, dirty: false, asked: 0, asking: false, pauseMs: SPECTRUM_MS, isChosen: false };
window.scope = scope;

const view = () => scope.frozen || scope.store.view();
const word = value => value !== value ? "–" : Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(2) : String(+value.toPrecision(5));

function textOf(signal, value) {
  if (value === null || value === undefined || value !== value) return "–";
  return signal.quantity === "status word" ? scope.layout.states[value & 0x7f] : word(value);
}

// --- layout ------------------------------------------------------------------------------------------------------------

function lay(layout) {
  const off = new Set(scope.signals.filter(each => !each.isOn).map(each => each.name));
  if (!scope.layout || !layout.is_live) scope.store = new Store(layout.is_live);
  scope.layout = layout;
  scope.signals = layout.signals.map(each => ({ ...each, isOn: !off.has(each.name) }));
  byId("title").textContent = layout.title;
  document.title = `${layout.title} – hil scope`;
  byId("run-choice").hidden = layout.runs.length < 2;
  if (byId("run").options.length !== layout.runs.length) {
    byId("run").replaceChildren(...layout.runs.map(name => new Option(name, name, false, name === layout.title)));
  }
  build();
}

function build() {
  const { signals } = scope;
  scope.figures = new Figures(byId("figures"), signals, scope.layout.states, scope.window);
  scope.figures.onTouched = touched;
  scope.figures.onSeen = () => { scope.dirty = true; };
  scope.figures.onCursor = (name, time) => { scope.cursors[name] = time; scope.figures.mark(name, time); tell(); };
  scope.spectrum = new SpectrumFigure(byId("spectrum"));
  const colours = new Map(scope.figures.lines.map(line => [line.column, line.colour]));
  byId("signals").tBodies[0].replaceChildren(...signals.map((signal, column) => {
    const row = document.createElement("tr"), head = row.insertCell(), label = document.createElement("label"), box = document.createElement("input"), swatch = document.createElement("span");
    box.type = "checkbox"; box.checked = signal.isOn;
    box.addEventListener("change", () => { signal.isOn = box.checked; scope.figures.turn(column, box.checked); scope.dirty = true; });
    swatch.className = "swatch"; swatch.style.background = `var(--${colours.get(column)})`;
    label.append(box, swatch, signal.name + (signal.unit ? ` [${signal.unit}]` : ""));
    head.append(label);
    for (let cell = 0; cell < 4; cell++) row.insertCell();
    return row;
  }));
  signals.forEach((signal, column) => { if (!signal.isOn) scope.figures.turn(column, false); });
  choices("trigger-signal", signals.map(each => each.name));
  choices("spectrum-signal", signals.filter(each => each.quantity !== "status word").map(each => each.name), "tip z acceleration");
  choices("spectrum-axis", ["frequency", ...signals.filter(each => each.quantity === "position" && each.unit === "rev").map(each => `order of ${each.of}`)]);
  for (const name of ["A", "B"]) scope.figures.mark(name, scope.cursors[name]);
  scope.dirty = true;
}

function choices(id, names, preferred) {
  const select = byId(id), before = select.value || preferred;
  select.replaceChildren(...names.map(name => new Option(name, name)));
  if (names.includes(before)) select.value = before;
}

// --- the window --------------------------------------------------------------------------------------------------------

function pause(isPaused) {
  if (isPaused && !scope.frozen) scope.frozen = scope.store.copy();
  if (!isPaused) { scope.frozen = null; scope.cursors = { A: null, B: null }; for (const name of ["A", "B", "trigger"]) scope.figures.mark(name, null); }
  byId("pause").textContent = isPaused ? "resume" : "pause";
  byId("pause").setAttribute("aria-pressed", String(isPaused));
  scope.dirty = true;
  tell();
}

function touched(begin, end) {
  if (scope.layout.is_live && !scope.frozen) pause(true);
  scope.window = [begin, end];
  scope.isZoomed = true;
  scope.dirty = true;
}

function show(span) {
  scope.span = span;
  scope.isZoomed = false;
  const { times } = view();
  if (times.length && (scope.frozen || !scope.layout.is_live)) {
    const last = times[times.length - 1];
    scope.window = [span >= KEPT_S ? times[0] : Math.max(times[0], last - span), last];
    scope.isZoomed = true;
  }
  scope.dirty = true;
}

function follow() {
  const { times } = view();
  if (!times.length || scope.isZoomed || scope.frozen) return;
  const last = times[times.length - 1];
  scope.window = scope.layout.is_live ? [Math.max(last - scope.span, last - KEPT_S), last] : [times[0], last];
}

function tick() {
  const now = performance.now();
  if (scope.pending && scope.store.end) {
    const { time_s, before_s, after_s } = scope.pending, newest = scope.store.times[scope.store.end - 1];
    if (newest >= time_s + after_s || scope.ended) {
      scope.pending = null;
      pause(true);
      scope.window = [time_s - before_s, time_s + after_s];
      scope.isZoomed = true;
      scope.figures.mark("trigger", time_s);
      byId("trigger-state").textContent = `triggered at ${time_s.toFixed(4)} s`;
    }
  }
  if (scope.dirty && scope.figures && now - (scope.drawn || 0) >= DRAW_MS) {
    scope.dirty = false;
    scope.drawn = now;
    follow();
    const { times, columns } = view();
    if (columns.length >= scope.signals.length) scope.figures.draw(times, columns, ...scope.window);
    scope.draws++;
    scope.isStale = true;
  }
  if (scope.isStale) askSpectrum(now);
  requestAnimationFrame(tick);
}

function tell() {
  if (!scope.layout) return;
  tellState();
  const { times, columns } = view();
  if (!columns.length) return;
  const at = time => time === null ? -1 : Math.min(times.length - 1, placeOf(times, time));
  const places = [times.length - 1, at(scope.cursors.A), at(scope.cursors.B)];
  const rows = byId("signals").tBodies[0].rows;
  scope.signals.forEach((signal, column) => {
    if (!rows[column] || !columns[column]) return;
    const [now, a, b] = places.map(place => place < 0 ? null : columns[column][place]);
    const difference = a === null || b === null || signal.quantity === "status word" ? null : b - a;
    [now, a, b].forEach((value, cell) => { rows[column].cells[cell + 1].textContent = textOf(signal, value); });
    rows[column].cells[4].textContent = difference === null ? "–" : word(difference);
  });
}

function tellState() {
  const { A, B } = scope.cursors;
  const apart = A !== null && B !== null ? `; A to B ${word(B - A)} s` : "";
  const state = scope.ended ? (scope.layout.is_live ? `ended: ${scope.ended}` : "recording") : !scope.isOpen ? "connection lost" : scope.frozen ? "paused" : "live";
  const lost = scope.store.lost ? `, ${scope.store.lost} lost` : "";
  byId("state").textContent = `${state}; ${scope.store.received} rows${lost}${apart}`;
  byId("state").classList.toggle("is-bad", scope.store.lost > 0 || (!scope.isOpen && !scope.ended));
}

// --- questions ---------------------------------------------------------------------------------------------------------

function askSpectrum(now) {
  if (scope.asking || !scope.isOpen || (!scope.isChosen && now - scope.asked < scope.pauseMs)) return;
  const { times, columns } = view(), [begin, end] = scope.window;
  const column = scope.signals.findIndex(each => each.name === byId("spectrum-signal").value);
  if (column < 0 || !columns[column]) return;
  const axis = byId("spectrum-axis").value, isOrder = axis.startsWith("order of ");
  const turning = scope.signals.findIndex(each => each.quantity === "position" && `order of ${each.of}` === axis);
  const from = placeOf(times, begin), to = placeOf(times, end);
  const parts = [times, columns[column], ...(isOrder ? [columns[turning]] : [])];
  const message = new Float64Array(2 + parts.length * (to - from));
  message[0] = isOrder ? 1 : 0; message[1] = to - from;
  parts.forEach((part, number) => message.set(part.subarray(from, to), 2 + number * (to - from)));
  scope.asked = now; scope.asking = true; scope.isStale = scope.isChosen = false;
  scope.spectrumUnit = scope.signals[column].unit;
  scope.socket.send(message);
}

byId("trigger").addEventListener("submit", event => {
  event.preventDefault();
  const kind = byId("trigger-kind").value, number = id => Number(byId(id).value);
  const named = kind === "edge" || (kind === "status" && byId("trigger-signal").value.endsWith("status word"));
  const rule = { kind, signal: named ? byId("trigger-signal").value : "", level: number("trigger-level"), slope: byId("trigger-slope").value, before_s: number("trigger-before"), after_s: number("trigger-after") };
  if (scope.frozen && scope.layout.is_live) pause(false);
  scope.pending = null;
  byId("trigger-state").textContent = "armed";
  scope.socket.send(JSON.stringify({ trigger: rule }));
});
byId("disarm").addEventListener("click", () => { scope.pending = null; byId("trigger-state").textContent = "not armed"; scope.socket.send(JSON.stringify({ trigger: null })); });
byId("pause").addEventListener("click", () => pause(!scope.frozen));
for (const button of document.querySelectorAll("[data-span]")) button.addEventListener("click", () => show(Number(button.dataset.span)));
byId("run").addEventListener("change", () => { location.search = "?run=" + encodeURIComponent(byId("run").value); });
for (const id of ["spectrum-signal", "spectrum-axis"]) byId(id).addEventListener("change", () => { scope.isChosen = scope.isStale = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (scope.layout) build(); });

// A spectrum that takes long, as by order of a long window, is asked for less often: the bus is heard by the same program.
function answered() {
  const now = performance.now();
  scope.pauseMs = Math.max(SPECTRUM_MS, MOST_ASKED * (now - scope.asked));
  scope.asking = false;
}

function hearSpectrum(numbers) {
  const count = numbers[1];
  answered();
  byId("spectrum-state").textContent = "";
  scope.spectrum.draw({ is_order: numbers[2] === 1, x: numbers.slice(3, 3 + count), y: numbers.slice(3 + count) }, scope.spectrumUnit);
}

// --- the stream --------------------------------------------------------------------------------------------------------

function hear(message) {
  if (message.data instanceof ArrayBuffer) {
    const numbers = new Float64Array(message.data);
    if (numbers[0] === SPECTRUM) return void hearSpectrum(numbers);
    scope.store.add(numbers);
    if (!scope.frozen) scope.dirty = true;
    return;
  }
  const said = JSON.parse(message.data);
  if (said.kind === "layout") lay(said);
  else if (said.kind === "events") {
    for (const [time, kind, node, words] of said.events) {
      const item = document.createElement("li");
      item.className = kind;
      item.textContent = `${time.toFixed(3)} s, ${node ? "node " + node : "all nodes"}: ${words}`;
      byId("events").prepend(item);
    }
    while (byId("events").children.length > 200) byId("events").lastChild.remove();
  } else if (said.kind === "trigger") { scope.pending = said; }
  else if (said.kind === "refused") { answered(); byId("spectrum-state").textContent = said.words; }
  else if (said.kind === "ended") { scope.ended = said.words; tell(); }
}

function connect() {
  const run = new URLSearchParams(location.search).get("run");
  const socket = new WebSocket(`ws://${location.host}/stream` + (run ? "?run=" + encodeURIComponent(run) : ""));
  socket.binaryType = "arraybuffer";
  socket.addEventListener("open", () => { scope.isOpen = true; scope.asking = false; scope.ended = ""; scope.layout = null; });
  socket.addEventListener("message", hear);
  socket.addEventListener("close", event => { scope.isOpen = false; if (event.code === 1001) scope.ended = event.reason; if (!scope.layout || scope.layout.is_live) setTimeout(connect, 1000); if (scope.layout) tell(); else byId("state").textContent = "connection lost"; });
  scope.socket = socket;
}

connect();
setInterval(tell, 250);
requestAnimationFrame(tick);
