// The lab's page: wrong fixes confirmed over the size of their error, and bounds of positions by mode.

import uPlot from "../../../live/static/vendor/uplot/uPlot.esm.js";
import { line, roundNumbers } from "../../../live/static/charts.js";
import { colour, element, plain, setText } from "../../../live/static/dom.js";
import { stanfordAxes } from "../../../live/static/stanford.js";

const facts = JSON.parse(document.getElementById("facts").textContent);
const BASELINES = { "height only": "erroneous", "LiDAR only": "pose", "height and LiDAR": "confirmed", "all, with residuals": "verified" };
const LEAST_EPISODES = 20; // as in the report's headlines
const SIZES_M = [.2, 20], LEAST_SHARE = 1e-6;
const FONT = "11px system-ui, sans-serif";

const plainNumber = value => value === null ? "" : value >= .001 ? String(value) : value.toExponential(0).replace("-", "−");
const exactPercent = value => `${(100 * value).toFixed(3)} %`;
const percent = value => value >= .001 ? `${+(100 * value).toPrecision(3)} %` : value.toExponential(0);

// One chart for each kind and scene, with one cursor.
class LabCurves extends HTMLElement {
  start() {
    this.charts = facts.scenes.map(scene => this.makeChart(scene));
    this.replaceChildren(...this.charts.map(chart => chart.box));
    new ResizeObserver(() => this.resize()).observe(this);
    this.resize();
  }

  makeChart(scene) {
    const names = Object.keys(BASELINES), enough = scene.episodes.map(n => n >= LEAST_EPISODES), values = element("span"), holder = element("div", { class: "plot" });
    const share = name => scene.confirmed[name].map((count, k) => enough[k] && count ? count / scene.episodes[k] : null);
    const bound = name => scene.confirmed[name].map((count, k) => enough[k] && !count ? Math.min(1, 3 / scene.episodes[k]) : null);
    // Of different sizes, since baselines without an event have the same bound.
    const ring = (name, k) => ({ width: 0, paths: () => null, points: { show: true, size: 14 - 3 * k, width: 1.6, stroke: colour(name), fill: colour("card") } });
    const say = k => [`${scene.range[k]}, n = ${scene.episodes[k].toLocaleString("en")}`, ...names.map(name => `${name} ${!enough[k] ? "–" : scene.confirmed[name][k] ? percent(scene.confirmed[name][k] / scene.episodes[k]) : "≤ " + percent(3 / scene.episodes[k])}`)].join(" · ");
    const axis = { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: FONT, splits: (_, __, low, high) => roundNumbers(low, high), filter: (_, splits) => splits };
    const legend = names.map(name => element("span", {}, element("i", { style: { background: colour(BASELINES[name]) } }), name));
    const plot = new uPlot({
      width: 300, height: 200, legend: { show: false }, padding: [8, 14, 0, 0], cursor: { sync: { key: "lab" }, y: false, points: { show: false }, drag: { x: false, y: false } },
      scales: { x: { time: false, distr: 3, range: SIZES_M }, y: { distr: 3, range: [LEAST_SHARE, 1] } },
      axes: [{ ...axis, label: "horizontal error, m", labelSize: 16, labelFont: FONT, size: 22, values: (_, splits) => splits.map(plainNumber) }, { ...axis, size: 54, values: (_, splits) => splits.map(plainNumber) }],
      series: [{}, ...names.map(name => ({ ...line(BASELINES[name]), spanGaps: false, points: { show: true, size: 5, fill: colour(BASELINES[name]), stroke: colour(BASELINES[name]) } })), ...names.map((name, k) => ring(BASELINES[name], k))],
      hooks: { setCursor: [drawn => { const k = drawn.cursor.idx; setText(values, k === null || k === undefined || drawn.cursor.left < 0 ? "" : say(k)); for (const name of legend) name.hidden = values.textContent !== ""; }] },
    }, [scene.size_m, ...names.map(share), ...names.map(bound)], holder);
    return { plot, holder, values, box: element("div", { class: "chart" }, element("div", { class: "head" }, element("b", {}, scene.title), ...legend, values), holder) };
  }

  resize() {
    for (const { plot, holder } of this.charts) if (holder.clientWidth > 40) plot.setSize({ width: holder.clientWidth, height: holder.clientHeight });
  }
}

class LabBounds extends HTMLElement {
  start() {
    this.modes = facts.modes.map(mode => {
      const chart = element("canvas"), circle = element("canvas"), { share, lower_95: low, upper_95: high } = mode.inside_999;
      const text = `${mode.draws.toLocaleString("en")} positions, ${exactPercent(share)} inside the 99.9 % ellipse (between bounds of 95 %: ${exactPercent(low)} and ${exactPercent(high)})`;
      const largest = mode.counts.reduce((max, row) => Math.max(max, ...row), 1), gradient = `linear-gradient(90deg, ${colour("confirmed")}26, ${colour("confirmed")})`;
      const key = element("p", { class: "note" }, "positions in a cell: 1 ", element("i", { class: "ramp", style: { background: gradient } }), ` ${largest.toLocaleString("en")}`);
      this.append(element("div", { class: "mode" }, element("h3", {}, plain(mode.name)), element("p", { class: "note" }, text), element("div", { class: "canvases" }, element("div", {}, chart, key), circle)));
      return { ...mode, chart, largest, circleCanvas: circle };
    });
    new ResizeObserver(() => this.draw()).observe(this);
  }

  draw() {
    for (const mode of this.modes) {
      this.drawStanford(mode);
      drawCircle(mode);
    }
  }

  drawStanford({ chart, counts, largest, beyond, draws }) {
    const edges = facts.edges_m, most = edges.at(-1);
    const { c, x, y, note } = stanfordAxes(chart, 10 ** Math.ceil(Math.log10(most) - 1e-9), facts.alert_limit_m);
    c.fillStyle = colour("confirmed");
    for (let i = 0; i + 1 < edges.length; i++) for (let j = 0; j + 1 < edges.length; j++) {
      if (!counts[i][j]) continue;
      c.globalAlpha = .15 + .85 * Math.log(counts[i][j]) / Math.log(Math.max(largest, 2));
      c.fillRect(x(edges[i]), y(edges[j + 1]), Math.max(x(edges[i + 1]) - x(edges[i]), 1), Math.max(y(edges[j]) - y(edges[j + 1]), 1));
    }
    c.globalAlpha = 1;
    note(`error beyond the level: ${beyond.count} of ${draws.toLocaleString("en")}`);
  }
}

// Errors in the unit circle of the ellipse, with one scale for both axes.
function drawCircle({ circleCanvas: canvas, circle }) {
  const size = canvas.clientWidth, factor = devicePixelRatio, c = canvas.getContext("2d"), middle = size / 2, unit = (size - 36) / 3;
  canvas.width = canvas.height = size * factor;
  c.scale(factor, factor);
  c.font = FONT;
  c.fillStyle = colour("soft");
  c.strokeStyle = colour("line");
  c.textAlign = "center";
  for (const value of [-1, -.5, 0, .5, 1]) {
    const at = middle + value * unit;
    c.beginPath(); c.moveTo(at, 18); c.lineTo(at, size - 18); c.moveTo(18, at); c.lineTo(size - 18, at); c.stroke();
    c.fillText(String(value).replace("-", "−"), at, size - 5);
    c.fillText(String(-value).replace("-", "−"), 9, at + 4);
  }
  c.fillText("along", size - 34, middle - 4);
  c.fillText("across", middle + 20, 26);
  for (const [along, across] of circle) { c.fillStyle = colour(Math.hypot(along, across) > 1 ? "erroneous" : "confirmed"); c.fillRect(middle + along * unit - 1, middle - across * unit - 1, 2, 2); }
  c.strokeStyle = colour("ink");
  c.beginPath(); c.arc(middle, middle, unit, 0, 2 * Math.PI); c.stroke();
}

const dark = matchMedia("(prefers-color-scheme: dark)");
customElements.define("lab-curves", LabCurves);
customElements.define("lab-bounds", LabBounds);
document.documentElement.dataset.theme = dark.matches ? "dark" : "light";
const curves = document.querySelector("lab-curves"), bounds = document.querySelector("lab-bounds");
curves.start();
bounds.start();
window.camber = { curves, bounds };
