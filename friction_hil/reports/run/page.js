// The page of a run. It stands behind the charts of the live page (charts.js) in one module, and uses its functions.

const PANEL = 190, PAIR = 380; // heights
const NEAR = 6; // pixels from the cursor to an event whose text is shown

function decoded(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return Array.from(new Kind(bytes.buffer), (value) => (Number.isFinite(value) ? value : null)); // null: a gap
}

function shown(digits, unit = "") {
  return (_, value) => (value === null || value === undefined ? "–" : `${Number(value.toPrecision(digits))} ${unit}`);
}

function drawn(holder, height, labels, lines, data, more) {
  const series = lines.map((line) => ({
    label: line.name, stroke: line.color, width: line.width, dash: line.is_dashed ? [6, 4] : [], value: shown(5, labels.unit),
    points: { show: line.is_points, size: 3, fill: line.color }, ...(line.is_points && { paths: () => null }),
  }));
  const chart = new uPlot(
    {
      width: Math.max(holder.clientWidth, 200), height, scales: { x: { time: false } },
      axes: [{ ...axisOf(labels.x), size: 40 }, { ...axisOf(labels.y), size: 64 }],
      series: [{ label: labels.x, value: shown(7) }, ...series], ...more,
    },
    data,
    holder,
  );
  follow(holder, chart, height);
  return chart;
}

// Spans of the following error lie below the lines, events and missed periods above them.
function marksOf(view, panel) {
  const across = (chart, from, to, color, opacity) => {
    const { left, top, width, height } = chart.bbox;
    const [begin, end] = [from, to].map((x) => Math.min(Math.max(chart.valToPos(x, "x", true), left), left + width));
    if (begin === end && (from < chart.scales.x.min || from > chart.scales.x.max)) return;
    chart.ctx.globalAlpha = opacity;
    chart.ctx.fillStyle = color;
    chart.ctx.fillRect(begin, top, Math.max(end - begin, 1), height);
    chart.ctx.globalAlpha = 1;
  };
  const spans = panel.name === "error" ? view.spans : [];
  return {
    drawClear: [(chart) => spans.forEach((each) => across(chart, each.from, each.to, each.color, 0.1))],
    draw: [(chart) => view.marks.forEach((each) => across(chart, each.time_s, each.time_s, each.color, 0.7))],
  };
}

// One chart for each panel; those of all axes share cursor and range of time.
function drawTime(place, view) {
  const time = decoded(view.time, Float64Array);
  const text = place("marks");
  const tell = (chart) => {
    const at = chart.cursor.left;
    const near = view.marks.filter((each) => at >= 0 && Math.abs(chart.valToPos(each.time_s, "x") - at) <= NEAR);
    text.textContent = near.map((each) => each.text).join("; ");
  };
  const charts = view.panels.map((panel, k) => {
    const data = panel.lines.map((line) => decoded(line.data, Float32Array));
    const labels = { x: "time [s]", y: panel.label, unit: panel.unit };
    return drawn(place("time"), PANEL, labels, panel.lines, [time, ...data], {
      cursor: { sync: { key: "time", scales: ["x", null] } },
      hooks: { ...marksOf(view, panel), ...(k === 0 && { setCursor: [tell] }) },
    });
  });
  place("picture").addEventListener("click", () => savePicture(charts, view.name));
}

// Lines that do not share their x, in one table: each has a value in its own rows only.
function drawPair(holder, { lines, labels }) {
  const rows = lines.flatMap((line, k) => line.x.map((x, row) => [x, k, line.y[row]])).sort((a, b) => a[0] - b[0]);
  const data = lines.map((_, k) => rows.map(([, owner, y]) => (owner === k ? y : undefined)));
  const nearest = (chart, series, row) => {
    const values = chart.data[series];
    if (series === 0) return row;
    for (let away = 0; away < values.length; away += 1)
      for (const each of [row - away, row + away]) if (values[each] !== undefined) return each;
    return row;
  };
  const styled = lines.map((line) => ({ ...line, width: 2, is_points: !line.is_line }));
  drawn(holder, PAIR, labels, styled, [rows.map(([x]) => x), ...data], { cursor: { dataIdx: nearest } });
}

function savePicture(charts, name) {
  const dots = window.devicePixelRatio || 1, row = 24 * dots;
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(...charts.map((each) => each.ctx.canvas.width));
  canvas.height = charts.reduce((sum, each) => sum + row + each.ctx.canvas.height, 0);
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#fff"; // the colours of the charts are those of a light page; a dark one inverts them
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.font = `${13 * dots}px system-ui`;
  let top = 0;
  for (const chart of charts) {
    let left = chart.bbox.left;
    chart.series.forEach((each, k) => {
      if (k === 0 || !each.show) return;
      pen.fillStyle = each.stroke(chart, k);
      pen.fillText(each.label, left, top + 0.7 * row);
      left += pen.measureText(each.label).width + row;
    });
    pen.drawImage(chart.ctx.canvas, 0, top + row);
    top += row + chart.ctx.canvas.height;
  }
  const link = document.createElement("a");
  link.href = canvas.toDataURL("image/png");
  link.download = name;
  link.click();
}

for (const script of document.querySelectorAll("script[type='application/json']")) {
  const view = JSON.parse(script.textContent);
  const place = (name) => document.getElementById(`${name}-${view.number}`);
  if (view.panels.length) drawTime(place, view);
  for (const name of ["comparison", "friction"]) if (view[name]) drawPair(place(name), view[name]);
}
document.body.dataset.drawn = "yes";
