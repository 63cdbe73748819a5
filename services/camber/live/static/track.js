// Points of the track, drawn by WebGL beside the map's own layers: an hour of them costs the page nothing a frame.

const VERTEX = `#version 300 es
uniform mat4 u_matrix; uniform float u_size; uniform vec4 u_colours[6]; uniform float u_alpha; uniform float u_only;
layout(location = 0) in vec2 a_place; layout(location = 1) in float a_code; out vec4 v_colour;
void main() {
  bool shown = a_code >= 0.0 && (u_only < 0.0 || abs(a_code - u_only) < 0.5);
  gl_Position = shown ? u_matrix * vec4(a_place, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = u_size;
  v_colour = u_colours[int(max(a_code, 0.0))];
  v_colour.a *= u_alpha;
}`;
const FRAGMENT = `#version 300 es
precision mediump float; in vec4 v_colour; out vec4 colour;
void main() {
  float away = length(gl_PointCoord - 0.5);
  float edge = fwidth(away);
  float alpha = v_colour.a * (1.0 - smoothstep(0.5 - edge, 0.5, away));
  if (alpha < 0.02) discard;
  colour = vec4(v_colour.rgb * alpha, alpha);
}`;

export function linkedProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}

// Linking waits for all that is being drawn, so the layers of one map share the program.
const programs = new WeakMap();
function trackProgram(gl) {
  if (!programs.has(gl)) {
    const program = linkedProgram(gl, VERTEX, FRAGMENT);
    programs.set(gl, { program, places: uniformPlaces(gl, program, ["u_matrix", "u_size", "u_colours", "u_alpha", "u_only"]) });
  }
  return programs.get(gl);
}

export const uniformPlaces = (gl, program, names) => Object.fromEntries(names.map(name => [name, gl.getUniformLocation(program, name)]));

export class TrackLayer {
  // `code(table, index)` is the place of a row's colour among `colours`, below 0: not drawn; `emphasis` is drawn last.
  constructor(id, { table, code, colours, size, emphasis = -1, range }) {
    Object.assign(this, { id, type: "custom", renderingMode: "2d", table, code, colours, size, emphasis, range });
    this.uploaded = 0;
    this.changes = -1;
    this.origin = null;
  }

  onAdd(map, gl) {
    this.map = map;
    Object.assign(this, trackProgram(gl));
    this.buffer = gl.createBuffer();
    this.capacity = 0;
    this.uploaded = 0;
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 12, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 1, gl.FLOAT, false, 12, 8);
    gl.bindVertexArray(null);
  }

  onRemove(_, gl) {
    gl.deleteBuffer(this.buffer);
    gl.deleteVertexArray(this.array);
  }

  // Coordinates are relative to the first place, since a float of the whole world is metres coarse.
  upload(gl) {
    const table = this.table();
    if (!table) return 0;
    const whole = table.changes !== this.changes || table.length < this.uploaded || table.length > this.capacity;
    const from = whole ? 0 : this.uploaded, { lat, lon } = table.arrays, rows = table.length - from;
    if (rows <= 0 && !whole) return table.length;
    const data = new Float32Array(3 * Math.max(rows, 0));
    for (let k = 0; k < rows; k++) {
      const at = from + k, longitude = lon[at], latitude = lat[at];
      if (!Number.isFinite(longitude) || !Number.isFinite(latitude)) { data[3 * k + 2] = -1; continue; }
      const x = mercatorX(longitude), y = mercatorY(latitude);
      this.origin ??= [x, y];
      data.set([x - this.origin[0], y - this.origin[1], this.code(table, at)], 3 * k);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    if (whole) {
      this.capacity = Math.max(8192, 2 * table.length);
      gl.bufferData(gl.ARRAY_BUFFER, 12 * this.capacity, gl.DYNAMIC_DRAW);
      this.changes = table.changes;
    }
    if (rows > 0) gl.bufferSubData(gl.ARRAY_BUFFER, 12 * from, data);
    this.uploaded = table.length;
    return table.length;
  }

  render(gl, args) {
    if (!this.upload(gl) || !this.origin) return;
    const { first, begin, end } = this.range(this.table());
    const m = Array.from(args.defaultProjectionData.mainMatrix), [x, y] = this.origin;
    for (let row = 0; row < 4; row++) m[12 + row] += m[row] * x + m[4 + row] * y;
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(this.places.u_matrix, false, new Float32Array(m));
    gl.uniform4fv(this.places.u_colours, new Float32Array(this.colours().flat()));
    const size = this.size(this.map.getZoom()) * devicePixelRatio;
    const draw = (from, to, alpha, only, more) => {
      if (to <= from) return;
      gl.uniform1f(this.places.u_alpha, alpha);
      gl.uniform1f(this.places.u_only, only);
      gl.uniform1f(this.places.u_size, size + more * devicePixelRatio);
      gl.drawArrays(gl.POINTS, from, to - from);
    };
    draw(first, begin, .3, -1, 0);
    draw(begin, end, 1, -1, 0);
    if (this.emphasis >= 0) draw(begin, end, 1, this.emphasis, 2);
    gl.bindVertexArray(null);
  }
}

export const mercatorX = longitude => (longitude + 180) / 360;
export const mercatorY = latitude => .5 - Math.asinh(Math.tan(latitude * Math.PI / 180)) / (2 * Math.PI);

// A colour of CSS (#rrggbb) as four numbers.
export function rgba(text, alpha = 1) {
  const value = parseInt(text.slice(1), 16);
  return [(value >> 16 & 255) / 255, (value >> 8 & 255) / 255, (value & 255) / 255, alpha];
}
