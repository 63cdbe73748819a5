// Points of the map's environment, tile by tile as they come into sight: what scan matching compares with.

import { colour } from "./dom.js";
import { linkedProgram, rgba, uniformPlaces } from "./track.js";

const TILE_ZOOM = 16;
const LEAST_ZOOM = 16.5; // below it points are a blur
const MOST_TILES = 12;
const LOW_M = 0, HIGH_M = 12; // heights between which the colour changes: the ground and the second floor

const VERTEX = `#version 300 es
uniform mat4 u_matrix; uniform float u_size; uniform float u_low; uniform float u_high; in vec3 a_point; out float v_height;
void main() { gl_Position = u_matrix * vec4(a_point.xy, 0.0, 1.0); gl_PointSize = u_size; v_height = clamp((a_point.z - u_low) / (u_high - u_low), 0.0, 1.0); }`;
const FRAGMENT = `#version 300 es
precision mediump float; uniform vec4 u_lower; uniform vec4 u_upper; in float v_height; out vec4 colour;
void main() { vec4 c = mix(u_lower, u_upper, v_height); colour = vec4(c.rgb * c.a, c.a); }`;

export class PointsLayer {
  constructor(id) {
    Object.assign(this, { id, type: "custom", renderingMode: "2d", shown: false });
    this.tiles = new Map(); // "x/y" → { x, y, count, buffer }, the longest unused first
  }

  onAdd(map, gl) {
    this.map = map;
    this.gl = gl;
    map.on("moveend", () => this.fetchSeen());
  }

  // Linked when it is used first: that waits for all that is being drawn.
  link(gl) {
    const program = this.program = linkedProgram(gl, VERTEX, FRAGMENT);
    this.places = uniformPlaces(gl, program, ["u_matrix", "u_size", "u_low", "u_high", "u_lower", "u_upper"]);
    this.attribute = gl.getAttribLocation(program, "a_point");
  }

  show(on) {
    this.shown = on;
    this.fetchSeen();
    this.map.triggerRepaint();
  }

  seen() {
    if (!this.shown || this.map.getZoom() < LEAST_ZOOM) return [];
    const bounds = this.map.getBounds(), side = 2 ** TILE_ZOOM, list = [];
    const column = longitude => Math.floor((longitude + 180) / 360 * side);
    const row = latitude => Math.floor((.5 - Math.asinh(Math.tan(latitude * Math.PI / 180)) / (2 * Math.PI)) * side);
    for (let x = column(bounds.getWest()); x <= column(bounds.getEast()); x++)
      for (let y = row(bounds.getNorth()); y <= row(bounds.getSouth()); y++) list.push([x, y]);
    return list.slice(0, MOST_TILES);
  }

  async fetchSeen() {
    for (const [x, y] of this.seen()) {
      const key = `${x}/${y}`;
      if (this.tiles.has(key)) continue;
      this.tiles.set(key, { x, y, count: 0, buffer: null });
      const reply = await fetch(`points/${key}`).catch(() => null);
      if (!reply?.ok) { this.tiles.delete(key); continue; }
      const data = await reply.arrayBuffer(), { gl } = this, buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      this.tiles.set(key, { x, y, count: data.byteLength / 12, buffer });
      this.forget();
      this.map.triggerRepaint();
    }
  }

  forget() {
    for (const [key, tile] of this.tiles) {
      if (this.tiles.size <= 2 * MOST_TILES) return;
      if (tile.buffer) this.gl.deleteBuffer(tile.buffer);
      this.tiles.delete(key);
    }
  }

  render(gl, args) {
    const seen = this.seen().map(([x, y]) => this.tiles.get(`${x}/${y}`)).filter(tile => tile?.count);
    if (!seen.length) return;
    const matrix = Array.from(args.defaultProjectionData.mainMatrix), side = 2 ** TILE_ZOOM;
    if (!this.program) this.link(gl);
    gl.useProgram(this.program);
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform1f(this.places.u_size, Math.min(3, 1 + (this.map.getZoom() - LEAST_ZOOM) * .5) * devicePixelRatio);
    gl.uniform1f(this.places.u_low, LOW_M);
    gl.uniform1f(this.places.u_high, HIGH_M);
    gl.uniform4fv(this.places.u_lower, rgba(colour("point-low"), .5));
    gl.uniform4fv(this.places.u_upper, rgba(colour("point-high"), .7));
    gl.enableVertexAttribArray(this.attribute);
    for (const { x, y, count, buffer } of seen) {
      const m = matrix.slice();
      for (let row = 0; row < 4; row++) {
        m[12 + row] += m[row] * x / side + m[4 + row] * y / side;
        m[row] /= side;
        m[4 + row] /= side;
      }
      gl.uniformMatrix4fv(this.places.u_matrix, false, new Float32Array(m));
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(this.attribute, 3, gl.FLOAT, false, 12, 0);
      gl.drawArrays(gl.POINTS, 0, count);
    }
    gl.disableVertexAttribArray(this.attribute);
  }
}
