// The map of a finished drive on a plain canvas: roads of the release, truth, positions and verdicts, one place marked in all charts.

import { colour, element, plain, VERDICT_COLOURS } from "../../../live/static/dom.js";
import { drawScaleAndNorth, keyLines, rampLines, RAMPS } from "../../../live/static/map_marks.js";
import { Overlay, stateAt } from "../../../live/static/overlay.js";
import { mercatorX, mercatorY } from "../../../live/static/track.js";

const EQUATOR_M = 40075016.7; // of the ellipsoid
const NEAR_PX = 14;
const GAP_S = 3; // a line of the truth ends where more is missing
const LEAST_WIDTH_M = 20, MOST_PX_PER_M = 400;
const UNKNOWN_PLACE = { zoom: 16, extent: 8192, origin: [0, 0], surfaces: [], sigma: [], links: [], note: "" };

export class FlatMap extends HTMLElement {
  start(store, view, roads) {
    Object.assign(this, { store, view, roads: roads ?? UNKNOWN_PLACE, pointers: new Map() });
    this.canvas = element("canvas", { class: "canvas" });
    this.overlay = new Overlay();
    const button = (text, title, action) => element("button", { type: "button", title, onclick: action }, text);
    const tools = element("div", { class: "tools" }, button("whole track", "show the whole track", () => this.fit(-Infinity, Infinity)), button("+", "larger", () => this.zoom(1.5)), button("−", "smaller", () => this.zoom(1 / 1.5)));
    const words = store.words.verdict, own = [...words.map(word => ["dot", VERDICT_COLOURS[word], plain(word)]), ["dot", "soft", "position"]];
    if (store.tables.truth.length) own.push(["line", "ink", "truth"]);
    own.push(["ring", "level", "protection level"], ["ring", "confirmed", "99 % ellipse"], ["ring", "pose", "prior pose, 99 %"]);
    this.append(this.canvas, this.overlay.canvas, tools, element("details", { class: "key", open: innerWidth > 760 }, element("summary", {}, "key"), ...keyLines(own), ...(roads ? rampLines(RAMPS.sigma) : []), this.roads.note));
    this.prepare();
    if (!this.places.verdict.some(Number.isFinite)) this.append(element("p", { class: "absent" }, "No verdict of this drive has a position."));
    this.listen();
    new ResizeObserver(() => { if (!this.placed) this.fit(-Infinity, Infinity); this.draw(); }).observe(this);
  }

  // Places in units of the roads' tile, x to the east and y to the south, and roads as paths by colour.
  prepare() {
    const { zoom, extent, origin, surfaces, sigma, links } = this.roads, scale = 2 ** zoom * extent, { tables } = this.store;
    this.units = (longitude, latitude) => [mercatorX(longitude) * scale - origin[0] * extent, mercatorY(latitude) * scale - origin[1] * extent];
    this.places = Object.fromEntries(["verdict", "position", "truth"].map(name => {
      const { lat, lon } = tables[name].arrays, xy = new Float64Array(2 * tables[name].length);
      for (let k = 0; k < tables[name].length; k++) xy.set(this.units(lon[k], lat[k]), 2 * k);
      return [name, xy];
    }));
    const latitude = tables.position.arrays.lat.find(Number.isFinite) ?? tables.verdict.arrays.lat.find(Number.isFinite) ?? 0;
    this.metresPerUnit = EQUATOR_M * Math.cos(latitude * Math.PI / 180) / scale;
    this.paths = new Map();
    surfaces.forEach((points, k) => {
      const fill = rampColour(RAMPS.sigma.stops, sigma[k]);
      if (!this.paths.has(fill)) this.paths.set(fill, new Path2D());
      addLine(this.paths.get(fill), points, true);
    });
    this.links = new Path2D();
    for (const points of links) addLine(this.links, points, false);
    this.truth = new Path2D();
    const { t } = tables.truth.arrays, xy = this.places.truth;
    for (let k = 0; k < tables.truth.length; k++) this.truth[k && t[k] - t[k - 1] < GAP_S ? "lineTo" : "moveTo"](xy[2 * k], xy[2 * k + 1]);
  }

  listen() {
    const { view, canvas } = this;
    for (const name of ["view", "theme"]) view.addEventListener(name, () => this.draw());
    for (const name of ["hover", "selection"]) view.addEventListener(name, () => this.draw(false));
    canvas.addEventListener("wheel", event => { if (!event.ctrlKey && !event.metaKey) return; event.preventDefault(); this.zoom(Math.exp(-event.deltaY * .002), event.offsetX, event.offsetY); }, { passive: false });
    canvas.addEventListener("dblclick", () => this.fit(-Infinity, Infinity));
    canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]); this.moved = 0; });
    canvas.addEventListener("pointermove", event => this.pointers.has(event.pointerId) ? this.drag(event) : view.point(this.timeAt(event.offsetX, event.offsetY)));
    canvas.addEventListener("pointerup", event => { const time = this.timeAt(event.offsetX, event.offsetY); if (this.moved < 4 && Number.isFinite(time)) view.select(time); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => this.pointers.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => view.point(NaN));
  }

  // One pointer moves the map, two also change its scale about their middle.
  drag(event) {
    const before = [...this.pointers.values()], [x, y] = this.pointers.get(event.pointerId), now = [event.offsetX, event.offsetY];
    this.moved += Math.hypot(now[0] - x, now[1] - y);
    this.pointers.set(event.pointerId, now);
    this.x -= (now[0] - x) / before.length / this.scale;
    this.y -= (now[1] - y) / before.length / this.scale;
    const after = [...this.pointers.values()], apart = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (after.length === 2) this.zoom(apart(after) / Math.max(apart(before), 1), (after[0][0] + after[1][0]) / 2, (after[0][1] + after[1][1]) / 2);
    this.draw();
  }

  zoom(by, px = this.clientWidth / 2, py = this.clientHeight / 2) {
    const [ux, uy] = [this.x + (px - this.clientWidth / 2) / this.scale, this.y + (py - this.clientHeight / 2) / this.scale];
    this.scale = Math.min(this.scale * by, MOST_PX_PER_M * this.metresPerUnit);
    this.x = ux - (px - this.clientWidth / 2) / this.scale;
    this.y = uy - (py - this.clientHeight / 2) / this.scale;
    this.draw();
  }

  // All verdicts between two times, in the middle of the map.
  fit(begin, end) {
    const { t } = this.store.tables.verdict.arrays, xy = this.places.verdict, low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (let k = 0; 2 * k < xy.length; k++) {
      if (!(t[k] >= begin && t[k] <= end && Number.isFinite(xy[2 * k]))) continue;
      for (const axis of [0, 1]) { low[axis] = Math.min(low[axis], xy[2 * k + axis]); high[axis] = Math.max(high[axis], xy[2 * k + axis]); }
    }
    if (low[0] > high[0] || !this.clientWidth) return;
    const least = LEAST_WIDTH_M / this.metresPerUnit;
    this.placed = true;
    [this.x, this.y] = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.scale = .86 * Math.min(this.clientWidth / Math.max(high[0] - low[0], least), this.clientHeight / Math.max(high[1] - low[1], least));
    this.draw();
  }

  goTo(time) {
    this.fit(time - 2, time + 2);
  }

  // What the overlay asks of a map.
  getContainer() { return this; }
  getBearing() { return 0; }
  project([longitude, latitude]) { const [ux, uy] = this.units(longitude, latitude); return { x: this.px(ux), y: this.py(uy) }; }
  px(ux) { return this.clientWidth / 2 + (ux - this.x) * this.scale; }
  py(uy) { return this.clientHeight / 2 + (uy - this.y) * this.scale; }

  timeAt(x, y) {
    const { t } = this.store.tables.verdict.arrays, xy = this.places.verdict;
    let best = NaN, least = NEAR_PX;
    for (let k = 0; 2 * k < xy.length; k++) {
      const away = Math.hypot(this.px(xy[2 * k]) - x, this.py(xy[2 * k + 1]) - y);
      if (away < least) { least = away; best = t[k]; }
    }
    return best;
  }

  // In the next frame; a cursor that moves draws the marks only.
  draw(whole = true) {
    this.whole ||= whole;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      if (!this.placed) return;
      if (this.whole) this.paint();
      this.whole = false;
      this.paintMarks();
    });
  }

  paint() {
    const factor = devicePixelRatio, { canvas, scale } = this, c = canvas.getContext("2d");
    canvas.width = this.clientWidth * factor;
    canvas.height = this.clientHeight * factor;
    c.fillStyle = colour("land");
    c.fillRect(0, 0, canvas.width, canvas.height);
    c.setTransform(scale * factor, 0, 0, scale * factor, this.px(0) * factor, this.py(0) * factor);
    for (const [fill, path] of this.paths) { c.fillStyle = fill; c.fill(path); }
    c.lineWidth = 1.2 / scale;
    c.strokeStyle = colour("links");
    c.stroke(this.links);
    c.lineWidth = 1.5 / scale;
    c.strokeStyle = colour("ink");
    c.stroke(this.truth);
    c.setTransform(factor, 0, 0, factor, 0, 0);
    this.paintDots(c);
    c.setTransform(1, 0, 0, 1, 0, 0);
    drawScaleAndNorth(c, canvas, { factor, metresPerPixel: this.metresPerUnit / scale });
  }

  // Verdicts outside the time shown are pale; erroneous ones are drawn last.
  paintDots(c) {
    const { verdict, position } = this.store.tables, { begin, end } = this.view, pxPerM = this.scale / this.metresPerUnit, size = Math.min(5, Math.max(1.8, 1.4 + pxPerM / 4));
    const dot = (xy, k, radius) => { const x = this.px(xy[2 * k]), y = this.py(xy[2 * k + 1]); if (x > -9 && y > -9 && x < this.clientWidth + 9 && y < this.clientHeight + 9) { c.beginPath(); c.arc(x, y, radius, 0, 7); c.fill(); } };
    c.fillStyle = colour("soft");
    for (let k = 0; k < position.length; k++) dot(this.places.position, k, .5 * size);
    for (const word of ["unknown", "confirmed", "confirmed_after_verification", "erroneous"]) {
      const place = this.store.words.verdict.indexOf(word);
      c.fillStyle = colour(VERDICT_COLOURS[word]);
      for (let k = 0; k < verdict.length; k++) {
        if (verdict.arrays.verdict[k] !== place) continue;
        c.globalAlpha = verdict.arrays.t[k] >= begin - 1e-6 && verdict.arrays.t[k] <= end + 1e-6 ? 1 : .25;
        dot(this.places.verdict, k, word === "erroneous" ? size + 1 : size);
      }
    }
    c.globalAlpha = 1;
  }

  // The state at the cursor, else at the fix that is looked at, to scale.
  paintMarks() {
    const { hover, selected } = this.view, { verdict } = this.store.tables, { t, lat, lon } = verdict.arrays, now = Number.isFinite(hover) ? hover : selected;
    const marks = [["hover", hover], ["selected", selected]].flatMap(([kind, time]) => {
      const at = Number.isFinite(time) ? verdict.at(time + .05) : -1;
      return at >= 0 && Math.abs(t[at] - time) < 2 && Number.isFinite(lat[at]) ? [{ kind, at: [lon[at], lat[at]] }] : [];
    });
    this.marked = marks;
    this.overlay.draw(this, Number.isFinite(now) ? stateAt(this.store, now + .05) : { shapes: [] }, marks);
  }
}

function addLine(path, points, closed) {
  for (let k = 0; k < points.length; k += 2) path[k ? "lineTo" : "moveTo"](points[k], points[k + 1]);
  if (closed) path.closePath();
}

// Colour of the next stop: steps instead of a gradient keep the number of paths small.
function rampColour(stops, value) {
  return stops.reduce((best, stop) => Math.abs(Math.log(stop[0] / value)) < Math.abs(Math.log(best[0] / value)) ? stop : best)[1];
}

customElements.define("camber-map", FlatMap);
