// The charts of the page. Colours come from the style sheet, so that they follow light and dark.

/* global uPlot */

const HEIGHT = 170;

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function axisOf(label) {
  return {
    label,
    labelSize: 18,
    labelFont: "12px system-ui",
    font: "11px system-ui",
    size: label ? 52 : 30,
    space: (_, index) => (index === 0 ? 50 : 22), // close enough that each axis has two labels at least
    stroke: () => colour("--faint"),
    grid: { stroke: () => colour("--grid"), width: 1 },
    ticks: { stroke: () => colour("--grid"), width: 1 },
  };
}

const LINES = [
  { stroke: () => colour("--first"), width: 1.5 },
  { stroke: () => colour("--second"), width: 1.5, dash: [6, 4] },
];

const KEPT = { stroke: () => colour("--third"), width: 1, points: { show: false } };

function atCursor(_, value) {
  return value === null || value === undefined ? "–" : String(Number(value.toPrecision(5)));
}

// A chart of lines over x in `holder`, with the values at the cursor below it. `kind`: "strip" (lines over time) or "map"
// (points and a curve). `zoomed` is called when somebody has chosen a part of it.
export function lineChart(holder, names, xLabel, kind, zoomed) {
  const series = names.map((label, k) =>
    kind === "map" && k === 0
      ? { label, value: atCursor, stroke: LINES[0].stroke, paths: () => null, points: { show: true, size: 4, fill: LINES[0].stroke } }
      : { label, value: atCursor, ...LINES[k], points: { show: false }, spanGaps: kind === "map" },
  );
  const chart = new uPlot(
    {
      width: Math.max(holder.clientWidth, 200),
      height: HEIGHT,
      cursor: kind === "strip" ? { sync: { key: "time", scales: ["x", null] } } : {},
      hooks: { setSelect: [(made) => made.select.width > 0 && zoomed()] },
      scales: { x: { time: false } },
      axes: [{ ...axisOf(xLabel), size: 40 }, axisOf("\u00a0")],
      series: [{ label: kind === "strip" ? "time" : "velocity", value: atCursor }, ...series],
    },
    [[], ...names.map(() => [])],
    holder,
  );
  follow(holder, chart, HEIGHT);
  return {
    // Lines beyond those of `names` are kept ones, of the names in `kept`.
    draw(data, xUnit, yUnit, range, kept = []) {
      chart.axes[0].label = xUnit;
      chart.axes[1].label = yUnit;
      chart.batch(() => {
        while (chart.series.length > data.length) chart.delSeries(chart.series.length - 1);
        for (let k = chart.series.length; k < data.length; k += 1)
          chart.addSeries({ ...KEPT, label: `${kept[k - 1 - names.length]}, kept`, value: atCursor }, k);
        chart.setData(data, !range);
        if (range) chart.setScale("x", { min: range[0], max: range[1] });
      });
    },
    redraw: () => chart.redraw(),
  };
}

// A chart of bars: counts over the classes of lateness, on a logarithmic scale, where a single late cycle is seen.
export function barChart(holder, xLabel) {
  let edges = [];
  let most = 10;
  const chart = new uPlot(
    {
      width: Math.max(holder.clientWidth, 200),
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false, range: (_, low, high) => [low - 0.5, high + 0.5] }, y: { distr: 3, range: [0.5, null] } },
      axes: [
        {
          ...axisOf(xLabel),
          size: 40,
          splits: () => edges.map((_, k) => k),
          values: (_, splits) => splits.map((k) => edges[k] ?? ""),
        },
        {
          ...axisOf("cycles"),
          splits: () => [1, ...[10, 100, 1000, 10000, 100000].filter((each) => each * 3 < most), most],
          values: (_, splits) => splits.map((each) => (each > 0 ? String(each) : "")),
        },
      ],
      series: [
        {},
        {
          label: "cycles",
          stroke: () => colour("--first"),
          fill: () => colour("--first"),
          paths: uPlot.paths.bars({ size: [0.9] }),
          points: { show: false },
        },
      ],
    },
    [[], []],
    holder,
  );
  follow(holder, chart, HEIGHT);
  return {
    draw(labels, counts) {
      edges = labels;
      most = Math.max(10, ...counts);
      chart.scales.y.range = () => [0.5, most * 2];
      chart.setData([labels.map((_, k) => k), counts.map((count) => count || null)]);
    },
    redraw: () => chart.redraw(),
  };
}

// The circle: the radius error drawn `magnification` times as large about the nominal circle.
export function drawCircle(canvas, circle) {
  const size = canvas.clientWidth;
  const dots = window.devicePixelRatio || 1;
  canvas.width = canvas.height = Math.round(size * dots);
  const pen = canvas.getContext("2d");
  pen.scale(dots, dots);
  pen.clearRect(0, 0, size, size);
  const reach = 1 + Math.max(1, circle.outer) * circle.ring_share + 0.16;
  const unit = size / 2 / reach;
  pen.translate(size / 2, size / 2);
  pen.font = "12px system-ui";
  pen.textAlign = "center";
  for (let k = -circle.inner; k <= circle.outer; k += 1) {
    pen.strokeStyle = colour(k === 0 ? "--faint" : "--line");
    pen.beginPath();
    pen.arc(0, 0, (1 + k * circle.ring_share) * unit, 0, 2 * Math.PI);
    pen.stroke();
    if (k !== 0) {
      pen.fillStyle = colour("--faint");
      const along = (1 + k * circle.ring_share) * unit * Math.SQRT1_2;
      pen.fillText(circle.labels[k + circle.inner], along, 4 - along);
    }
  }
  pen.strokeStyle = colour("--first");
  pen.lineWidth = 1.8;
  pen.beginPath();
  let isDown = false;
  circle.angle.forEach((angle, k) => {
    const drawn = (1 + circle.share[k]) * unit;
    const isNear = k > 0 && Math.abs(Math.sin((angle - circle.angle[k - 1]) / 2)) < 0.1;
    const place = [drawn * Math.cos(angle), -drawn * Math.sin(angle)];
    if (isDown && isNear) pen.lineTo(...place);
    else pen.moveTo(...place);
    isDown = true;
  });
  pen.stroke();
  pen.fillStyle = colour("--ink");
  pen.textAlign = "right";
  pen.fillText(`+${circle.axes[0]}`, size / 2 - 2, 4);
  pen.textAlign = "center";
  pen.fillText(`+${circle.axes[1]}`, 0, -size / 2 + 12);
}

function follow(holder, chart, height) {
  let width = 0;
  new ResizeObserver(() => {
    if (holder.clientWidth && holder.clientWidth !== width) {
      width = holder.clientWidth;
      chart.setSize({ width, height });
    }
  }).observe(holder);
}
