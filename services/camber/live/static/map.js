// The map: roads of the release, the track by verdict, the newest fix beside the confirmed position, both to scale.

import * as maplibregl from "./vendor/maplibre-gl/maplibre-gl.mjs";
import { CHANGE_LEGEND, changeAt } from "./changes.js";
import { keyOf } from "./decision.js";
import { colour, element, plain, remPx, VERDICT_COLOURS } from "./dom.js";
import { drawLegend, drawScaleAndNorth, keyLines, rampLines, RAMPS } from "./map_marks.js";
import { Overlay, stateAt } from "./overlay.js";
import { PointsLayer } from "./points.js";
import { ScanMatchView } from "./scan.js";
import { rgba, TrackLayer } from "./track.js";

const NEAR_PX = 14;

export class CamberMap extends HTMLElement {
  start(store, view) {
    Object.assign(this, { store, view });
    this.canvas = element("div", { class: "canvas" });
    this.key = element("details", { class: "key", open: innerWidth > 760 });
    this.tools = element("div", { class: "tools" });
    this.overlay = new Overlay();
    this.scan = new ScanMatchView(this);
    this.append(this.canvas, this.overlay.canvas, this.tools, this.key);
    this.makeTools();
    store.addEventListener("greeting", () => this.drawKey());
    maplibregl.setWorkerUrl(new URL("./vendor/maplibre-gl/maplibre-gl-worker.mjs", import.meta.url).href);
    store.addEventListener("greeting", () => this.open());
    view.addEventListener("view", () => this.refresh());
    view.addEventListener("hover", () => this.mark());
    view.addEventListener("selection", () => this.mark());
    view.addEventListener("theme", () => this.paint());
    for (const name of ["fleet", "changes"]) store.addEventListener(name, () => this.refreshFleet());
  }

  refreshFleet() {
    if (!this.ready) return;
    if (!this.placed && [...this.store.fleet, ...changedPlaces(this.store)].some(({ lat }) => Number.isFinite(lat))) { this.placed = true; this.fit(); }
    const chosen = this.view.follow && this.store.fleet.find(vehicle => vehicle.vehicle === this.view.vehicle);
    if (chosen && Number.isFinite(chosen.lat)) this.map.jumpTo({ center: [chosen.lon, chosen.lat] });
    this.map.triggerRepaint();
  }

  makeTools() {
    const { view } = this;
    this.following = element("button", { type: "button", title: "keep the vehicle in the middle (f)", onclick: () => this.setFollow(!view.follow) }, "follow");
    const whole = element("button", { type: "button", title: "show the whole track (a)", onclick: () => this.fit() }, "whole track");
    const colours = element("select", { title: "colour of roads", onchange: event => { view.colour = event.target.value; this.paint(); view.change(); } },
      ...Object.entries(RAMPS).map(([name, ramp]) => element("option", { value: name }, ramp.title)));
    colours.value = view.colour;
    const levels = element("select", { title: "levels of roads that are shown", onchange: event => { view.level = event.target.value; this.filter(); view.change(); } },
      ...["all", "-2", "-1", "0", "1", "2"].map(name => element("option", { value: name }, name === "all" ? "all levels" : `level ${name.replace("-", "−")}`)));
    levels.value = view.level;
    this.pointing = element("button", { type: "button", title: "points of the map's environment (p)", onclick: () => this.setPoints(!view.points) }, "points");
    this.pointing.setAttribute("aria-pressed", String(view.points));
    this.tools.append(this.following, whole, this.pointing, this.scan.button, colours, levels, this.scan.line);
  }

  open() {
    this.map?.remove();
    this.ready = false;
    this.placed = this.given = Boolean(this.view.place);
    const [zoom, latitude, longitude, bearing] = this.view.place ?? [1, 20, 0, 0];
    const map = this.map = this.newMap({
      container: this.canvas, style: this.style(), center: [longitude, latitude], zoom, bearing, maxZoom: 24, minZoom: 1, maxPitch: 0,
      attributionControl: false, dragRotate: true, pitchWithRotate: false, fadeDuration: 0, canvasContextAttributes: { antialias: false },
    });
    if (!map) return;
    map.addControl(new maplibregl.NavigationControl({ visualizePitch: false }), "top-right");
    map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }), "bottom-left");
    map.on("load", () => { this.addLayers(); this.ready = true; this.paint(); this.refresh(); this.refreshFleet(); if (this.whole) this.fitWhole(); });
    map.on("moveend", event => {
      const centre = map.getCenter();
      this.view.place = [+map.getZoom().toFixed(2), +centre.lat.toFixed(7), +centre.lng.toFixed(7), +map.getBearing().toFixed(1)];
      if (event.originalEvent || this.placed) this.view.change("place");
    });
    map.on("dragstart", () => this.setFollow(false));
    map.on("mousemove", event => this.view.point(this.timeAt(event.point)));
    map.on("mouseout", () => this.view.point(NaN));
    map.on("click", event => { if (this.store.greeting.mode === "fleet") { this.chooseChange(event.point); return; } const time = this.timeAt(event.point); if (Number.isFinite(time)) this.view.select(time); });
    // Tiles that cannot be read are named among the notes; the map goes on without them.
    map.on("error", event => { if (!/AJAXError|tile/i.test(event.error?.message ?? "")) this.problem = event.error?.message; });
    map.on("render", () => {
      if (this.store.greeting.mode === "fleet") this.overlay.drawFleet(map, this.store, this.view);
      else if (this.now) this.overlay.draw(map, this.now, this.marked());
    });
  }

  // Null where the browser has no WebGL 2; to ask it before would cost a context more.
  newMap(options) {
    try { return new maplibregl.Map(options); } catch {
      this.notice ??= this.appendChild(element("p", { class: "notice" }, "This browser has no WebGL 2, so the map is not drawn. Charts, fixes and health work without it."));
      return null;
    }
  }

  style() {
    const { greeting } = this.store, sources = {}, layers = [{ id: "land", type: "background" }], filter = this.levelFilter();
    if (greeting.raster) {
      sources.raster = { type: "raster", tiles: [greeting.raster], tileSize: 256, maxzoom: 19 };
      layers.push({ id: "raster", type: "raster", source: "raster" });
    }
    if (greeting.map) {
      const address = new URL("map/{z}/{x}/{y}.mvt", location.href.split("#")[0].split("?")[0]).href.replaceAll("%7B", "{").replaceAll("%7D", "}");
      sources.roads = { type: "vector", tiles: [address], minzoom: 6, maxzoom: 16, ...(greeting.map.bounds ? { bounds: greeting.map.bounds } : {}) };
      layers.push(
        { id: "squares", type: "fill", source: "roads", "source-layer": "squares", paint: { "fill-opacity": .35 } },
        { id: "surfaces", type: "fill", source: "roads", "source-layer": "surfaces", minzoom: 15, layout: { "fill-sort-key": ["get", "level"] }, ...filter },
        { id: "links", type: "line", source: "roads", "source-layer": "links", paint: { "line-width": ["interpolate", ["linear"], ["zoom"], 12, 1, 18, 1.6] }, ...filter },
      );
    }
    const colours = this.paints();
    return { version: 8, sources, layers: layers.map(layer => ({ ...layer, paint: { ...layer.paint, ...colours[layer.id] } })) };
  }

  addLayers() {
    const { map, store, view } = this;
    const range = table => ({ first: 0, begin: table.at(view.begin) + 1, end: table.at(view.end) + 1 });
    const size = (small, large) => zoom => Math.min(large, Math.max(small, small + (zoom - 15) * .8)) * remPx() / 14;
    this.points = new PointsLayer("points");
    map.addLayer(this.points);
    if (view.points) this.points.show(true);
    map.addLayer(new TrackLayer("positions", {
      table: () => store.tables.position, code: () => 0, colours: () => Array(6).fill(rgba(colour("soft"))), size: size(2, 3.5), range,
    }));
    map.addLayer(new TrackLayer("track", {
      table: () => store.tables.verdict, code: (table, at) => table.arrays.verdict[at], emphasis: store.words.verdict.indexOf("erroneous"), size: size(4.5, 10), range,
      colours: () => [...store.words.verdict.map(word => rgba(colour(VERDICT_COLOURS[word] ?? "unknown"))), ...Array(6)].slice(0, 6).map(c => c ?? [0, 0, 0, 0]),
    }));
    this.scan.addLayer(map);
  }

  // Colours of the layers. They are in the style from its beginning: for other ones all tiles are read again.
  paints() {
    return {
      land: { "background-color": colour("land") }, links: { "line-color": colour("links") }, squares: { "fill-color": colour("links") },
      surfaces: { "fill-color": rampExpression(this.view.colour), "fill-outline-color": colour("land") },
    };
  }

  paint() {
    this.drawKey();
    if (!this.ready) return;
    for (const [id, values] of Object.entries(this.paints())) {
      if (!this.map.getLayer(id)) continue;
      for (const [name, value] of Object.entries(values)) this.map.setPaintProperty(id, name, value);
    }
    this.map.triggerRepaint();
  }

  levelFilter() { return this.view.level === "all" ? {} : { filter: ["==", ["get", "level"], Number(this.view.level)] }; }

  filter() {
    if (!this.map?.getLayer("surfaces")) return;
    for (const id of ["surfaces", "links"]) this.map.setFilter(id, this.levelFilter().filter ?? null);
  }

  setPoints(on) {
    this.view.points = on;
    this.pointing.setAttribute("aria-pressed", String(on));
    this.points?.show(on);
    this.view.change();
  }

  setFollow(on) {
    if (this.view.follow === on) return;
    this.view.follow = on;
    this.view.change();
    this.refresh();
  }

  // The state at the end of the view; called at most ten times a second.
  refresh() {
    this.following.setAttribute("aria-pressed", String(this.view.follow));
    if (!this.ready || !Number.isFinite(this.view.end)) return;
    this.now = stateAt(this.store, this.view.end);
    this.moveCamera();
    this.map.triggerRepaint();
    if (this.key.dataset.words !== String(this.store.words.verdict)) this.drawKey();
  }

  get here() { return this.now?.here ?? null; }

  moveCamera() {
    if (!this.placed && this.here) {
      this.placed = true;
      this.map.jumpTo({ center: this.here.slice(0, 2), zoom: 18.5 });
      if (!this.view.live) this.fit();
      return;
    }
    if (this.view.follow && this.view.running && this.here) this.map.jumpTo({ center: this.here.slice(0, 2) });
  }

  fit() {
    const { lat, lon } = this.store.tables.verdict.arrays, bounds = new maplibregl.LngLatBounds();
    for (const { lat, lon } of [...this.store.fleet, ...changedPlaces(this.store)]) if (Number.isFinite(lat)) bounds.extend([lon, lat]);
    const table = this.store.tables.verdict, step = Math.max(1, Math.floor(table.length / 5000));
    for (let k = 0; k < table.length; k += step) if (Number.isFinite(lat[k])) bounds.extend([lon[k], lat[k]]);
    if (!bounds.isEmpty()) this.map?.fitBounds(bounds, { padding: 60, maxZoom: 19, animate: false });
  }

  // A recording that has been read is shown whole, unless the address says which place.
  fitWhole() {
    this.whole = true;
    if (this.ready && !this.given) this.fit();
  }

  goTo(time) {
    const table = this.store.tables.verdict, at = table.at(time + 1e-3);
    if (at < 0 || !this.ready || !Number.isFinite(table.arrays.lat[at])) return;
    this.setFollow(false);
    this.map.jumpTo({ center: [table.arrays.lon[at], table.arrays.lat[at]], zoom: Math.max(this.map.getZoom(), 19.5) });
  }

  // A place in the middle of the map, at least so large.
  showPlace(center, zoom) {
    if (!this.ready) return;
    this.placed = true;
    this.map.jumpTo({ center, zoom: Math.max(this.map.getZoom(), zoom) });
  }

  chooseChange(point) {
    const chosen = changeAt(this.map, this.store.changes, point);
    if (chosen) { this.setFollow(false); this.view.lookAt(keyOf(chosen.kind, chosen.row)); }
  }

  mark() { this.map?.triggerRepaint(); }

  // Places of the verdicts at the cursor and of the one that is looked at.
  marked() {
    const { t, lat, lon } = this.store.tables.verdict.arrays, table = this.store.tables.verdict;
    return [["hover", this.view.hover], ["selected", this.view.selected]].flatMap(([kind, time]) => {
      const at = Number.isFinite(time) ? table.at(time + 1e-3) : -1;
      return at >= 0 && Math.abs(t[at] - time) < 2 && Number.isFinite(lat[at]) ? [{ kind, at: [lon[at], lat[at]] }] : [];
    });
  }

  timeAt({ x, y }) {
    const table = this.store.tables.verdict;
    if (!table || !this.ready) return NaN;
    const corner = this.map.unproject([x - NEAR_PX, y + NEAR_PX]), other = this.map.unproject([x + NEAR_PX, y - NEAR_PX]);
    const [west, east] = [corner.lng, other.lng].sort((a, b) => a - b), [south, north] = [corner.lat, other.lat].sort((a, b) => a - b);
    const { lat, lon, t } = table.arrays;
    let best = NaN, least = NEAR_PX;
    for (let k = table.at(this.view.end); k >= 0; k--) {
      if (!(lat[k] > south && lat[k] < north && lon[k] > west && lon[k] < east)) continue;
      const at = this.map.project([lon[k], lat[k]]), away = Math.hypot(at.x - x, at.y - y);
      if (away < least) { least = away; best = t[k]; }
    }
    return best;
  }

  // Kind of mark, its colour and what it stands for.
  legend() {
    const { greeting, words } = this.store;
    if (greeting?.mode === "fleet") return [["dot", "good", "position usable"], ["dot", "bad", "not usable"], ["dot", "unknown", "silent"], ["ring", "level", "protection level"], ...CHANGE_LEGEND];
    return [...(words.verdict ?? []).map(word => ["dot", VERDICT_COLOURS[word], plain(word)]),
      ["ring", "level", "protection level"], ["ring", "confirmed", "99 % ellipse"], ["ring", "pose", "prior pose, 99 %"]];
  }

  drawKey() {
    this.key.dataset.words = String(this.store.words.verdict);
    this.key.replaceChildren(element("summary", {}, "key"), ...keyLines(this.legend()), ...this.scan.key(), ...(this.store.greeting?.map ? rampLines(RAMPS[this.view.colour]) : []));
  }

  // The map as it is now, with its scale and north, on a canvas.
  picture() {
    if (!this.ready) return Promise.resolve(null);
    return new Promise(done => {
      this.map.once("render", () => {
        const source = this.map.getCanvas(), copy = element("canvas", { width: source.width, height: source.height }), c = copy.getContext("2d");
        c.drawImage(source, 0, 0);
        c.drawImage(this.overlay.canvas, 0, 0, copy.width, copy.height);
        const factor = copy.width / this.canvas.clientWidth, y = this.canvas.clientHeight / 2;
        const metresPerPixel = this.map.unproject([0, y]).distanceTo(this.map.unproject([100, y])) / 100;
        drawScaleAndNorth(c, copy, { factor, metresPerPixel, bearing: this.map.getBearing() });
        drawLegend(c, copy, factor, [...this.legend(), ...this.scan.legend()]);
        done(copy);
      });
      this.map.triggerRepaint();
    });
  }
}

function rampExpression(name) {
  const today = Date.now() / 864e5;
  const value = name === "day" ? ["max", 0, ["-", today, ["get", "day"]]] : ["get", name];
  return ["interpolate", ["linear"], value, ...RAMPS[name].stops.flat()];
}

const changedPlaces = ({ changes }) => changes ? [...changes.held, ...changes.pending, ...changes.published, ...changes.alarms] : [];

customElements.define("camber-map", CamberMap);
