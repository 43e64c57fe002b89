// Vectors and 4 x 4 matrices in column order, as WebGL takes them.

export const sub = (a, b) => a.map((x, i) => x - b[i]);
export const add = (a, b, scale = 1) => a.map((x, i) => x + scale * b[i]);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(...a);
export const unit = (a) => { const n = norm(a) || 1; return a.map((x) => x / n); };

export function multiply(a, b) {
  const out = new Float32Array(16);
  for (let col = 0; col < 4; col++) for (let row = 0; row < 4; row++) {
    let sum = 0;
    for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * col + k];
    out[4 * col + row] = sum;
  }
  return out;
}

export function perspective(tangent, aspect, near, far) {
  const f = 1 / tangent, d = near - far;
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / d, -1, 0, 0, 2 * far * near / d, 0]);
}

// The camera at `eye` whose axes are the rows right, up, back.
export function view(eye, [r, u, b]) {
  return new Float32Array([r[0], u[0], b[0], 0, r[1], u[1], b[1], 0, r[2], u[2], b[2], 0, -dot(r, eye), -dot(u, eye), -dot(b, eye), 1]);
}

// Two unit vectors square to a direction.
export function across(direction) {
  const d = unit(direction), least = d.map(Math.abs).indexOf(Math.min(...d.map(Math.abs)));
  const first = unit(cross(d, [0, 0, 0].map((_, i) => +(i === least))));
  return [first, cross(d, first)];
}
