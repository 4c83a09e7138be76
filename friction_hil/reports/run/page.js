"use strict";
// Draws the signals of a run with Plotly, and draws them anew, in more detail, when the range of time changes.

// ---- pure functions, tested without a browser ----

function decoded(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return new Kind(bytes.buffer);
}

// Index of the first time that is not less than `value`; times do not decrease.
function firstFrom(time, value) {
  let low = 0, high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

// Rows of a range of time, with one more at either end, so that lines reach the edges.
function rowsBetween(time, from, to) {
  return [Math.max(firstFrom(time, from) - 1, 0), Math.min(firstFrom(time, to) + 2, time.length)];
}

// The smallest and the largest value of each bucket, in their order, at their own times.
function reduced(time, values, from, to, most) {
  const [begin, end] = rowsBetween(time, from, to);
  const x = [], y = [];
  const size = end - begin <= most ? 1 : Math.ceil((2 * (end - begin)) / most);
  for (let start = begin; start < end; start += size) {
    const stop = Math.min(start + size, end);
    let low = -1, high = -1;
    for (let row = start; row < stop; row++) {
      const value = values[row];
      if (Number.isNaN(value)) continue;
      if (low < 0 || value < values[low]) low = row;
      if (high < 0 || value > values[high]) high = row;
    }
    if (low < 0) {
      x.push(time[start]);
      y.push(null);
    } else {
      x.push(time[Math.min(low, high)]);
      y.push(values[Math.min(low, high)]);
      if (low !== high) {
        x.push(time[Math.max(low, high)]);
        y.push(values[Math.max(low, high)]);
      }
    }
  }
  return {x, y};
}

// ---- the page ----

const MOST_POINTS = 3000;
const FONT = {family: "system-ui, sans-serif", size: 13, color: "#222222"};
// Exactly these buttons: by default there is one that sends the data to a server.
const BUTTONS = [["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"], ["toImage"]];
const SETTINGS = {responsive: true, displaylogo: false, scrollZoom: true, modeBarButtons: BUTTONS};
const GRID = {gridcolor: "#e6e6e6", zerolinecolor: "#c8c8c8", showline: true, linecolor: "#888888", ticks: "outside"};

function timeTraces(view) {
  const traces = [], signals = [];
  view.panels.forEach((panel, k) => {
    const axis = k ? `y${k + 1}` : "y";
    for (const line of panel.lines) {
      traces.push({
        name: line.name, yaxis: axis, legend: k ? `legend${k + 1}` : "legend", mode: "lines", x: [], y: [],
        line: {color: line.color, width: line.width + 0.3, dash: line.is_dashed ? "dash" : "solid"},
        hovertemplate: `%{y:.5g} ${panel.unit}`,
      });
      signals.push(decoded(line.data, Float32Array));
    }
  });
  return {traces, signals};
}

function markTraces(view, axis) {
  const shown = (marks, name, color, symbol) => ({
    name, yaxis: axis, mode: "markers", showlegend: false, x: marks.map((each) => each.time_s),
    y: marks.map(() => 0), text: marks.map((each) => each.text), hovertemplate: "%{text}",
    marker: {color, symbol, size: 9},
  });
  return [
    shown(view.missed, "missed", view.colors.fault, "line-ns-open"),
    shown(view.marks.filter((each) => !each.is_fault), "event", view.colors.event, "circle"),
    shown(view.marks.filter((each) => each.is_fault), "fault", view.colors.fault, "x"),
  ];
}

function timeLayout(view) {
  const count = view.panels.length, top = 0.94, gap = 0.025;
  const height = (top - gap * count) / Math.max(count, 1);
  const last = count + 1;
  const layout = {
    font: FONT, height: 130 + 190 * count, margin: {l: 80, r: 215, t: 10, b: 45}, hovermode: "x unified",
    hoversubplots: "axis", dragmode: "zoom", paper_bgcolor: "white", plot_bgcolor: "white",
    xaxis: {...GRID, title: {text: "time [s]"}, range: view.range, anchor: count > 1 ? `y${count}` : "y", hoverformat: ".4f"},
    shapes: [],
  };
  view.panels.forEach((panel, k) => {
    const end = top - k * (height + gap);
    layout[k ? `yaxis${k + 1}` : "yaxis"] = {...GRID, domain: [end - height, end], title: {text: panel.label}};
    layout[k ? `legend${k + 1}` : "legend"] = {x: 1.01, y: end, yanchor: "top", font: {size: 12}};
    if (panel.name === "error") {
      const axis = k ? `y${k + 1}` : "y";
      for (const span of view.spans) {
        layout.shapes.push({
          type: "rect", x0: span.from, x1: span.to, yref: `${axis} domain`, y0: 0, y1: 1, fillcolor: span.color,
          opacity: 0.1, line: {width: 0}, layer: "below",
        });
      }
    }
  });
  layout[`yaxis${last}`] = {domain: [top + 0.01, 1], visible: false, fixedrange: true, range: [-1, 1]};
  for (const mark of view.marks) {
    layout.shapes.push({
      type: "line", x0: mark.time_s, x1: mark.time_s, yref: "paper", y0: 0, y1: 1, layer: "below",
      line: {color: mark.is_fault ? view.colors.fault : view.colors.event, width: 1, dash: mark.is_fault ? "solid" : "dot"},
    });
  }
  return layout;
}

async function drawTime(place, view, others) {
  const time = decoded(view.time, Float64Array);
  const {traces, signals} = timeTraces(view);
  const draw = (from, to) => signals.map((values) => reduced(time, values, from, to, MOST_POINTS));
  draw(...view.range).forEach((each, k) => Object.assign(traces[k], each));
  const marks = markTraces(view, `y${view.panels.length + 1}`);
  await Plotly.newPlot(place, [...traces, ...marks], timeLayout(view), SETTINGS);
  const numbers = signals.map((_, k) => k);
  let shown = `${view.range}`;
  const refine = async () => {
    const axis = place.layout.xaxis;
    if (axis.autorange) await Plotly.relayout(place, {"xaxis.autorange": false, "xaxis.range": view.range});
    const range = place.layout.xaxis.range.map(Number);
    if (`${range}` === shown) return;
    shown = `${range}`;
    const parts = draw(...range);
    await Plotly.restyle(place, {x: parts.map((each) => each.x), y: parts.map((each) => each.y)}, numbers);
    for (const other of others) {
      if (other !== place && `${other.layout.xaxis.range.map(Number)}` !== shown) {
        await Plotly.relayout(other, {"xaxis.autorange": false, "xaxis.range": range});
      }
    }
  };
  place.on("plotly_relayout", refine);
  others.push(place);
}

function drawPair(place, found, layout) {
  const traces = found.map((each) => ({
    name: each.name, x: each.x, y: each.y, mode: each.is_line ? "lines" : "markers",
    line: {color: each.color, width: 2}, marker: {color: each.color, size: 3},
  }));
  return Plotly.newPlot(place, traces, {
    font: FONT, height: 420, margin: {l: 75, r: 15, t: 40, b: 50}, hovermode: "closest", paper_bgcolor: "white",
    plot_bgcolor: "white", legend: {orientation: "h", y: 1.02, yanchor: "bottom"},
    xaxis: {...GRID, title: {text: layout.x}}, yaxis: {...GRID, title: {text: layout.y}},
  }, SETTINGS);
}

async function drawAll() {
  const together = [];
  for (const script of document.querySelectorAll("script[type='application/json']")) {
    const view = JSON.parse(script.textContent);
    const place = (name) => document.getElementById(`${name}-${view.number}`);
    if (view.panels.length) await drawTime(place("time"), view, together);
    for (const name of ["comparison", "friction"]) {
      if (view[name]) await drawPair(place(name), view[name].lines, view[name].labels);
    }
  }
  document.body.dataset.drawn = "yes";
}

if (typeof document !== "undefined") drawAll();
if (typeof module !== "undefined") module.exports = {decoded, firstFrom, reduced};
