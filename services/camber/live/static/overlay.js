// What is true at one time, drawn to scale over the map: levels, ellipses, fix and position, the vehicle.

import { drawChanges } from "./changes.js";
import { colour, element, remPx, VERDICT_COLOURS } from "./dom.js";

const EARTH_M = 6378137;
const LARGEST_M = 5000; // of what is drawn to scale: more covers the map
const TO_99 = 3.035; // half axes of the 99 % ellipse in σ, two dimensions
const RECENT_S = 3;
const FIX_S = 1;

// The newest pose, position and verdict at a time, as places [longitude, latitude] and half axes in metres.
export function stateAt(store, time) {
  const { position, verdict, pose } = store.tables, state = { here: null, shapes: [], fix: null, position: null };
  const p = position.at(time), v = verdict.at(time), q = pose.at(time);
  const recent = (table, at, seconds) => at >= 0 && time - table.arrays.t[at] < seconds && Number.isFinite(table.arrays.lat[at]);
  if (recent(pose, q, RECENT_S)) {
    const a = pose.arrays, at = [a.lon[q], a.lat[q]], [major, minor, angle] = ellipseOf(a.ee[q], a.en[q], a.nn[q]);
    state.shapes.push({ kind: "pose", at, major: TO_99 * major, minor: TO_99 * minor, angle });
    state.here = [...at, a.yaw_rad[q]];
  }
  if (recent(position, p, RECENT_S)) {
    const a = position.arrays, at = [a.lon[p], a.lat[p]];
    state.shapes.push({ kind: "level", at, major: a.hpl_m[p], minor: a.hpl_m[p], angle: 0 });
    state.shapes.push({ kind: "confirmed", at, major: a.major_m[p], minor: a.minor_m[p], angle: a.orientation_rad[p] });
    state.position = at;
    state.here = [...at, Number.isFinite(a.yaw_rad[p]) ? a.yaw_rad[p] : state.here?.[2]];
  }
  if (recent(verdict, v, FIX_S)) state.fix = { at: [verdict.arrays.lon[v], verdict.arrays.lat[v]], verdict: store.word("verdict", verdict.arrays.verdict[v]) };
  return state;
}

const SILENT_S = 5;

export function fleetColour({ t, usable }) {
  if (!Number.isFinite(t) || Date.now() / 1000 - t > SILENT_S) return "unknown";
  return usable ? "good" : "bad";
}

export class Overlay {
  constructor() { this.canvas = element("canvas", { class: "overlay" }); }

  begin(map) {
    const { clientWidth: width, clientHeight: height } = map.getContainer(), factor = devicePixelRatio, { canvas } = this;
    if (canvas.width !== Math.round(width * factor) || canvas.height !== Math.round(height * factor)) {
      canvas.width = Math.round(width * factor);
      canvas.height = Math.round(height * factor);
    }
    const c = this.context = canvas.getContext("2d");
    c.setTransform(factor, 0, 0, factor, 0, 0);
    c.clearRect(0, 0, width, height);
    this.map = map;
    this.unit = remPx() / 14;
    return c;
  }

  draw(map, state, marks) {
    this.begin(map);
    for (const shape of state.shapes) this.shape(shape);
    const at = state.position && this.pixel(state.position), fix = state.fix && this.pixel(state.fix.at);
    if (at && fix && state.fix.verdict === "erroneous") this.line(at, fix, colour("erroneous"), 2.5);
    if (at) this.ring(at, 4.5, colour("card"), 2, colour("confirmed"));
    if (fix) this.ring(fix, 7.5, colour(VERDICT_COLOURS[state.fix.verdict] ?? "unknown"), 3);
    if (state.here) this.arrow(this.pixel(state.here), state.here[2]);
    for (const mark of marks) this.ring(this.pixel(mark.at), mark.kind === "hover" ? 9 : 13, colour("ink"), mark.kind === "hover" ? 2 : 3);
  }

  // Every vehicle with its name: red where its position may not be used, grey where nothing comes from it any more.
  drawFleet(map, { fleet: vehicles, changes }, { vehicle: selected, changeKey }) {
    const c = this.begin(map);
    drawChanges(this, changes, changeKey);
    c.font = `${12 * this.unit}px system-ui, sans-serif`;
    for (const vehicle of vehicles) {
      if (!Number.isFinite(vehicle.lat)) continue;
      const at = this.pixel([vehicle.lon, vehicle.lat]), fill = colour(fleetColour(vehicle));
      if (vehicle.hpl_m > 0) this.shape({ kind: "level", at: [vehicle.lon, vehicle.lat], major: vehicle.hpl_m, minor: vehicle.hpl_m, angle: 0 });
      if (Number.isFinite(vehicle.yaw_rad)) this.arrow(at, vehicle.yaw_rad, fill); else this.ring(at, 7, colour("card"), 2, fill);
      if (vehicle.vehicle === selected) this.ring(at, 17, colour("ink"), 3);
      c.lineWidth = 3 * this.unit;
      c.strokeStyle = colour("land");
      c.strokeText(vehicle.vehicle, at.x + 14 * this.unit, at.y + 4 * this.unit);
      c.fillStyle = colour("ink");
      c.fillText(vehicle.vehicle, at.x + 14 * this.unit, at.y + 4 * this.unit);
    }
  }

  pixel([longitude, latitude]) { return this.map.project([longitude, latitude]); }

  shape({ kind, at, major, minor, angle }) {
    if (!(major > 0 && minor > 0 && major < LARGEST_M)) return;
    const c = this.context, [longitude, latitude] = at, degree = EARTH_M * Math.PI / 180, shrink = Math.cos(latitude * Math.PI / 180);
    const cosine = Math.cos(angle || 0), sine = Math.sin(angle || 0);
    c.beginPath();
    for (let k = 0; k < 72; k++) {
      const a = major * Math.cos(k * Math.PI / 36), b = minor * Math.sin(k * Math.PI / 36);
      const { x, y } = this.pixel([longitude + (a * cosine - b * sine) / degree / shrink, latitude + (a * sine + b * cosine) / degree]);
      c[k ? "lineTo" : "moveTo"](x, y);
    }
    c.closePath();
    c.strokeStyle = colour(kind);
    c.lineWidth = (kind === "pose" ? 1.3 : 2) * this.unit;
    c.setLineDash(kind === "confirmed" ? [] : kind === "level" ? [7, 5] : [2, 3]);
    if (kind === "level") { c.fillStyle = colour(kind) + "1a"; c.fill(); }
    c.stroke();
    c.setLineDash([]);
  }

  line(from, to, stroke, width) {
    const c = this.context;
    c.beginPath();
    c.moveTo(from.x, from.y);
    c.lineTo(to.x, to.y);
    c.strokeStyle = stroke;
    c.lineWidth = width * this.unit;
    c.stroke();
  }

  ring({ x, y }, radius, stroke, width, fill = null) {
    const c = this.context;
    c.beginPath();
    c.arc(x, y, radius * this.unit, 0, 2 * Math.PI);
    if (fill) { c.fillStyle = fill; c.fill(); }
    c.strokeStyle = stroke;
    c.lineWidth = width * this.unit;
    c.stroke();
  }

  // Heading is the yaw, counter-clockwise from east; where it is not known there is no arrow.
  arrow({ x, y }, yaw, fill = colour("ink")) {
    if (!Number.isFinite(yaw)) return;
    const c = this.context, size = 12 * this.unit;
    c.save();
    c.translate(x, y);
    c.rotate(Math.PI / 2 - yaw - this.map.getBearing() * Math.PI / 180);
    c.beginPath();
    c.moveTo(0, -size); c.lineTo(.62 * size, .8 * size); c.lineTo(0, .42 * size); c.lineTo(-.62 * size, .8 * size);
    c.closePath();
    c.fillStyle = fill;
    c.fill();
    c.strokeStyle = colour("card");
    c.lineWidth = 1.8 * this.unit;
    c.stroke();
    c.restore();
  }
}

// Half axes of one σ and the major axis's angle.
function ellipseOf(ee, en, nn) {
  const middle = (ee + nn) / 2, apart = Math.hypot((ee - nn) / 2, en);
  return [Math.sqrt(Math.max(middle + apart, 0)), Math.sqrt(Math.max(middle - apart, 0)), Math.atan2(2 * en, ee - nn) / 2];
}
