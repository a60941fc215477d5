"use strict";
// Plotting: what the live page and the reports have in common: colours, and what a window shows of a curve.

const colourOf = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

// Position of the first time that is not before x.
function placeOf(times, x) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < x) low = middle + 1; else high = middle;
  }
  return low;
}

// What is drawn of a window: every sample, or of more than fit the least and the largest in each column of pixels.
function shown(times, values, begin, end, columns) {
  const from = Math.max(0, placeOf(times, begin) - 1), to = Math.min(times.length, placeOf(times, end) + 1);
  const count = to - from;
  if (count <= 2 * columns) return { x: times.slice(from, to), y: values.slice(from, to) };
  const x = new Float64Array(2 * columns), y = new Float64Array(2 * columns);
  for (let column = 0; column < columns; column++) {
    const first = from + Math.floor(column * count / columns), last = from + Math.floor((column + 1) * count / columns);
    let low = first, high = first, missing = true;
    for (let row = first; row < last; row++) {
      const value = values[row];
      if (value !== value) continue;
      if (missing) { low = high = row; missing = false; }
      else if (value < values[low]) low = row;
      else if (value > values[high]) high = row;
    }
    const early = Math.min(low, high), late = Math.max(low, high);
    x[2 * column] = times[early]; y[2 * column] = missing ? NaN : values[early];
    x[2 * column + 1] = times[late]; y[2 * column + 1] = missing ? NaN : values[late];
  }
  return { x, y };
}

// The page's colours, by day or by night, for a figure.
function styled(figure) {
  const ink = colourOf("ink"), grid = colourOf("grid"), edge = colourOf("edge"), paper = colourOf("paper");
  figure.setv({ background_fill_color: paper, border_fill_color: paper, outline_line_color: grid, min_border_left: 70, min_border_right: 10 });
  if (figure.title) figure.title.setv({ text_color: ink, text_font_size: "12px" });
  for (const axis of [...figure.below, ...figure.left])
    axis.setv({ axis_label_text_color: ink, major_label_text_color: ink, axis_line_color: edge, major_tick_line_color: edge, minor_tick_line_color: null });
  for (const lines of figure.center.filter(each => each instanceof Bokeh.Grid)) lines.setv({ grid_line_color: grid });
}
