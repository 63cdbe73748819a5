// The report of a drive: the live page's store, view, charts and panels on rows that are in the page.

import { dots, known, line } from "../../../live/static/charts.js";
import { clock, metres, plain, VERDICT_COLOURS } from "../../../live/static/dom.js";
import "../../../live/static/panels.js";
import "../../../live/static/sky.js";
import "../../../live/static/stanford.js";
import { Store } from "../../../live/static/store.js";
import { View } from "../../../live/static/view.js";
import "./flat_map.js";

const LEAST_ERROR_M = .005; // errors below it are drawn at it: a logarithmic axis has no zero
const LEAST_AGE_S = .01; // a replay in one process has no ages
const lift = value => Number.isFinite(value) ? Math.max(Math.abs(value), LEAST_ERROR_M) : null;
const COLOURS = ["confirmed", "verified", "warn", "erroneous", "level", "soft"];
const text = id => document.getElementById(id).textContent, find = name => document.querySelector(`camber-${name}`);
const facts = JSON.parse(text("facts"));

class ReportStore extends Store {
  async detail(row) { return facts.texts[row] ?? ""; }
  async snapshot(kind, time) {
    const kept = facts[kind].findLast(snapshot => snapshot.t <= time + .05);
    return kept ? { json: async () => kept } : null;
  }
}

class ReportView extends View {
  get shown() { return [this.hover, this.selected, this.end].find(Number.isFinite); }
}

const store = new ReportStore(), view = new ReportView(store), sky = find("sky"), map = find("map"), charts = find("charts"), stanford = find("stanford"), fix = find("fix");
const dark = matchMedia("(prefers-color-scheme: dark)");
function showTheme() {
  document.documentElement.dataset.theme = dark.matches ? "dark" : "light";
  view.dispatchEvent(new Event("theme"));
}

// A chart of all columns of a table besides the time.
const columnsChart = (title, table) => {
  const names = store.tables[table].columns.slice(1);
  return {
    title, table, unit: "m", labels: names.map(name => plain(name.replace(/_m$/, ""))), series: names.map((_, k) => dots(COLOURS[k % COLOURS.length])),
    columns: (a, rows) => names.map(name => rows.map(k => known(a[name][k]))), extreme: names[0],
    say: (a, k) => names.map((name, at) => Number.isFinite(a[name][k]) ? `${plain(name.replace(/_m$/, ""))} ${metres(a[name][k], 3)}` : "").filter(Boolean),
  };
};

function errorChart() {
  const words = store.words.verdict;
  return {
    title: "3D error of fixes", table: "verdict", unit: "m", logarithmic: true, labels: [...words.map(plain), `wrong above ${facts.wrong_m} m`], series: [...words.map(word => dots(VERDICT_COLOURS[word])), line("ink", [6, 4])],
    columns: (a, rows) => [...words.map((_, place) => rows.map(k => a.verdict[k] === place ? lift(a.error_m[k]) : null)), rows.map(() => facts.wrong_m)],
    extreme: "error_m", say: (a, k) => [`${plain(store.word("verdict", a.verdict[k]))}: error ${metres(a.error_m[k])}`], note: () => `below ${metres(LEAST_ERROR_M, 3)} drawn at the edge`,
  };
}

// Protection levels with the error that they bound.
function withError(chart) {
  const { columns, say } = chart;
  return {
    ...chart, title: "Protection levels, alert limits, errors", labels: [...chart.labels, "horizontal error", "vertical error"], series: [...chart.series, line("confirmed"), line("warn")],
    columns: (a, rows) => [...columns(a, rows), rows.map(k => lift(a.error_m[k])), rows.map(k => lift(a.error_up_m[k]))],
    say: (a, k) => [...say(a, k), `error ${metres(a.error_m[k])}, up ${metres(a.error_up_m[k])}`],
  };
}

function hasAges() {
  const { arrays, length } = store.tables.position;
  return Object.keys(arrays).some(name => name.startsWith("age_") && arrays[name].subarray(0, length).some(age => age > LEAST_AGE_S));
}

const live = charts.definitions.bind(charts);
charts.definitions = () => {
  const [height, levels, ...others] = live(), more = [];
  if (facts.truth) more.push(errorChart());
  for (const [title, table] of [["Scan match: mean distance of layers", "scan_match"], ["Antenna above the road", "height"]]) if (store.tables[table].length) more.push(columnsChart(title, table));
  return [height, facts.truth ? withError(levels) : levels, ...others, ...more].filter(chart => chart.title !== "Age of inputs" || hasAges());
};

showTheme();
charts.start(store, view);
fix.start(store, view, map);
stanford.start(store, view);
sky.start(store, view);
sky.hidden = facts.satellites.length === 0;
for (const name of ["hover", "selection"]) view.addEventListener(name, () => sky.refresh());
view.addEventListener("view", () => stanford.refresh());
store.greet(facts);
store.take(Uint8Array.from(atob(text("rows")), letter => letter.charCodeAt(0)).buffer);
map.start(store, view, facts.roads);
dark.addEventListener("change", showTheme);
charts.make();
charts.addEventListener("dblclick", () => view.range(store.oldest, store.newest));

if (Number.isFinite(store.newest)) {
  view.running = false;
  if (!view.pinned) view.range(store.oldest, store.newest);
  view.change();
}

for (const row of document.querySelectorAll("tr.go")) {
  const go = () => {
    const begin = Number(row.dataset.begin), end = Number(row.dataset.end), margin = Math.max(3, end - begin);
    view.range(begin - margin, end + margin);
    view.select(begin);
    map.fit(begin - 1, end + 1);
    map.scrollIntoView({ behavior: "smooth", block: "center" });
  };
  row.addEventListener("click", go);
  row.addEventListener("keydown", event => { if (event.key === "Enter") go(); });
}
document.querySelector("h1").title = Number.isFinite(store.oldest) ? `${clock(store.oldest)} to ${clock(store.newest)} UTC` : "";
window.camber = { store, view, map, charts, stanford };
