// Time series below one another with one cursor: what the judge compared, levels, source, satellites, ages.

import uPlot from "./vendor/uplot/uPlot.esm.js";
import { clock, colour, duration, element, metres, plain, remPx, setText, SOURCE_COLOURS, VERDICT_COLOURS } from "./dom.js";

const MOST_POINTS = 1600; // about what a chart has pixels
const AGES = ["fix", "velocity", "pose", "scan_match", "antenna_height", "motion"];
const AGE_COLOURS = ["confirmed", "verified", "level", "pose", "erroneous", "soft"];
const MOST_AGE_S = 3;
const MOST_WAIT_S = 1; // chosen: the newest points of a long time are a pixel, but not older than this

export class CamberCharts extends HTMLElement {
  start(store, view) {
    Object.assign(this, { store, view });
    this.charts = [];
    store.addEventListener("greeting", () => this.make());
    view.addEventListener("theme", () => this.make());
    view.addEventListener("view", () => { if (!this.isWithinPixel()) this.refresh(); });
    view.addEventListener("slow", () => { if (this.drawn && this.drawn.end !== view.end) this.refresh(); });
    view.addEventListener("hover", () => this.showHover());
    this.resizing = new ResizeObserver(() => this.resize());
  }

  make() {
    for (const chart of this.charts) chart.plot.destroy();
    this.resizing.disconnect();
    // The lowest one has the times for all.
    this.charts = this.definitions().map((definition, k, all) => this.makeChart(definition, k === all.length - 1));
    this.replaceChildren(...this.charts.map(chart => chart.box));
    for (const chart of this.charts) this.resizing.observe(chart.holder);
    this.resize();
    this.refresh();
  }

  definitions() {
    const { store } = this, words = store.words.verdict;
    return [
      {
        title: "Height difference", table: "verdict", unit: "m", labels: [...words.map(plain), "tolerance"],
        series: [...words.map(word => dots(VERDICT_COLOURS[word])), line("soft", [4, 3]), line("soft", [4, 3])],
        bands: [{ series: [words.length + 1, words.length + 2], fill: colour("soft") + "1f" }],
        columns: (a, rows) => {
          const most = this.heightLimit = heightLimit(a, rows);
          const by = words.map((_, place) => rows.map(k => a.verdict[k] === place && Number.isFinite(a.difference_m[k]) ? Math.min(Math.max(a.difference_m[k], -most), most) : null));
          return [...by, rows.map(k => known(a.tolerance_m[k])), rows.map(k => known(-a.tolerance_m[k]))];
        },
        extreme: "difference_m", range: () => [-1.08 * this.heightLimit, 1.08 * this.heightLimit],
        say: (a, k) => [`${plain(store.word("verdict", a.verdict[k]))}: ${metres(a.difference_m[k])}, tolerance ${metres(a.tolerance_m[k])}`],
        note: () => `beyond ±${metres(this.heightLimit)} drawn at the edge`,
      },
      {
        title: "Protection levels and alert limits", table: "position", unit: "m", logarithmic: true, labels: ["HPL", "VPL", "alert limit", "vertical alert limit"],
        series: [line("level"), line("verified"), line("level", [6, 4]), line("verified", [6, 4])],
        columns: (a, rows) => ["hpl_m", "vpl_m", "alert_m", "vertical_alert_m"].map(name => rows.map(k => positive(a[name][k]))),
        extreme: "hpl_m",
        say: (a, k) => [`HPL ${metres(a.hpl_m[k])} of ${metres(a.alert_m[k], 1)}`, `VPL ${metres(a.vpl_m[k])} of ${metres(a.vertical_alert_m[k], 1)}`],
      },
      {
        title: "Position from", table: "position", band: true, labels: store.words.source.map(plain), colours: store.words.source.map(word => SOURCE_COLOURS[word]), series: [line("soft")],
        columns: (a, rows) => [rows.map(k => a.source[k])], range: () => [0, 1],
        say: (a, k) => [`${plain(store.word("source", a.source[k]))}, ${a.usable[k] ? "usable" : "not usable: " + plain(store.word("reason", a.reason[k]))}`],
      },
      {
        title: "Satellites", table: "fix", labels: ["used"], series: [{ ...line("confirmed"), paths: uPlot.paths.stepped({ align: 1 }) }],
        columns: (a, rows) => [rows.map(k => known(a.satellites[k]))], extreme: "satellites", range: (_, low, high) => [Math.max(0, Math.floor((low ?? 0) - 2)), Math.ceil((high ?? 10) + 2)],
        say: (a, k) => [`${Number.isFinite(a.satellites[k]) ? a.satellites[k] : "–"} used, ${plain(store.word("quality", a.quality[k]))}, ratio ${Number.isFinite(a.ratio[k]) ? a.ratio[k].toFixed(1) : "–"}`],
      },
      {
        title: "Age of inputs", table: "position", unit: "s", labels: AGES.map(plain), series: AGE_COLOURS.map(name => line(name)),
        columns: (a, rows) => AGES.map(name => rows.map(k => { const age = a[`age_${name}_s`][k]; return Number.isFinite(age) ? Math.min(Math.max(age, 0), MOST_AGE_S) : null; })),
        extreme: "age_fix_s", range: (_, low, high) => [0, Math.max(.5, 1.05 * (high ?? 1))],
        say: (a, k) => AGES.map(name => [name, a[`age_${name}_s`][k]]).filter(([, age]) => Number.isFinite(age)).map(([name, age]) => `${plain(name)} ${duration(Math.max(age, 0))}`),
        note: () => `older than ${MOST_AGE_S} s drawn at the edge`,
      },
    ];
  }

  makeChart(definition, lowest) {
    const { view } = this, holder = element("div", { class: "plot" }), values = element("span"), { colours = [] } = definition;
    const names = definition.labels.map((label, k) => element("span", {}, element("i", { style: { background: colours.length ? colour(colours[k]) : definition.series[k].stroke } }), label));
    const head = element("div", { class: "head", title: definition.note?.() ?? "" }, element("b", {}, definition.title + (definition.unit ? `, ${definition.unit}` : "")), ...names, values);
    const box = element("div", { class: definition.band ? "chart band" : "chart" }, head, holder);
    const letters = Math.round(11 * remPx() / 14), axisPx = Math.round(50 * remPx() / 14);
    const axis = { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: `${letters}px system-ui, sans-serif` };
    const plot = plotOnProcessor({
      width: 300, height: 80, legend: { show: false }, padding: [6, 8, 0, 0],
      cursor: {
        drag: { x: true, y: false, setScale: false }, y: false, points: { show: false },
        bind: { dblclick: () => () => null },
      },
      scales: { x: { time: true, range: () => [view.begin, view.end] }, y: definition.logarithmic ? { distr: 3, range: (_, low, high) => decades(low, high) } : { range: definition.range } },
      axes: [
        { ...axis, size: lowest ? letters + 9 : 4, space: 6.5 * letters, values: (_, splits) => splits.map(time => !lowest ? "" : time % 60 === 0 ? clock(time).slice(0, 5) : clock(time).slice(0, 8)) },
        definition.band ? { ...axis, size: axisPx, values: () => [], grid: { show: false } } : { ...axis, size: axisPx, space: 1.9 * letters, ...(definition.logarithmic ? { splits: (_, __, low, high) => roundNumbers(low, high), filter: (_, splits) => splits } : {}), values: (_, splits) => splits.map(value => value === null ? "" : String(+value.toPrecision(5)).replace("-", "−")) },
      ],
      series: [{}, ...definition.series.map(series => definition.band ? { ...series, show: true, paths: () => null, points: { show: false } } : series)],
      bands: definition.bands ?? [],
      hooks: {
        draw: definition.band ? [drawn => this.drawBand(drawn, colours)] : [drawn => this.drawMarks(drawn)],
        setCursor: [drawn => { if (drawn.cursor.event) view.point(drawn.cursor.left >= 0 ? drawn.posToVal(drawn.cursor.left, "x") : NaN); }],
        setSelect: [drawn => { if (drawn.select.width > 4) { view.range(drawn.posToVal(drawn.select.left, "x"), drawn.posToVal(drawn.select.left + drawn.select.width, "x")); drawn.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false); } }],
      },
    }, Array.from({ length: definition.series.length + 1 }, () => []), holder);
    plot.over.addEventListener("click", event => { const time = plot.posToVal(event.offsetX, "x"); if (Number.isFinite(time)) this.selectNear(time); });
    return { ...definition, box, holder, plot, values, names, head };
  }

  selectNear(time) {
    const { verdict } = this.store.tables, { t } = verdict.arrays, at = verdict.at(time);
    const next = at + 1 < verdict.length && (at < 0 || Math.abs(t[at + 1] - time) < Math.abs(t[at] - time)) ? at + 1 : at;
    if (next >= 0) this.view.select(t[next]);
  }

  resize() {
    for (const { plot, holder } of this.charts) {
      const { clientWidth: width, clientHeight: height } = holder;
      if (width > 40 && height > 20 && (plot.width !== width || plot.height !== height)) plot.setSize({ width, height });
    }
  }

  // Time that runs has not moved the charts by a pixel since they were drawn.
  isWithinPixel() {
    const { running, span, end } = this.view, { drawn } = this, passed = end - drawn?.end;
    return running && span === drawn?.span && passed >= 0 && passed < Math.min(span / this.charts[0].plot.width, MOST_WAIT_S);
  }

  refresh() {
    if (!Number.isFinite(this.view.end)) return;
    this.drawn = { span: this.view.span, end: this.view.end };
    for (const chart of this.charts) {
      const table = this.store.tables[chart.table];
      const rows = shownRows(table, this.view.begin, this.view.end, chart.extreme && table.arrays[chart.extreme]);
      const t = rows.map(k => table.arrays.t[k]);
      chart.plot.setData([t, ...chart.columns(table.arrays, rows)], true);
      if (chart.note) chart.head.title = chart.note();
    }
    this.showHover();
  }

  showHover() {
    const { hover } = this.view;
    for (const { plot, table, say, values, names } of this.charts) {
      const left = Number.isFinite(hover) ? plot.valToPos(hover, "x") : -10;
      if (Math.abs((plot.cursor.left ?? -10) - left) > .5) plot.setCursor({ left, top: 5 }, false);
      const rows = this.store.tables[table], at = Number.isFinite(hover) ? rows.at(hover + .05) : -1;
      for (const name of names) name.hidden = at >= 0;
      setText(values, at >= 0 ? say(rows.arrays, at).join(" · ") : "");
    }
  }

  drawBand(plot, colours) {
    const { ctx, bbox } = plot, [t, source] = plot.data;
    ctx.save();
    for (let k = 0; k < t.length; k++) {
      const from = plot.valToPos(t[k], "x", true), until = Math.min(t[k + 1] ?? t[k] + .2, t[k] + 2);
      ctx.fillStyle = colour(colours[source[k]] ?? "none");
      // Whole pixels, since half of one shows where two pieces meet.
      const x = Math.floor(Math.max(from, bbox.left)), end = Math.ceil(Math.min(plot.valToPos(until, "x", true), bbox.left + bbox.width));
      ctx.fillRect(x, bbox.top, Math.max(end - x, 1), bbox.height);
    }
    ctx.restore();
  }

  drawMarks(plot) {
    const { selected, begin, end } = this.view;
    if (!(selected >= begin && selected <= end)) return;
    const { ctx, bbox } = plot, x = plot.valToPos(selected, "x", true);
    ctx.save();
    ctx.strokeStyle = colour("erroneous");
    ctx.lineWidth = devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }

  // Title and legend of a chart, in letters that are small enough for its width.
  writeHead(c, chart, y, head) {
    const title = chart.title + (chart.unit ? `, ${chart.unit}` : ""), indent = 8 * devicePixelRatio, mark = head * .4;
    let size = 12 * devicePixelRatio + 1, total;
    do {
      size -= 1;
      c.font = `600 ${size}px system-ui, sans-serif`;
      total = indent + c.measureText(title).width + chart.labels.reduce((sum, label) => sum + c.measureText(label).width + mark + 1.4 * size, size);
    } while (total > c.canvas.width && size > 6);
    let x = indent;
    c.fillStyle = colour("ink");
    c.fillText(title, x, y + head * .7);
    x += c.measureText(title).width + size;
    c.font = `${size}px system-ui, sans-serif`;
    chart.labels.forEach((label, k) => {
      c.fillStyle = chart.colours ? colour(chart.colours[k]) : chart.series[k].stroke;
      c.fillRect(x, y + head * .34, mark, mark);
      c.fillStyle = colour("soft");
      c.fillText(label, x + mark + .4 * size, y + head * .7);
      x += c.measureText(label).width + mark + 1.4 * size;
    });
  }

  // All charts on one canvas, in their order.
  picture(width) {
    const canvases = this.charts.map(chart => [chart, chart.plot.ctx.canvas]), head = 22 * devicePixelRatio;
    const height = canvases.reduce((sum, [, canvas]) => sum + canvas.height * width / canvas.width + head, 0);
    const whole = element("canvas", { width, height }), c = whole.getContext("2d");
    let y = 0;
    for (const [chart, canvas] of canvases) {
      this.writeHead(c, chart, y, head);
      c.drawImage(canvas, 0, y + head, width, canvas.height * width / canvas.width);
      y += canvas.height * width / canvas.width + head;
    }
    return whole;
  }
}

export const dots = name => ({ stroke: colour(name), width: 0, paths: () => null, points: { show: true, size: 5, width: 0, fill: colour(name) } });
export const line = (name, dash) => ({ stroke: colour(name), width: 1.6, dash, points: { show: false } });
// uPlot asks for its context without attributes. Where WebGL is software, a chart's dots take the processor 150 ms as
// paths of a graphics processor, and a millisecond as pixels of its own.
function plotOnProcessor(options, data, holder) {
  const { prototype } = HTMLCanvasElement, { getContext } = prototype;
  prototype.getContext = function (kind) { return getContext.call(this, kind, { willReadFrequently: true }); };
  try { return new uPlot(options, data, holder); } finally { prototype.getContext = getContext; }
}

export const known = value => Number.isFinite(value) ? value : null;
export const positive = value => value > 0 && Number.isFinite(value) ? value : null;

// Rows between two times, of many the extreme ones of each piece.
function shownRows(table, begin, end, values) {
  const first = Math.max(table.at(begin), 0), last = table.at(end) + 1, rows = [];
  const step = Math.max(1, Math.ceil((last - first) / (MOST_POINTS / 2)));
  if (step === 1 || !values) { for (let k = first; k < last; k += step) rows.push(k); return rows; }
  for (let k = first; k < last; k += step) {
    let low = k, high = k;
    for (let j = k; j < Math.min(k + step, last); j++) {
      if (values[j] < values[low] || Number.isNaN(values[low])) low = j;
      if (values[j] > values[high] || Number.isNaN(values[high])) high = j;
    }
    rows.push(Math.min(low, high));
    if (low !== high) rows.push(Math.max(low, high));
  }
  return rows;
}

// Up to where differences are drawn: four times the largest tolerance.
function heightLimit(a, rows) {
  let most = .05;
  for (const k of rows) if (a.tolerance_m[k] > most) most = a.tolerance_m[k];
  return Math.min(4 * most, 20);
}

// Powers of ten between two numbers; where there are fewer than three, with twice and five times them.
export function roundNumbers(low, high) {
  const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9), powers = [];
  for (let power = first - 1; power <= last; power++) powers.push(...(last - first < 2 ? [1, 2, 5] : [1]).map(step => +(step * 10 ** power).toPrecision(1)));
  return powers.filter(value => value >= low * .999 && value <= high * 1.001);
}

function decades(low, high) {
  if (!(low > 0)) return [.1, 100];
  return [10 ** (Math.floor(Math.log10(low) * 2) / 2), 10 ** (Math.ceil(Math.log10(high * 1.05) * 2) / 2)];
}

customElements.define("camber-charts", CamberCharts);
