// The satellites of the epoch shown, seen from below the sky: direction, C/N0, and which are left out of the position.

import { colour, duration, element, plain, setText } from "./dom.js";
import { SnapshotReader } from "./snapshots.js";

const RAMP = [[25, [182, 90, 106]], [32, [226, 154, 75]], [38, [224, 207, 106]], [44, [143, 181, 115]], [50, [79, 143, 131]]]; // dB-Hz
const RINGS_DEG = [0, 30, 60];
const STALE_S = 5;
const NOTHING = "No satellites are published. The gnss service does so where it solves raw observations itself, or where the receiver sends them: UBX-NAV-SAT with NAV-PVT, or NMEA GSV and GSA with GGA.";
const NOT_REPORTED = "use_not_reported";
const REASONS = {
  integers_unresolved: "integers not resolved", no_pseudorange: "no pseudorange", no_ephemeris: "no ephemeris", below_elevation_mask: "below the elevation mask",
  below_cn0_mask: "below the C/N0 mask", outlier: "codes contradict the others", not_differenced: "not seen by the base", no_position: "no position of this epoch",
  unhealthy: "unhealthy", reason_not_reported: "reason not reported", [NOT_REPORTED]: "used or not, not reported",
};

function cn0Colour(level) {
  if (level === null) return colour("unknown");
  const at = Math.min(Math.max(level, RAMP[0][0]), RAMP.at(-1)[0]), k = Math.max(1, RAMP.findIndex(([stop]) => stop >= at)), [low, a] = RAMP[k - 1], [high, b] = RAMP[k];
  const share = (at - low) / (high - low);
  return `rgb(${a.map((value, c) => Math.round(value + share * (b[c] - value))).join(" ")})`;
}

export class CamberSky extends HTMLElement {
  start(store, view) {
    Object.assign(this, { store, view, sky: null, reader: new SnapshotReader(store, view, "satellites") });
    const gradient = `linear-gradient(90deg, ${RAMP.map(([, rgb]) => `rgb(${rgb.join(" ")})`).join(", ")})`;
    this.line = element("p");
    this.canvas = element("canvas", { role: "img" });
    this.legend = element("div", { class: "legend" }, element("span", {}, element("i", { class: "used" }), "used"), element("span", {}, element("i", { class: "left" }), "left out"),
      element("span", {}, `C/N0 ${RAMP[0][0]}`, element("i", { class: "ramp", style: { background: gradient } }), `${RAMP.at(-1)[0]} dB-Hz`));
    this.reasons = element("div");
    this.append(element("h2", {}, "Satellites"), this.line, this.canvas, this.legend, this.reasons);
    view.addEventListener("view", () => this.refresh());
    view.addEventListener("slow", () => this.refresh());
    view.addEventListener("theme", () => this.draw());
    addEventListener("resize", () => this.draw());
    this.draw();
  }

  refresh() {
    this.reader.read(async reply => {
      this.sky = reply && await reply.json();
      this.draw();
    });
  }

  draw() {
    const { sky, view } = this, age = sky ? view.shown - sky.t : NaN, shown = age < STALE_S;
    for (const part of [this.canvas, this.legend, this.reasons]) part.hidden = !shown;
    if (!shown) {
      setText(this.line, sky ? `No satellites for ${duration(age)}.` : NOTHING);
      return;
    }
    const others = sky.satellites.filter(([, , , , use]) => use !== "used"), open = others.filter(([, , , , use]) => use === NOT_REPORTED).length;
    const counts = [`${sky.satellites.length - others.length} used`, `${others.length - open} left out`, ...(open ? [`${open} not reported`] : [])];
    setText(this.line, `${counts.join(", ")}; position: ${plain(sky.quality)}`);
    this.canvas.setAttribute("aria-label", this.line.textContent);
    this.drawPlot(sky.satellites);
    const byReason = Map.groupBy ? Map.groupBy(others, row => row[4]) : others.reduce((map, row) => map.set(row[4], [...map.get(row[4]) ?? [], row]), new Map());
    this.reasons.replaceChildren(...[...byReason].map(([use, rows]) => element("p", {}, element("b", {}, `${REASONS[use] ?? plain(use)}: `), rows.map(([name]) => name).join(", "))));
  }

  drawPlot(satellites) {
    const { canvas } = this, size = canvas.clientWidth, factor = devicePixelRatio, c = canvas.getContext("2d");
    canvas.width = canvas.height = Math.round(size * factor);
    c.scale(factor, factor);
    const unit = Math.max(size / 270, .8), middle = size / 2, radius = middle - 16 * unit;
    c.font = `${10 * unit}px system-ui, sans-serif`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    this.drawRings(c, { middle, radius, unit });
    // Those in the position last, so that nothing covers them.
    const ordered = [...satellites].sort((a, b) => (a[4] === "used") - (b[4] === "used"));
    for (const [name, azimuth, elevation, level, use] of ordered) {
      if (azimuth === null) continue;
      const away = radius * (90 - Math.max(elevation, 0)) / 90, angle = azimuth * Math.PI / 180;
      this.drawSatellite(c, { x: middle + away * Math.sin(angle), y: middle - away * Math.cos(angle), unit }, { name, level, isUsed: use === "used", isLeft: use !== "used" && use !== NOT_REPORTED });
    }
  }

  drawRings(c, { middle, radius, unit }) {
    c.strokeStyle = colour("line");
    c.fillStyle = colour("soft");
    for (const elevation of RINGS_DEG) {
      c.beginPath();
      c.arc(middle, middle, radius * (90 - elevation) / 90, 0, 2 * Math.PI);
      c.stroke();
    }
    c.beginPath();
    c.moveTo(middle - radius, middle); c.lineTo(middle + radius, middle); c.moveTo(middle, middle - radius); c.lineTo(middle, middle + radius);
    c.stroke();
    for (const [text, x, y] of [["N", 0, -1], ["E", 1, 0], ["S", 0, 1], ["W", -1, 0]]) c.fillText(text, middle + x * (radius + 9 * unit), middle + y * (radius + 9 * unit));
    // Between north and north-east, where a label is on no line.
    for (const elevation of RINGS_DEG) c.fillText(`${elevation}°`, middle + .38 * radius * (90 - elevation) / 90, middle - .92 * radius * (90 - elevation) / 90 + 6 * unit);
  }

  drawSatellite(c, { x, y, unit }, { name, level, isUsed, isLeft }) {
    c.beginPath();
    c.arc(x, y, 10 * unit, 0, 2 * Math.PI);
    c.fillStyle = isUsed ? cn0Colour(level) : colour("card");
    c.fill();
    c.lineWidth = isUsed ? 1 : 1.6;
    c.setLineDash(isLeft ? [3, 2] : []);
    c.strokeStyle = colour(isUsed ? "card" : isLeft ? "erroneous" : "unknown");
    c.stroke();
    c.setLineDash([]);
    c.fillStyle = isUsed ? "#10151c" : colour("ink");
    c.font = `600 ${8 * unit}px system-ui, sans-serif`;
    c.fillText(name, x, y + .5);
  }
}

customElements.define("camber-sky", CamberSky);
