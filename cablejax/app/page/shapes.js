// Triangles of what is drawn beside the points: tubes along a line, rings about it, boxes.

import { across, add, cross, dot, sub, unit } from "./matrix.js";

const SIDES = 36;

function directions(line) {
  return line.map((_, i) => unit(sub(line[Math.min(i + 1, line.length - 1)], line[Math.max(i - 1, 0)])));
}

// A tube's strips of triangles: position and normal, interleaved.
export function tube(line, radius) {
  const along = directions(line), rings = [];
  let [u] = across(along[0]);
  for (let i = 0; i < line.length; i++) {
    u = unit(add(u, along[i], -dot(u, along[i])));  // carried along without twist
    const v = cross(along[i], u), ring = [];
    for (let side = 0; side <= SIDES; side++) {
      const angle = (2 * Math.PI * side) / SIDES;
      const normal = add(u.map((x) => x * Math.cos(angle)), v, Math.sin(angle));
      ring.push([...add(line[i], normal, radius), ...normal]);
    }
    rings.push(ring);
  }
  const out = [];
  for (let i = 0; i + 1 < rings.length; i++) for (let side = 0; side < SIDES; side++) {
    const [a, b, c, d] = [rings[i][side], rings[i][side + 1], rings[i + 1][side], rings[i + 1][side + 1]];
    out.push(...a, ...b, ...c, ...b, ...d, ...c);
  }
  return new Float32Array(out);
}

// Where a place along a line is, and the direction there.
export function placeOn(line, along, at) {
  let i = 0;
  while (i < along.length - 2 && along[i + 1] < at) i++;
  const step = sub(line[i + 1], line[i]), share = (at - along[i]) / Math.max(along[i + 1] - along[i], 1e-9);
  return { point: add(line[i], step, Math.min(Math.max(share, 0), 1)), direction: unit(step) };
}

// A flat ring about a place on a line, as a strip in the form of `tube`.
export function ring({ point, direction }, inner, outer) {
  const [u, v] = across(direction), out = [];
  const at = (angle, radius) => [...add(add(point, u, radius * Math.cos(angle)), v, radius * Math.sin(angle)), ...direction];
  for (let side = 0; side < 2 * SIDES; side++) {
    const [a, b] = [side, side + 1].map((k) => (Math.PI * k) / SIDES);
    out.push(...at(a, inner), ...at(a, outer), ...at(b, inner), ...at(a, outer), ...at(b, outer), ...at(b, inner));
  }
  return new Float32Array(out);
}

// The twelve edges of a box, as lines in the form of `tube`.
export function edges(low, high) {
  const corner = (k) => low.map((x, i) => ((k >> i) & 1 ? high[i] : x)), out = [];
  for (let k = 0; k < 8; k++) for (let i = 0; i < 3; i++) if (!((k >> i) & 1)) {
    out.push(...corner(k), 0, 0, 1, ...corner(k | (1 << i)), 0, 0, 1);
  }
  return new Float32Array(out);
}
