"use strict";
// Drawing: what a window shows of a signal, and the figures that show it.

const COLOURS = ["blue", "vermillion", "green", "purple", "orange", "sky", "ink", "grey"];
// Up to a pixel a browser without a GPU draws a line in a fraction of the time that it takes to outline a wider one.
const LINE_WIDTH = 1;

// A range that holds all values, and does not tremble with each of them.
function fit(range, low, high) {
  if (!(high >= low)) return;
  const height = high - low || Math.abs(high) * 0.2 || 1, margin = 0.1 * height;
  const room = range.end - range.start;
  const fits = low >= range.start && high <= range.end && room < 2.5 * (height + 2 * margin);
  if (!fits) range.setv({ start: low - margin, end: high + margin });
}

function span(colour, dash) {
  return new Bokeh.Span({ location: 0, dimension: "height", line_color: colour, line_dash: dash, line_width: 1.5, visible: false });
}

// Bokeh asks the style sheets for colour and width of each part of an axis, each time that it draws: a fifth of the time, and this
// page sets none of them there.
function askNoStyles(figure) {
  const view = Bokeh.index.find_one(figure);
  for (let kind = view && [...view.visuals][0]; kind; kind = Object.getPrototypeOf(kind))
    if (Object.hasOwn(kind, "_get_css_value")) kind._get_css_value = () => "";
}

// The figures against time: one for each quantity, all with the same window.
class Figures {
  constructor(place, signals, states, window_) {
    this.place = place;
    this.window = window_;
    this.ranges = [];
    this.seen = new Set(); // figures on the screen: the others are not drawn
    this.lines = [];
    this.figures = [];
    this.spans = { A: [], B: [], trigger: [] };
    this.isOwn = false;
    this.onTouched = () => {};
    this.onCursor = () => {};
    this.onSeen = () => {};
    const quantities = [...new Set(signals.map(each => each.quantity))];
    for (const quantity of this.order(quantities)) this.addFigure(quantity, signals, states);
    place.replaceChildren();
    if (!this.figures.length) return;
    this.figures[this.figures.length - 1].below[0].axis_label = "time [s]";
    const tools = { merge_tools: true, toolbar_location: "above", sizing_mode: "stretch_width" };
    this.watch(Bokeh.Plotting.show(Bokeh.Plotting.gridplot(this.figures.map(each => [each]), tools), place));
  }

  // Learn which figures are on the screen.
  async watch(shown) {
    await shown;
    askNoStyles(this.figures[0]);
    const numbers = new Map();
    const observer = new IntersectionObserver(entries => {
      for (const entry of entries) this.seen[entry.isIntersecting ? "add" : "delete"](numbers.get(entry.target));
      this.onSeen();
    });
    this.figures.forEach((figure, number) => {
      const view = Bokeh.index.find_one(figure);
      if (!view) return void this.seen.add(number);
      numbers.set(view.el, number);
      observer.observe(view.el);
    });
  }

  zoom(begin, end) {
    this.ranges[0].setv({ start: begin, end });
  }

  order(quantities) {
    const wanted = ["position", "speed", "following error", "torque", "tip acceleration", "notch frequency", "bus load", "misses", "SYNC interval", "status word"];
    return wanted.filter(each => quantities.includes(each));
  }

  addFigure(quantity, signals, states) {
    const own = signals.map((signal, column) => ({ signal, column })).filter(each => each.signal.quantity === quantity);
    const unit = own[0].signal.unit;
    const isState = quantity === "status word";
    const yRange = new Bokeh.Range1d({ start: isState ? -0.5 : 0, end: isState ? 7.5 : 1 });
    const range = new Bokeh.Range1d({ start: 0, end: 1 }), number = this.figures.length;
    const changed = () => { if (!this.isOwn) this.onTouched(range.start, range.end); };
    range.properties.start.change.connect(changed);
    range.properties.end.change.connect(changed);
    this.ranges.push(range);
    const figure = Bokeh.Plotting.figure({
      height: isState ? 190 : 145, sizing_mode: "stretch_width", x_range: range, y_range: yRange, output_backend: "canvas",
      tools: ["xpan", "xbox_zoom", "xwheel_zoom", "crosshair"], title: quantity + (unit ? ` [${unit}]` : ""), lod_threshold: null,
    });
    figure.toolbar.logo = null;
    if (isState) {
      const words = [...new Set(states)].filter(word => word !== "unknown state");
      this.stateOf = states.map(word => words.indexOf(word));
      figure.left[0].ticker = new Bokeh.FixedTicker({ ticks: words.map((_, place) => place) });
      figure.left[0].major_label_overrides = new Map(words.map((word, place) => [place, word]));
    }
    own.forEach(({ column }, place) => {
      const source = new Bokeh.ColumnDataSource({ data: { x: [], y: [] } });
      const colour = COLOURS[place % COLOURS.length];
      const glyph = figure.line({ field: "x" }, { field: "y" }, { source, line_color: colourOf(colour), line_width: LINE_WIDTH });
      this.lines.push({ number, column, source, glyph, figure, isState, colour, yRange, isOn: true });
    });
    for (const [name, colour, dash] of [["A", "green", "solid"], ["B", "purple", "solid"], ["trigger", "orange", "dashed"]]) {
      const line = span(colourOf(colour), dash);
      figure.add_layout(line);
      this.spans[name].push(line);
    }
    figure.on_event("tap", event => this.onCursor(event.modifiers && event.modifiers.shift ? "B" : "A", event.x));
    styled(figure);
    this.figures.push(figure);
  }

  mark(name, time) {
    for (const line of this.spans[name]) line.setv(time === null ? { visible: false } : { location: time, visible: true });
  }

  turn(column, isOn) {
    for (const line of this.lines) if (line.column === column) { line.isOn = isOn; line.glyph.visible = isOn; }
  }

  draw(times, columns, begin, end) {
    this.isOwn = true;
    for (const number of this.seen) this.ranges[number].setv({ start: begin, end });
    this.isOwn = false;
    const width = Math.max(150, Math.min(350, (this.place.clientWidth - 80) >> 1));
    const extents = new Map();
    for (const line of this.lines) {
      if (!line.isOn || !this.seen.has(line.number)) continue;
      const data = shown(times, columns[line.column], begin, end, width);
      if (line.isState) {
        data.y = data.y.map(value => value === value ? this.stateOf[value & 0x7f] : NaN);
      } else {
        const extent = extents.get(line.yRange) || [Infinity, -Infinity];
        for (const value of data.y) { if (value < extent[0]) extent[0] = value; if (value > extent[1]) extent[1] = value; }
        extents.set(line.yRange, extent);
      }
      line.source.data = data;
    }
    for (const [range, [low, high]] of extents) fit(range, low, high);
  }
}

// The figure of a spectrum.
class SpectrumFigure {
  constructor(place) {
    this.source = new Bokeh.ColumnDataSource({ data: { x: [], y: [] } });
    this.figure = Bokeh.Plotting.figure({
      x_range: new Bokeh.Range1d({ start: 0, end: 1 }), y_range: new Bokeh.Range1d({ start: 0, end: 1 }), height: 240, sizing_mode: "stretch_width", output_backend: "canvas", tools: ["xpan", "xbox_zoom", "xwheel_zoom", "crosshair"], toolbar_location: "above",
    });
    this.figure.toolbar.logo = null;
    this.figure.line({ field: "x" }, { field: "y" }, { source: this.source, line_color: colourOf("blue"), line_width: LINE_WIDTH });
    styled(this.figure);
    place.replaceChildren();
    Bokeh.Plotting.show(this.figure, place);
  }

  draw(answer, unit) {
    this.figure.below[0].axis_label = answer.is_order ? "order k of the motor's angle" : "frequency [Hz]";
    this.figure.left[0].axis_label = `amplitude [${unit || "1"}]`;
    const { x, y } = answer, last = x[x.length - 1];
    if (answer.is_order !== this.isOrder || last > 1.02 * this.last || last < 0.98 * this.last) this.figure.x_range.setv({ start: 0, end: last });
    this.isOrder = answer.is_order; this.last = last;
    fit(this.figure.y_range, 0, y.reduce((most, each) => Math.max(most, each), 0));
    this.source.data = { x, y };
  }
}
