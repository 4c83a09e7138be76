// The page: shows what the stream brings, and asks for changes.

import { barChart, drawCircle, lineChart } from "./charts.js";
import { Scope, resampled } from "./scope.js";
import { follow, hasToken, post, useToken } from "./server.js";

const MOST_EVENTS = 100;
const LONG = 60; // characters of a value that gets a line of its own
const SILENT_MS = 3000; // without figures, which come twice a second: then nothing here is live
const CALM_MS = 1000; // between two drawings where motion is to be reduced

const at = (id) => document.getElementById(id);
const axes = new Map();
let lateness = null;
let circle = null;
let windowS = 20; // that is shown
let keptS = 60; // that may be shown
const hidden = new Set(); // titles of charts
const scope = new Scope();
const OVER = { stop: "running", reset: "running", start: "waiting" }; // the state in which what was said of it is past
let isPaused = false;
let drawnMs = -Infinity;
let figuresMs = -Infinity;
const calm = matchMedia("(prefers-reduced-motion: reduce)");

function element(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

// What is shown is live only while data arrive: `live` is "yes", "ended" (the daemon) or "lost" (the connection).
function showLive(live, reason = "") {
  if (document.body.dataset.live === live && at("gone").textContent === reason) return;
  document.body.dataset.live = live;
  at("gone").hidden = live === "yes";
  at("gone").textContent = reason;
  if (live !== "yes") {
    at("state").textContent = "no data";
    at("clock").textContent = "";
    for (const axis of axes.values()) axis.forget();
    at("lateness-text").textContent = "no data";
    at("circle-text").textContent = "no data";
  }
  showWrites();
}

function showWrites() {
  const canWrite = hasToken() && document.body.dataset.live === "yes";
  for (const each of document.querySelectorAll("[data-writes]")) each.disabled = !canWrite;
  at("login").hidden = hasToken();
}

class Axis {
  constructor(name, facts) {
    this.name = name;
    this.facts = facts;
    this.strips = facts.strips;
    this.data = null;
    this.root = at("axis-template").content.cloneNode(true).querySelector("section");
    const title = this.root.querySelector("h2");
    title.textContent = `Axis ${name}`;
    title.id = `axis-${name}`;
    this.root.setAttribute("aria-labelledby", title.id);
    this.values = this.root.querySelector(".values");
    at("axes").append(this.root);
    this.charts = this.strips.map((strip) => this.addChart(strip.title, strip.names, "time [s]", "strip"));
    this.map = this.addChart("Friction against velocity", ["measured", "model"], "velocity", "map");
    this.addControls();
  }

  addChart(title, names, xLabel, kind) {
    const figure = element("figure");
    const heading = element("h3", title);
    const classes = ["first", "second"];
    if (names.length > 1)
      names.forEach((name, k) => {
        const key = element("span", "", `key ${classes[k]}`);
        key.setAttribute("aria-hidden", "true");
        heading.append(key, name);
      });
    const holder = element("div");
    holder.setAttribute("role", "img");
    const text = element("figcaption", "no data");
    figure.append(heading, holder, text);
    this.root.querySelector(".charts").append(figure);
    figure.dataset.title = title;
    figure.hidden = hidden.has(title);
    return { ...lineChart(holder, names, xLabel, kind, () => pause(true)), holder, text, title: `${title}, axis ${this.name}` };
  }

  addControls() {
    const find = (selector) => this.root.querySelector(selector);
    this.enabled = find(".enabled");
    this.gain = find(".gain");
    this.model = find(".model");
    this.answer = find(".answer");
    find("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.set("gain", this.gain.valueAsNumber);
    });
    this.enabled.addEventListener("click", () =>
      this.set("enabled", this.enabled.getAttribute("aria-checked") !== "true"),
    );
    find(".set-gain").addEventListener("click", () => this.set("gain", this.gain.valueAsNumber));
    find(".set-model").addEventListener("click", () => {
      if (this.model.value) this.set("model", this.model.value);
      else this.say(false, "Choose a model file first.");
    });
    this.model.append(element("option", "choose a file"));
    this.model.firstChild.value = "";
    for (const file of this.facts.models) this.model.append(element("option", file));
  }

  async set(key, value) {
    const answer = await post("api/set", { values: { [`${this.name}.${key}`]: Number.isNaN(value) ? null : value } });
    this.say(answer.ok, answer.ok ? `changed in cycle ${answer.cycle}` : answer.problems.join("\n"));
    if (answer.status === 401) refuse();
  }

  say(isRight, text) {
    this.answer.classList.toggle("wrong", !isRight);
    this.answer.textContent = text;
  }

  take(rows) {
    const columns = ["time_s", ...this.strips.flatMap((strip) => strip.columns)];
    this.data ??= Object.fromEntries(columns.map((each) => [each, []]));
    for (const each of columns) this.data[each].push(...rows[each]);
    const times = this.data.time_s;
    let old = 0;
    while (times[old] < times[times.length - 1] - keptS) old += 1;
    if (old) for (const each of columns) this.data[each].splice(0, old);
  }

  range() {
    return scope.range(this.data.time_s.at(-1), windowS);
  }

  // What has a direction: the demanded velocity, which is free of noise, or the measured one where none is known.
  get direction() {
    return this.data.velocity_demand.some((each) => each !== null) ? this.data.velocity_demand : this.data.velocity;
  }

  draw() {
    const times = this.data?.time_s;
    if (!times?.length) return;
    const range = this.range();
    this.strips.forEach((strip, k) => {
      const { factor, unit } = this.scales?.[k] ?? { factor: 1, unit: strip.unit };
      const scaled = (values) => values.map((v) => (v === null ? null : v * factor));
      const lines = strip.columns.map((each) => scaled(this.data[each]));
      if (this.kept) {
        const { rows, from } = this.kept;
        lines.push(...strip.columns.map((each) => scaled(resampled(rows.time_s, rows[each], times, range[0] - from))));
      }
      this.charts[k].draw([times, ...lines], "time [s]", `[${unit}]`, range, strip.names);
    });
  }

  // Keep a copy of the motion that is shown, or forget it.
  keep(isWanted) {
    this.kept = isWanted && this.data ? { rows: structuredClone(this.data), from: this.range()[0] } : null;
    this.draw();
  }

  show(figures) {
    this.scales = figures.scales;
    this.values.replaceChildren(
      ...figures.values.map(([name, value]) => {
        const pair = element("div", "", value.length > LONG ? "wide" : "");
        pair.append(element("dt", name), element("dd", value));
        return pair;
      }),
    );
    this.enabled.setAttribute("aria-checked", String(figures.enabled));
    if (document.activeElement !== this.gain) this.gain.value = figures.gain;
    this.charts.forEach((chart, k) => describe(chart, figures.texts[k]));
    const map = figures.friction;
    describe(this.map, map.text);
    if (!isPaused) this.map.draw([map.velocity, map.measured, map.model], map.x_label, map.y_label);
  }

  forget() {
    for (const value of this.values.querySelectorAll("dd")) value.textContent = "–";
    for (const chart of [...this.charts, this.map]) describe(chart, "no data");
  }

  redraw() {
    for (const chart of [...this.charts, this.map]) chart.redraw();
  }
}

function describe(chart, text) {
  chart.text.textContent = text;
  chart.holder.setAttribute("aria-label", `${chart.title}: ${text}`);
}

// The token is wrong or missing: ask for another one.
function refuse() {
  useToken("");
  showWrites();
}

const handlers = {
  hello(message) {
    keptS = Math.max(keptS, message.window_s);
    document.title = `${message.name} · friction_hil`;
    at("name").textContent = message.name;
    at("axes").replaceChildren();
    axes.clear();
    for (const [name, facts] of Object.entries(message.axes)) axes.set(name, new Axis(name, facts));
    offerCharts();
    offerScope();
    circle = null;
    at("circle").hidden = true;
    at("events").replaceChildren();
    at("no-events").hidden = false;
    showFaults([]);
    figuresMs = performance.now();
    showLive("yes");
  },

  rows(message) {
    for (const [name, rows] of Object.entries(message.axes)) axes.get(name).take(rows);
    if (!isPaused) lookForTrigger();
    const now = performance.now();
    if (isPaused || document.hidden || (calm.matches && now - drawnMs < CALM_MS)) return;
    drawnMs = now;
    for (const axis of axes.values()) axis.draw();
  },

  figures(message) {
    figuresMs = performance.now();
    if (message.stands) {
      showLive("ended", "No data: the loop of the daemon stands; it has written no row for a second.");
      return;
    }
    showLive("yes");
    at("state").textContent = isPaused ? `${message.state}, charts paused` : message.state;
    at("start").hidden = message.state !== "waiting";
    if (OVER[at("said").dataset.done] === message.state) say(""); // somebody has started or stopped it since
    at("clock").textContent = message.clock;
    for (const [name, figures] of Object.entries(message.axes)) axes.get(name).show(figures);
    showFaults(message.faults);
    at("lateness-text").textContent = message.lateness.text;
    at("lateness-chart").setAttribute("aria-label", `Lateness of the loop: ${message.lateness.text}`);
    if (isPaused) return;
    lateness ??= barChart(at("lateness-chart"), "lateness up to [µs]");
    lateness.draw(message.lateness.labels, message.lateness.counts);
    circle = message.circle;
    at("circle").hidden = circle === null;
    if (circle === null) return;
    at("circle-text").textContent = circle.text;
    at("circle-canvas").setAttribute("aria-label", `Radius error of the circle: ${circle.text}`);
    if (circle.angle.length) drawCircle(at("circle-canvas"), circle);
  },

  events(message) {
    for (const event of message.events) {
      const item = element("li", "", event.kind);
      item.append(`${event.time} ${event.kind}: ${event.text}`);
      if (event.remedy) item.append(element("span", `Remedy: ${event.remedy}`, "remedy"));
      at("events").prepend(item);
    }
    while (at("events").childElementCount > MOST_EVENTS) at("events").lastChild.remove();
    at("no-events").hidden = at("events").childElementCount > 0;
  },

  ended(message) {
    showLive("ended", `No data: ${message.reason}. Nothing on this page is live.`);
  },

  alive() {
    if (document.body.dataset.live !== "yes" || performance.now() - figuresMs < SILENT_MS) return;
    showLive("lost", "No data: the server of this page does not get any. Nothing on this page is live.");
  },
};

function showFaults(faults) {
  const shown = JSON.stringify(faults);
  if (at("fault-list").dataset.shown === shown) return; // a screen reader would read them again
  if (faults.length) scope.fault([...axes.values()].at(0)?.data?.time_s.at(-1));
  at("fault-list").dataset.shown = shown;
  at("faults").hidden = faults.length === 0;
  at("fault-list").replaceChildren(
    ...faults.map((fault) => {
      const item = element("li", fault.text);
      if (fault.remedy) item.append(element("span", `Remedy: ${fault.remedy}`, "remedy"));
      return item;
    }),
  );
}

function say(text, isRight = true) {
  at("said").classList.toggle("wrong", !isRight);
  at("said").textContent = text;
  at("said").dataset.done = "";
}

async function act(what) {
  say(`${what}: waiting for the daemon`);
  const answer = await post(`api/${what}`, {});
  const drives = Object.entries(answer.drives ?? {}).map(([name, state]) => `${name}: ${state}`);
  const isDone = answer.ok && answer.is_done;
  say(
    answer.ok
      ? `${what}: ${isDone ? "done" : "NOT DONE"}; drives as read back: ${drives.join(", ")}`
      : `${what}: ${answer.problems.join(" ")}`,
    isDone,
  );
  if (isDone) at("said").dataset.done = what;
  if (answer.status === 401) refuse();
}

at("stop").addEventListener("click", () => act("stop"));
at("reset").addEventListener("click", () => act("reset"));
at("start").addEventListener("click", () => {
  const names = [...axes.keys()].join(", ");
  if (confirm(`Enable ${names}? The drives get power, and the axes move.`)) act("start");
});
at("pause").addEventListener("click", () => {
  if (isPaused && scope.isSingle) arm(); // another shot
  else pause(!isPaused);
});
for (const each of ["trigger", "trigger-axis", "single"]) at(each).addEventListener("change", arm);
at("keep").addEventListener("click", () => {
  const isKept = at("keep").getAttribute("aria-pressed") !== "true";
  at("keep").setAttribute("aria-pressed", String(isKept));
  for (const axis of axes.values()) axis.keep(isKept);
});
at("window").addEventListener("change", () => {
  windowS = Number(at("window").value);
  for (const axis of axes.values()) axis.draw();
});

function pause(isWanted) {
  isPaused = isWanted;
  at("pause").setAttribute("aria-pressed", String(isPaused));
  at("pause").textContent = isPaused ? "Resume charts" : "Pause charts";
}

function arm() {
  scope.arm(at("trigger").value, at("single").checked && at("trigger").value !== "");
  at("scope-text").textContent = scope.kind ? `waiting for a ${scope.kind}` : "";
  pause(false);
  for (const axis of axes.values()) axis.draw();
}

function lookForTrigger() {
  const name = at("trigger-axis").value;
  const axis = axes.get(name);
  if (!axis?.data || !scope.look(axis.data.time_s, axis.direction, windowS)) return;
  at("scope-text").textContent = `${scope.kind} at ${scope.shown.toFixed(2)} s`;
  for (const each of axes.values()) each.draw();
  if (scope.isSingle) pause(true);
}

function offerScope() {
  at("trigger-axis").replaceChildren(...[...axes.keys()].map((name) => element("option", name)));
  at("keep").setAttribute("aria-pressed", "false");
  arm();
}

// Let the user choose which charts are shown, for all axes at once.
function offerCharts() {
  const titles = new Set([...document.querySelectorAll("figure[data-title]")].map((each) => each.dataset.title));
  at("shown-charts").replaceChildren(
    ...[...titles].map((title) => {
      const label = element("label", title);
      const box = element("input");
      box.type = "checkbox";
      box.checked = !hidden.has(title);
      box.addEventListener("change", () => {
        if (box.checked) hidden.delete(title);
        else hidden.add(title);
        for (const each of document.querySelectorAll("figure[data-title]")) each.hidden = hidden.has(each.dataset.title);
      });
      label.prepend(box);
      return label;
    }),
  );
}
at("login").addEventListener("submit", (event) => {
  event.preventDefault();
  useToken(at("token").value.trim());
  at("token").value = "";
  showWrites();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const axis of axes.values()) axis.redraw();
  lateness?.redraw();
  if (circle?.angle.length) drawCircle(at("circle-canvas"), circle);
});

showWrites();
follow(
  (message) => handlers[message.kind](message),
  (reason, status) => {
    if (document.body.dataset.live === "ended") return; // with the daemon, its server of live data ends too
    showLive("lost", `Connection lost: ${reason}. Nothing on this page is live; it tries again.`);
    if (status === 401 && hasToken()) refuse();
  },
);
