// A camera that turns about a target: mouse, touch and keys.

import { add, cross, dot, multiply, norm, perspective, unit, view } from "./matrix.js";

const TANGENT = Math.tan((40 * Math.PI) / 360);

export class Camera {
  constructor(canvas, { changed, clicked, drawn }) {
    this.canvas = canvas;
    this.target = [0, 0, 0];
    this.distance = 100;
    this.size = 100;
    this.axes = [[1, 0, 0], [0, 0, 1], [0, -1, 0]];
    this.selecting = false;
    this.changed = changed;
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event, drawn));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.up(event, clicked, drawn));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(0.0012 * event.deltaY)); }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  get aspect() { return this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight); }
  get eye() { return add(this.target, this.axes[2], this.distance); }

  matrix() {
    const near = Math.max(this.distance / 1000, this.distance - 3 * this.size), far = this.distance + 3 * this.size;
    return multiply(perspective(TANGENT, this.aspect, near, far), view(this.eye, this.axes));
  }

  // Pixels that a length at the target covers.
  scale() { return this.canvas.clientHeight / (2 * TANGENT * this.distance); }

  // Look at a box from aslant, its longest side from left to right.
  look(low, high) {
    const side = low.map((x, i) => Math.max(high[i] - x, 1e-6));
    const order = [0, 1, 2].sort((a, b) => side[a] - side[b]);
    const axis = (i) => [0, 0, 0].map((_, k) => +(k === i));
    const up = axis(order[0]), right = axis(order[2]);
    let back = unit(add(cross(right, up), up, 0.6));
    this.axes = [right, cross(back, right), back];
    this.frame(low, high);
  }

  frame(low, high) {
    this.target = low.map((x, i) => (x + high[i]) / 2);
    const half = low.map((x, i) => (high[i] - x) / 2);
    const [w, h] = this.axes.map((axis) => half.reduce((sum, x, i) => sum + Math.abs(x * axis[i]), 0));
    this.distance = 1.15 * Math.max(h, w / this.aspect) / TANGENT + norm(half) * 0.3;
    this.size = Math.max(this.size, norm(half));
    this.changed();
  }

  turn(dx, dy) {
    const [r, u, b] = this.axes;
    const turned = (axis, angle) => (v) => {
      const c = Math.cos(angle), s = Math.sin(angle), k = cross(axis, v), d = dot(axis, v) * (1 - c);
      return v.map((x, i) => x * c + k[i] * s + axis[i] * d);
    };
    const axes = [r, u, b].map(turned(u, -dx)).map(turned(r, -dy));
    const back = unit(axes[2]), right = unit(cross(axes[1], back));
    this.axes = [right, cross(back, right), back];
    this.changed();
  }

  pan(dx, dy) {
    const step = 1 / this.scale();
    this.target = add(add(this.target, this.axes[0], -dx * step), this.axes[1], dy * step);
    this.changed();
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, this.size / 2000), this.size * 20);
    this.changed();
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    if (this.pointers.size === 1) this.start = { x: event.offsetX, y: event.offsetY, moved: false };
  }

  move(event, drawn) {
    const last = this.pointers.get(event.pointerId);
    if (!last) return;
    const here = { x: event.offsetX, y: event.offsetY }, dx = here.x - last.x, dy = here.y - last.y;
    if (Math.hypot(here.x - this.start.x, here.y - this.start.y) > 4) this.start.moved = true;
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
      const gap = (point) => Math.hypot(point.x - other.x, point.y - other.y);
      this.zoom(gap(last) / Math.max(gap(here), 1));
      this.pan(dx / 2, dy / 2);
    } else if (this.selecting) drawn(this.start, here, false);
    else if (event.buttons & 6 || event.shiftKey) this.pan(dx, dy);
    else this.turn(0.006 * dx, 0.006 * dy);
    this.pointers.set(event.pointerId, here);
  }

  up(event, clicked, drawn) {
    const here = { x: event.offsetX, y: event.offsetY };
    if (!this.pointers.delete(event.pointerId) || event.type !== "pointerup" || this.pointers.size) return;
    if (this.selecting && this.start.moved) drawn(this.start, here, true);
    else if (!this.start.moved) clicked(here);
  }

  key(event) {
    const moves = {
      ArrowLeft: () => this.turn(-0.1, 0), ArrowRight: () => this.turn(0.1, 0), ArrowUp: () => this.turn(0, -0.1),
      ArrowDown: () => this.turn(0, 0.1), "+": () => this.zoom(0.85), "-": () => this.zoom(1 / 0.85),
    };
    if (event.key in moves) { event.preventDefault(); moves[event.key](); }
  }
}
