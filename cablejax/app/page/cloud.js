// The scan in three dimensions, drawn with WebGL: as many points as stay fluid while it moves, all of them at rest.

import { Camera } from "./camera.js";
import { edges, placeOn, ring, tube } from "./shapes.js";

const POINTS = [`#version 300 es
  in vec3 at; in float deviation; in float label;
  uniform mat4 camera; uniform float size, limit, chosen;
  out vec3 color;
  const vec3 ramp[5] = vec3[5](vec3(.129,.400,.675), vec3(.404,.663,.812), vec3(.969), vec3(.937,.541,.384), vec3(.698,.094,.169));
  void main() {
    gl_Position = camera * vec4(at, 1.0);
    float place = 2.0 + 2.0 * clamp(deviation / limit, -1.0, 1.0);
    int low = min(int(place), 3);
    color = mix(ramp[low], ramp[low + 1], place - float(low));
    bool mine = label == chosen;
    vec3 grey = vec3(.36, .42, .49);
    if (label == 0.0) color = grey; else if (!mine) color = mix(vec3(.62, .68, .74), color, .35);
    gl_PointSize = mine ? 1.4 * size : size;
  }`, `#version 300 es
  precision mediump float;
  in vec3 color; out vec4 pixel;
  void main() { pixel = vec4(color, 1.0); }`];
const SHAPES = [`#version 300 es
  in vec3 at, normal;
  uniform mat4 camera; uniform vec3 eye;
  out float edge;
  void main() { gl_Position = camera * vec4(at, 1.0); edge = 1.0 - abs(dot(normalize(normal), normalize(eye - at))); }`, `#version 300 es
  precision mediump float;
  in float edge; uniform vec4 color; uniform float glass; out vec4 pixel;
  void main() { pixel = vec4(color.rgb, color.a * mix(1.0, .15 + .85 * edge * edge, glass)); }`];
const ORANGE = [0.902, 0.624, 0], CLEAR = [0.62, 0.78, 0.92];
const SLOW_MS = 45, FAST_MS = 24, LEAST = 20000, REST_MS = 180;

function program(gl, [vertex, fragment]) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const out = { made };
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(made, i);
    out[name] = gl.getUniformLocation(made, name);
  }
  return out;
}

export class Cloud {
  constructor(canvas, { selected, drawn, moved }) {
    this.canvas = canvas;
    this.moved = moved;
    this.count = this.fluid = 0;
    this.cables = [];
    this.chosen = 0;
    this.shell = true;
    this.gl = canvas.getContext("webgl2", { antialias: true });
    this.camera = new Camera(canvas, { changed: () => this.draw(true), clicked: (place) => selected(this.cableAt(place)), drawn });
    if (!this.gl) return;
    this.points = program(this.gl, POINTS);
    this.shapes = program(this.gl, SHAPES);
    this.buffers = {};
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Coordinates about the origin, deviations and labels of the points, in an order of which every beginning is a sample.
  setPoints(xyz, deviation, label) {
    this.xyz = xyz;
    this.label = label;
    this.count = label.length;
    this.fluid = this.fluid ? Math.min(this.fluid, this.count) : this.count;
    if (!this.gl) return;
    const gl = this.gl;
    gl.deleteVertexArray(this.cloudArray ?? null);
    this.cloudArray = gl.createVertexArray();
    gl.bindVertexArray(this.cloudArray);
    const known = deviation.map((x) => (x === x ? x : 0));
    this.fill("xyz", xyz, this.points, [["at", 3, gl.FLOAT, 0, 0]]);
    this.fill("deviation", known, this.points, [["deviation", 1, gl.FLOAT, 0, 0]]);
    this.fill("label", label, this.points, [["label", 1, gl.UNSIGNED_BYTE, 0, 0]]);
    this.draw();
  }

  fill(name, data, program, attributes) {
    const gl = this.gl;
    this.buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    for (const [attribute, size, kind, stride, offset] of attributes) {
      const place = gl.getAttribLocation(program.made, attribute);
      if (place < 0) continue;
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, kind, false, stride, offset);
    }
  }

  // A shape of positions and normals; none where the data is.
  setShape(name, data) {
    this.shapeArrays ??= {};
    if (!this.gl) return;
    if (!data) { delete this.shapeArrays[name]; return; }
    const gl = this.gl, array = (this.shapeArrays[name] ??= { array: gl.createVertexArray() });
    gl.bindVertexArray(array.array);
    this.fill(name, data, this.shapes, [["at", 3, gl.FLOAT, 24, 0], ["normal", 3, gl.FLOAT, 24, 12]]);
    array.count = data.length / 6;
  }

  // The cables, their lines about the origin, and which of them is chosen.
  setCables(cables, chosen) {
    this.cables = cables;
    this.chosen = chosen;
    const one = cables.find((cable) => cable.number === chosen);
    this.limit = one ? 3 * one.noise_mm : 1;
    this.setShape("shell", one && tube(one.pieces, one.diameter_mm / 2));
    this.setShape("axis", one && tube(one.axis, 0.02 * one.diameter_mm));
    if (!one) this.setShape("ring", null);
    this.draw();
  }

  // The ring of the section at a place along the chosen cable.
  setPlace(cable, at) {
    this.setShape("ring", ring(placeOn(cable.axis, cable.along_mm, at), 0.51 * cable.diameter_mm, 0.6 * cable.diameter_mm));
    this.draw();
  }

  setBox(box) {
    this.setShape("box", box && edges(box.slice(0, 3), box.slice(3)));
    this.draw();
  }

  // Draw soon; with fewer points where that is needed for the scan to move with the hand.
  draw(moving = false) {
    this.moving = moving || (this.moving && this.asked);
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      if (this.moving && this.last) this.adapt(now - this.last);
      this.last = this.moving ? now : null;
      this.render(this.moving ? Math.min(this.fluid, this.count) : this.count);
      this.moved();
      clearTimeout(this.rest);
      if (this.moving) this.rest = setTimeout(() => this.settle(), REST_MS);
      this.moving = false;
    });
  }

  // The hand rests: the next frame tells nothing of how long one takes, and all points can be drawn.
  settle() {
    if (this.asked) return;
    this.last = null;
    if (this.fluid < this.count) this.draw();
  }

  // Fewer points where a frame of a movement took too long, more where there is time to spare.
  adapt(took) {
    const factor = took > SLOW_MS ? Math.max(0.3, SLOW_MS / took) : took < FAST_MS ? 1.1 : 1;
    this.fluid = Math.min(this.count, Math.max(LEAST, Math.round(factor * this.fluid)));
  }

  render(count) {
    const gl = this.gl, canvas = this.canvas;
    if (!gl) return;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(1, Math.round(ratio * x)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.086, 0.125, 0.173, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const matrix = this.camera.matrix();
    if (this.count) {
      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(this.points.made);
      gl.uniformMatrix4fv(this.points.camera, false, matrix);
      gl.uniform1f(this.points.size, 1.7 * ratio);
      gl.uniform1f(this.points.limit, this.limit ?? 1);
      gl.uniform1f(this.points.chosen, this.chosen || 255);
      gl.bindVertexArray(this.cloudArray);
      gl.drawArrays(gl.POINTS, 0, count);
    }
    gl.useProgram(this.shapes.made);
    gl.uniformMatrix4fv(this.shapes.camera, false, matrix);
    gl.uniform3fv(this.shapes.eye, this.camera.eye);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.shape("ring", ORANGE, { alpha: 0.9 });
    this.shape("box", ORANGE, { mode: gl.LINES });
    if (this.shell) this.shape("shell", CLEAR, { alpha: 0.55, glass: 1, write: false });
    gl.disable(gl.DEPTH_TEST);
    this.shape("axis", ORANGE, { alpha: 0.85 });
    gl.disable(gl.BLEND);
  }

  shape(name, color, { alpha = 1, glass = 0, write = true, mode = this.gl.TRIANGLES }) {
    const gl = this.gl, array = this.shapeArrays?.[name];
    if (!array) return;
    gl.depthMask(write);
    gl.uniform4f(this.shapes.color, ...color, alpha);
    gl.uniform1f(this.shapes.glass, glass);
    gl.bindVertexArray(array.array);
    gl.drawArrays(mode, 0, array.count);
    gl.depthMask(true);
  }

  // Where a place about the origin is seen, in pixels, and how far off; null behind the camera.
  seen([x, y, z], m = this.camera.matrix()) {
    const w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0) return null;
    const right = (m[0] * x + m[4] * y + m[8] * z + m[12]) / w, up = (m[1] * x + m[5] * y + m[9] * z + m[13]) / w;
    return { x: ((1 + right) / 2) * this.canvas.clientWidth, y: ((1 - up) / 2) * this.canvas.clientHeight, far: w };
  }

  // The number of the cable whose nearest point is seen there; 0 for none.
  cableAt(place) {
    const m = this.camera.matrix();
    let found = 0, nearest = Infinity;
    for (let i = 0; i < this.count; i++) {
      const at = this.seen([this.xyz[3 * i], this.xyz[3 * i + 1], this.xyz[3 * i + 2]], m);
      if (at && at.far < nearest && Math.hypot(at.x - place.x, at.y - place.y) < 5) [found, nearest] = [this.label[i], at.far];
    }
    return found;
  }

  // The box about the points that are seen in a rectangle, within another box if there is one; null where there is none.
  boxOf(a, b, within) {
    const m = this.camera.matrix(), low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const [left, right] = [a.x, b.x].sort((x, y) => x - y), [top, bottom] = [a.y, b.y].sort((x, y) => x - y);
    for (let i = 0; i < this.count; i++) {
      const point = this.xyz.subarray(3 * i, 3 * i + 3);
      if (within && ![0, 1, 2].every((k) => point[k] >= within[k] && point[k] <= within[k + 3])) continue;
      const at = this.seen(point, m);
      if (!at || at.x < left || at.x > right || at.y < top || at.y > bottom) continue;
      for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], point[k]); high[k] = Math.max(high[k], point[k]); }
    }
    return low.every((x, k) => x < high[k]) ? [...low, ...high] : null;
  }
}
