// Error against protection level of every position so far, where the truth is known.

import { colour, element, SOURCE_COLOURS } from "./dom.js";

const LEAST_M = .01;
const MOST_POINTS = 6000;
const NEAR_PX = 12;

// Clears a canvas and draws axes, areas and the diagonal for levels up to `most` metres; gives what draws on it.
export function stanfordAxes(canvas, most, alert) {
  const width = canvas.clientWidth, height = canvas.clientHeight, factor = devicePixelRatio;
  canvas.width = width * factor;
  canvas.height = height * factor;
  const c = canvas.getContext("2d");
  c.scale(factor, factor);
  const left = 38, bottom = height - 34, right = width - 6, top = 6;
  const scale = value => Math.log10(Math.max(value, LEAST_M) / LEAST_M) / Math.log10(most / LEAST_M);
  const x = value => left + (right - left) * scale(value), y = value => bottom - (bottom - top) * scale(value);
  const area = (fill, ...corners) => { c.fillStyle = fill; c.beginPath(); corners.forEach(([px, py], k) => c[k ? "lineTo" : "moveTo"](px, py)); c.fill(); };
  area(colour("erroneous") + "26", [left, bottom], [right, bottom], [right, top]);
  area(colour("unknown") + "33", [left, top], [right, top], [right, y(alert)], [x(alert), y(alert)], [left, y(alert)]);
  c.font = "11px system-ui, sans-serif";
  c.strokeStyle = colour("line");
  c.fillStyle = colour("soft");
  for (let value = LEAST_M; value <= most * 1.001; value *= 10) {
    c.beginPath(); c.moveTo(x(value), top); c.lineTo(x(value), bottom); c.moveTo(left, y(value)); c.lineTo(right, y(value)); c.stroke();
    const text = String(+value.toPrecision(1));
    c.textAlign = "center"; c.fillText(text, Math.min(x(value), right - 8), bottom + 13);
    c.textAlign = "right"; c.fillText(text, left - 4, y(value) + 4);
  }
  c.textAlign = "center";
  c.fillText("error, m", (left + right) / 2, height - 6);
  c.save(); c.translate(10, (top + bottom) / 2); c.rotate(-Math.PI / 2); c.fillText("HPL, m", 0, 0); c.restore();
  c.strokeStyle = colour("ink");
  c.beginPath(); c.moveTo(left, bottom); c.lineTo(right, top); c.stroke();
  const note = text => {
    c.fillStyle = colour("soft"); c.textAlign = "left"; c.fillText(`above the alert limit, ${+alert.toPrecision(3)} m`, left + 6, top + 14);
    c.textAlign = "right"; c.fillText(text, right - 6, bottom - 8);
  };
  return { c, x, y, note };
}

export class CamberStanford extends HTMLElement {
  start(store, view) {
    Object.assign(this, { store, view });
    this.canvas = element("canvas");
    this.ring = element("i", { class: "ring", hidden: true });
    this.append(element("h2", {}, "Horizontal error against protection level (Stanford chart)"), element("div", { class: "plot" }, this.canvas, this.ring));
    view.addEventListener("slow", () => this.refresh());
    view.addEventListener("theme", () => this.refresh());
    view.addEventListener("hover", () => this.mark());
    this.canvas.addEventListener("pointermove", event => view.point(this.timeAt(event.offsetX, event.offsetY)));
    this.canvas.addEventListener("pointerleave", () => view.point(NaN));
    this.canvas.addEventListener("click", event => { const time = this.timeAt(event.offsetX, event.offsetY); if (Number.isFinite(time)) view.select(time); });
  }

  // Rows that are drawn: of many some, and all with an error beyond the level.
  points() {
    const { position } = this.store.tables, a = position.arrays, end = position.at(this.view.end) + 1, step = Math.max(1, Math.ceil(end / MOST_POINTS));
    this.count = this.beyond = 0;
    const list = [];
    for (let k = 0; k < end; k++) {
      if (!(Number.isFinite(a.error_m[k]) && a.hpl_m[k] > 0)) continue;
      const beyond = a.error_m[k] > a.hpl_m[k];
      this.count++;
      if (beyond) this.beyond++;
      if (beyond || k % step === 0) list.push(k);
    }
    return list;
  }

  refresh() {
    if (!this.store.tables.position) return;
    const points = this.drawn = this.points(), a = this.store.tables.position.arrays;
    this.hidden = points.length === 0;
    if (this.hidden) return;
    const alert = a.alert_m[points[points.length - 1]], most = 10 ** Math.ceil(Math.log10(points.reduce((sum, k) => Math.max(sum, a.error_m[k], a.hpl_m[k]), 2 * alert)));
    const { c, x, y, note } = this.axes = stanfordAxes(this.canvas, most, alert);
    for (const k of points) { c.fillStyle = colour(SOURCE_COLOURS[this.store.word("source", a.source[k])] ?? "soft"); c.fillRect(x(a.error_m[k]) - 1, y(a.hpl_m[k]) - 1, 2.2, 2.2); }
    note(`error beyond the level: ${this.beyond} of ${this.count}`);
    this.mark();
  }

  timeAt(px, py) {
    const { t, error_m: error, hpl_m: level } = this.store.tables.position.arrays;
    let best = NaN, least = NEAR_PX;
    for (const k of this.drawn ?? []) {
      const away = Math.hypot(this.axes.x(error[k]) - px, this.axes.y(level[k]) - py);
      if (away < least) { least = away; best = t[k]; }
    }
    return best;
  }

  // A ring around the position at the cursor of the other charts.
  mark() {
    if (!this.axes) return;
    const { position } = this.store.tables, { t, error_m: error, hpl_m: level } = position.arrays, { hover } = this.view, k = Number.isFinite(hover) ? position.at(hover + .05) : -1;
    this.ring.hidden = !(k >= 0 && Math.abs(t[k] - hover) < 1 && Number.isFinite(error[k]) && level[k] > 0);
    if (!this.ring.hidden) Object.assign(this.ring.style, { left: `${this.axes.x(error[k])}px`, top: `${this.axes.y(level[k])}px` });
  }
}

customElements.define("camber-stanford", CamberStanford);
