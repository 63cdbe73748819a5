// The last scan match seen from above: its points where the match has put them, coloured by their distance from the map.

import { clock, colour, duration, element, metres, setText } from "./dom.js";
import { keyLines, rampLines } from "./map_marks.js";
import { SnapshotReader } from "./snapshots.js";
import { linkedProgram, rgba, uniformPlaces } from "./track.js";

const STALE_S = 3;
const FULL_M = .1; // largest distance that the colours tell apart. Chosen: five times the noise of a LiDAR
const NOT_KNOWN = -32768; // in the server's columns
const LEAST_ZOOM = 18.5; // at which a street fills the map
const NOTHING = "No points of a scan match: the localizer publishes them where sweeps match a map that has point clouds.";

const VERTEX = `#version 300 es
uniform mat4 u_matrix; uniform float u_size; uniform vec4 u_before; uniform vec4 u_on; uniform vec4 u_beyond; uniform vec4 u_unpaired;
in vec2 a_place; in float a_share; out vec4 v_colour;
void main() {
  gl_Position = u_matrix * vec4(a_place, 0.0, 1.0);
  gl_PointSize = u_size;
  v_colour = a_share > 1.5 ? u_unpaired : a_share < 0.0 ? mix(u_on, u_before, -a_share) : mix(u_on, u_beyond, a_share);
}`;
const FRAGMENT = `#version 300 es
precision mediump float; in vec4 v_colour; out vec4 colour;
void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  colour = vec4(v_colour.rgb * v_colour.a, v_colour.a);
}`;

// Columns of the server: time, latitude, longitude; then east and north in cm, distance in mm.
function parsed(buffer) {
  const [t, lat, lon] = new Float64Array(buffer, 0, 3), numbers = new Int16Array(buffer, 24), count = numbers.length / 3;
  const column = k => numbers.subarray(k * count, (k + 1) * count);
  return { t, lat, lon, count, east: column(0), north: column(1), residual: column(2) };
}

// Per metre of east and north, in parts of the map's square: the radii of curvature of WGS 84 at the place.
function squarePerMetre(latitude) {
  const sine = Math.sin(latitude), cosine = Math.cos(latitude), flat = 1 - .00669437999014 * sine * sine;
  const across = 6378137 / Math.sqrt(flat), along = across * (1 - .00669437999014) / flat;
  return [1 / (2 * Math.PI * across * cosine), 1 / (2 * Math.PI * along * cosine)];
}

class ScanLayer {
  constructor(id) { Object.assign(this, { id, type: "custom", renderingMode: "2d", shown: null }); }

  onAdd(map, gl) {
    Object.assign(this, { map, gl, buffer: gl.createBuffer() });
    const program = this.program = linkedProgram(gl, VERTEX, FRAGMENT);
    this.places = uniformPlaces(gl, program, ["u_matrix", "u_size", "u_before", "u_on", "u_beyond", "u_unpaired"]);
    this.place = gl.getAttribLocation(program, "a_place");
    this.share = gl.getAttribLocation(program, "a_share");
  }

  show(match) {
    this.shown = match;
    if (match) {
      const { gl } = this, array = new Float32Array(3 * match.count), latitude = match.lat * Math.PI / 180, [perEast, perNorth] = squarePerMetre(latitude);
      for (let k = 0; k < match.count; k++) {
        const residual = match.residual[k];
        array.set([match.east[k] / 100 * perEast, -match.north[k] / 100 * perNorth, residual === NOT_KNOWN ? 2 : Math.min(Math.max(residual / 1000 / FULL_M, -1), 1)], 3 * k);
      }
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.DYNAMIC_DRAW);
      this.origin = [(match.lon + 180) / 360, .5 - Math.asinh(Math.tan(latitude)) / (2 * Math.PI)];
    }
    this.map.triggerRepaint();
  }

  render(gl, args) {
    if (!this.shown) return;
    // About the match: a float has no centimetres of the whole map.
    const m = Array.from(args.defaultProjectionData.mainMatrix), [x, y] = this.origin;
    for (let row = 0; row < 4; row++) m[12 + row] += m[row] * x + m[4 + row] * y;
    gl.useProgram(this.program);
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(this.places.u_matrix, false, new Float32Array(m));
    gl.uniform1f(this.places.u_size, Math.min(6, Math.max(2.5, 2.5 + (this.map.getZoom() - 18))) * devicePixelRatio);
    gl.uniform4fv(this.places.u_before, rgba(colour("scan-before"), 1));
    gl.uniform4fv(this.places.u_on, rgba(colour("scan-on"), 1));
    gl.uniform4fv(this.places.u_beyond, rgba(colour("scan-beyond"), 1));
    gl.uniform4fv(this.places.u_unpaired, rgba(colour("scan-unpaired"), 1));
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const [attribute, size, offset] of [[this.place, 2, 0], [this.share, 1, 8]]) {
      gl.enableVertexAttribArray(attribute);
      gl.vertexAttribPointer(attribute, size, gl.FLOAT, false, 12, offset);
    }
    gl.drawArrays(gl.POINTS, 0, this.shown.count);
    gl.disableVertexAttribArray(this.place);
    gl.disableVertexAttribArray(this.share);
  }
}

// The button, the line and the layer of one map.
export class ScanMatchView {
  constructor(host) {
    const { store, view } = host;
    Object.assign(this, { host, store, view, match: null, layer: null, reader: new SnapshotReader(store, view, "scan_match_points") });
    this.button = element("button", { type: "button", class: "scan", title: "points of the last scan match, by their distance from the map (s)", onclick: () => this.toggle() }, "scan match");
    this.line = element("div", { class: "line" });
    view.addEventListener("view", () => this.refresh());
    this.showState();
  }

  addLayer(map) {
    this.layer = new ScanLayer("scan");
    map.addLayer(this.layer);
    this.reader.asked = null;
    this.match = null;
    this.refresh();
  }

  toggle() {
    this.view.scan = !this.view.scan;
    this.view.change();
    this.reader.asked = null;
    this.isNew = this.view.scan;
    this.showState();
    this.host.drawKey();
    this.refresh();
  }

  showState() {
    this.button.setAttribute("aria-pressed", String(this.view.scan));
    this.line.hidden = !this.view.scan;
  }

  refresh() {
    if (!this.layer) return;
    if (!this.view.scan) { if (this.layer.shown) this.layer.show(null); return; }
    this.reader.read(async reply => {
      this.match = reply && parsed(await reply.arrayBuffer());
      this.draw();
    });
  }

  draw() {
    const { match, view } = this, age = match ? view.end - match.t : NaN, shown = age < STALE_S && view.scan;
    this.layer.show(shown ? match : null);
    if (!shown) { setText(this.line, match ? `No scan match for ${duration(age)}.` : NOTHING); return; }
    const sizes = Array.from(match.residual).filter(value => value !== NOT_KNOWN).map(Math.abs).sort((a, b) => a - b), middle = sizes[sizes.length >> 1];
    setText(this.line, `Scan match of ${clock(match.t)}: ${match.count} points, half of them within ${metres(middle / 1000)} of the map, ${match.count - sizes.length} without a surface of the map near`);
    if (this.isNew) this.host.showPlace([match.lon, match.lat], LEAST_ZOOM);
    this.isNew = false;
  }

  legend() { return this.view.scan ? [["dot", "scan-before", "before the map's surface"], ["dot", "scan-on", "on it"], ["dot", "scan-beyond", "beyond it"], ["dot", "scan-unpaired", "no surface near"]] : []; }

  key() {
    if (!this.view.scan) return [];
    const stops = ["scan-before", "scan-on", "scan-beyond"].map((name, k) => [k, colour(name)]);
    return [...rampLines({ title: "scan match: before … beyond the map", stops, ends: [`−${100 * FULL_M} cm`, `+${100 * FULL_M} cm`] }), ...keyLines(this.legend().slice(3))];
  }
}
