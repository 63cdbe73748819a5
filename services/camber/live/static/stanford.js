// Error against protection level of every position so far, where the truth is known.

import { colour, element, SOURCE_COLOURS } from "./dom.js";

const LEAST_M = .01;
const MOST_POINTS = 6000;

export class CamberStanford extends HTMLElement {
  start(store, view) {
    Object.assign(this, { store, view });
    this.canvas = element("canvas");
    this.append(element("h2", {}, "Horizontal error against protection level (Stanford chart)"), this.canvas);
    view.addEventListener("slow", () => this.refresh());
    view.addEventListener("theme", () => this.refresh());
  }

  points() {
    const { position } = this.store.tables, a = position.arrays, end = position.at(this.view.end) + 1, step = Math.max(1, Math.ceil(end / MOST_POINTS)), list = [];
    for (let k = 0; k < end; k += step) if (Number.isFinite(a.error_m[k]) && a.hpl_m[k] > 0) list.push([a.error_m[k], a.hpl_m[k], a.source[k], a.alert_m[k]]);
    return list;
  }

  refresh() {
    if (!this.store.tables.position) return;
    const points = this.points();
    this.hidden = points.length === 0;
    if (this.hidden) return;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight, factor = devicePixelRatio;
    this.canvas.width = width * factor;
    this.canvas.height = height * factor;
    const c = this.canvas.getContext("2d");
    c.scale(factor, factor);
    const alert = points[points.length - 1][3], most = 10 ** Math.ceil(Math.log10(Math.max(2 * alert, ...points.map(p => Math.max(p[0], p[1])))));
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
    for (const [error, level, source] of points) { c.fillStyle = colour(SOURCE_COLOURS[this.store.word("source", source)] ?? "soft"); c.fillRect(x(error) - 1, y(level) - 1, 2.2, 2.2); }
    c.strokeStyle = colour("ink");
    c.beginPath(); c.moveTo(left, bottom); c.lineTo(right, top); c.stroke();
    const beyond = points.filter(([error, level]) => error > level).length;
    c.fillStyle = colour(beyond ? "erroneous" : "soft");
    c.textAlign = "right";
    c.fillText(`error beyond the level: ${beyond} of ${points.length}`, right - 6, bottom - 8);
    c.fillStyle = colour("soft");
    c.textAlign = "left";
    c.fillText("above the alert limit", left + 6, top + 14);
  }
}

customElements.define("camber-stanford", CamberStanford);
