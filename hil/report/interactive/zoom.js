// Zoom: the figures of a report as ones that can be zoomed, drawn with Bokeh when they come on the screen.

const POINTS_ACROSS = 700; // columns of a curve in which the least and the largest value are drawn
const NARROW = 560, MARGIN = 75;
const zoomed = new Map(); // the figures that are drawn, by key

function floats(text) {
  const octets = Uint8Array.from(atob(text), each => each.charCodeAt(0));
  return Float64Array.from(new Float32Array(octets.buffer));
}

class ZoomFigure {
  constructor(panels, place) {
    this.place = place;
    this.width = place.clientWidth;
    this.curves = [];
    this.named = new Map();
    this.figures = new Map();
    this.ranges = new Map();
    place.replaceChildren();
    const narrow = this.width < NARROW;
    const columns = narrow ? 1 : Math.max(...panels.map(each => each.place[1])) + 1;
    const rows = new Map();
    for (const panel of panels) {
      const figure = this.panel(panel, columns, panels);
      const row = narrow ? rows.size : panel.place[0];
      if (!rows.has(row)) rows.set(row, []);
      rows.get(row).push(figure);
      this.figures.set(panel, figure);
    }
    this.names();
    const scale = panels.find(each => each.map);
    if (scale) this.scale(scale.map);
    const plots = document.createElement("div");
    place.append(plots);
    this.shown = Bokeh.Plotting.show(Bokeh.Plotting.gridplot([...rows.values()], { merge_tools: true, toolbar_location: "above" }), plots);
  }

  // Panels below each other that show the same abscissa move together.
  range(panel, abscissa) {
    const range = () => new Bokeh.Range1d({ start: panel.x[0], end: panel.x[1] });
    if (panel.is_square) return range();
    const name = [panel.place[1], abscissa, ...panel.x].join(" ");
    if (!this.ranges.has(name)) this.ranges.set(name, range());
    return this.ranges.get(name);
  }

  panel(panel, columns, panels) {
    const below = panels.find(each => each.place[1] === panel.place[1] && each.place[0] >= panel.place[0] && each.names[0]);
    const xRange = this.range(panel, below ? below.names[0] : ""), yRange = new Bokeh.Range1d({ start: panel.y[0], end: panel.y[1] });
    const width = Math.max(220, Math.floor((this.width - 4) / columns));
    const inner = width - MARGIN - (panel.right ? MARGIN : 10);
    const height = panel.is_square ? Math.round(inner * (panel.y[1] - panel.y[0]) / (panel.x[1] - panel.x[0])) + 60 : 270;
    const figure = Bokeh.Plotting.figure({
      width, height, x_range: xRange, y_range: yRange, x_axis_type: panel.is_log ? "log" : "linear", title: panel.title || null,
      output_backend: "canvas", lod_threshold: null,
      tools: ["pan", "box_zoom", "wheel_zoom", "reset", "crosshair"], active_drag: "box_zoom", active_scroll: null,
    });
    figure.toolbar.logo = null;
    figure.below[0].axis_label = panel.names[0];
    figure.left[0].axis_label = panel.names[1];
    if (panel.right) this.right(figure, panel);
    if (panel.map) this.map(figure, panel.map);
    for (const shade of panel.shades) this.shade(figure, shade);
    for (const curve of panel.curves) this.curve(figure, curve, xRange);
    figure.add_tools(new Bokeh.HoverTool({
      renderers: [...figure.renderers].filter(each => each.glyph instanceof Bokeh.Line || each.glyph instanceof Bokeh.Scatter), mode: "mouse",
      tooltips: [["", "$name"], ["", "@y{%.5g} at @x{%.5g}"]], formatters: { "@x": "printf", "@y": "printf" },
    }));
    for (const line of panel.lines) {
      const across = new Bokeh.Span({
        location: line.at, dimension: line.axis === "x" ? "height" : "width", line_color: colourOf(line.colour), line_dash: [3, 3], line_width: 1.2,
      });
      figure.add_layout(across);
      this.name(line.name, line.colour, true, across);
    }
    styled(figure);
    for (const axis of [...figure.below, ...figure.left, ...figure.right]) axis.axis_label_text_font_size = "11px";
    figure.setv({ min_border_left: MARGIN, min_border_right: panel.right ? MARGIN : 10 });
    return figure;
  }

  // The second scale on the right: proportional, and zoomed with the other.
  right(figure, panel) {
    const [name, factor] = panel.right;
    figure.extra_y_ranges = new Map([["right", new Bokeh.Range1d({ start: factor * panel.y[0], end: factor * panel.y[1] })]]);
    const ink = colourOf("ink"), edge = colourOf("edge");
    figure.add_layout(new Bokeh.LinearAxis({
      y_range_name: "right", axis_label: name, axis_label_text_color: ink, major_label_text_color: ink, axis_line_color: edge, major_tick_line_color: edge, minor_tick_line_color: null,
    }), "right");
  }

  map(figure, map) {
    const { ndarray } = Bokeh.require("core/util/ndarray");
    const values = ndarray(floats(map.values), { dtype: "float64", shape: [map.rows, map.columns] });
    const data = { image: [values], x: [map.x[0]], y: [map.y[0]], dw: [map.x[1] - map.x[0]], dh: [map.y[1] - map.y[0]] };
    const fields = Object.fromEntries(Object.keys(data).map(name => [name, { field: name }]));
    figure.image({
      ...fields, source: new Bokeh.ColumnDataSource({ data }),
      color_mapper: new Bokeh.LinearColorMapper({ palette: map.colours.map(colourOf), low: 0, high: map.top, nan_color: colourOf("paper") }),
    });
  }

  shade(figure, shade) {
    const x = floats(shade.x), y = floats(shade.y), colour = colourOf(shade.colour);
    if (!y.length) figure.add_layout(new Bokeh.BoxAnnotation({ left: x[0], right: x[1], fill_color: colour, fill_alpha: 1, line_color: null, level: "underlay" }));
    else figure.patch([...x], [...y], { fill_color: colour, fill_alpha: 0.45, line_color: null });
  }

  curve(figure, curve, range) {
    const x = floats(curve.x), y = floats(curve.y), source = new Bokeh.ColumnDataSource({ data: { x, y } });
    const colour = colourOf(curve.colour), glyphs = [];
    const look = { source, name: curve.name, line_color: colour, line_width: curve.width, line_dash: curve.is_broken ? [6, 3] : [] };
    if (curve.width > 0) glyphs.push(figure.line({ field: "x" }, { field: "y" }, look));
    if (curve.has_points) glyphs.push(figure.scatter({ field: "x" }, { field: "y" }, { source, name: curve.name, size: 5, fill_color: colour, line_color: colour }));
    for (const glyph of glyphs) this.name(curve.name, curve.colour, curve.is_broken, glyph);
    if (curve.is_rising && x.length > 2 * POINTS_ACROSS) {
      const draw = () => { source.data = shown(x, y, Math.min(range.start, range.end), Math.max(range.start, range.end), POINTS_ACROSS); };
      range.properties.start.change.connect(draw);
      range.properties.end.change.connect(draw);
      draw();
      this.curves.push({ source, x, y });
    }
  }

  name(name, colour, isBroken, glyph) {
    if (!name) return;
    if (!this.named.has(name)) this.named.set(name, { colour, isBroken, glyphs: [] });
    this.named.get(name).glyphs.push(glyph);
  }

  // The legend: each name turns its curves off and on.
  names() {
    const list = document.createElement("div");
    list.className = "zoom-names";
    for (const [name, { colour, isBroken, glyphs }] of this.named) {
      const button = document.createElement("button"), mark = document.createElement("span");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      mark.style.borderColor = `var(--${colour})`;
      if (isBroken) mark.className = "broken";
      button.append(mark, name);
      button.addEventListener("click", () => {
        const isOn = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(isOn));
        for (const glyph of glyphs) glyph.visible = isOn;
      });
      list.append(button);
    }
    if (this.named.size) this.place.append(list);
  }

  scale(map) {
    const line = document.createElement("div");
    line.className = "zoom-scale";
    line.append("0 ");
    for (const colour of map.colours) {
      const box = document.createElement("span");
      box.style.background = `var(--${colour})`;
      line.append(box);
    }
    line.append(` ${map.top.toPrecision(3)} m/s²`);
    this.place.append(line);
  }
}

function drawZoomable() {
  const numbers = JSON.parse(document.getElementById("zoom-numbers").textContent);
  const places = [...document.querySelectorAll(".zoom")].filter(place => numbers[place.dataset.figure]);
  const draw = async place => {
    try {
      const figure = new ZoomFigure(numbers[place.dataset.figure], place);
      zoomed.set(place.dataset.figure, figure);
      await figure.shown;
      figure.isShown = true;
    } catch (error) { // then the picture as it is on paper
      zoomed.delete(place.dataset.figure);
      place.parentElement.classList.remove("is-zoomable");
      console.error(error);
    }
  };
  const observer = new IntersectionObserver(entries => {
    for (const { target, isIntersecting } of entries) if (isIntersecting && !zoomed.has(target.dataset.figure)) draw(target);
  }, { rootMargin: "300px" });
  for (const place of places) {
    place.parentElement.classList.add("is-zoomable");
    observer.observe(place);
  }
  const again = () => { for (const place of places) if (zoomed.has(place.dataset.figure)) draw(place); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; again(); } });
}

drawZoomable();
