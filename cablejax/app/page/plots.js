// The two plots beside the scan, in SVG: diameters along the cable, and the section at a place.

const NS = "http://www.w3.org/2000/svg";
const COVERAGE = 1.96;  // standard deviations of a 95 % interval
const WIDEST = 0.05;  // of the diameter, in standard deviations, above which a section says too little
const INK = "#5d6875", BLUE = "#0072b2", ORANGE = "#e69f00", FAINT = "#d5dbe1";
export const RAMP = [[33, 102, 172], [103, 169, 207], [190, 190, 190], [239, 138, 98], [178, 24, 43]];

function put(svg, name, attributes, text) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return svg.appendChild(made);
}

// Round numbers across a range, about so many.
export function ticks(low, high, about) {
  const rough = (high - low) / about, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return out.map((x) => [x, x.toFixed(digits)]);
}

export class Profile {
  constructor(svg, picked) {
    this.svg = svg;
    const pick = (event) => {
      if (!this.x || !(event.buttons & 1)) return;
      const box = svg.getBoundingClientRect();
      picked(this.x.back(((event.clientX - box.left) / box.width) * 380));
    };
    svg.addEventListener("pointerdown", pick);
    svg.addEventListener("pointermove", pick);
  }

  draw(cable) {
    const svg = this.svg, { s_mm, diameter_mm, std_mm } = cable.sections;
    svg.replaceChildren();
    const seen = s_mm.map((s, i) => [s, diameter_mm[i], std_mm[i]]).filter(([, d, std]) => d !== null && std !== null && std < WIDEST * cable.diameter_mm);
    const [lo, hi] = cable.interval_mm;
    const values = [lo, hi, ...seen.map(([, d]) => d)].sort((a, b) => a - b);
    const spare = 0.15 * (values.at(-1) - values[0]) + 1e-6;
    const [low, high] = [values[0] - spare, values.at(-1) + spare];
    const x = (s) => 48 + (s / cable.length_mm) * 322, y = (d) => 118 - ((d - low) / (high - low)) * 108;
    this.x = { back: (px) => Math.min(Math.max((px - 48) / 322, 0), 1) * cable.length_mm };
    for (const [d, text] of ticks(low, high, 4)) {
      put(svg, "line", { x1: 48, x2: 370, y1: y(d), y2: y(d), stroke: FAINT });
      put(svg, "text", { x: 44, y: y(d) + 4, "text-anchor": "end" }, text);
    }
    for (const [s, text] of ticks(0, cable.length_mm, 6)) put(svg, "text", { x: x(s), y: 132, "text-anchor": "middle" }, text);
    put(svg, "text", { x: 209, y: 147, "text-anchor": "middle" }, "along the axis (mm)");
    put(svg, "text", { x: 11, y: 64, "text-anchor": "middle", transform: "rotate(-90 11 64)" }, "diameter (mm)");
    put(svg, "rect", { x: 48, width: 322, y: y(hi), height: Math.max(1, y(lo) - y(hi)), fill: ORANGE, opacity: 0.3 });
    const clip = (d) => Math.min(Math.max(d, low), high);
    const bars = seen.map(([s, d, std]) => `M${x(s).toFixed(1)} ${y(clip(d - COVERAGE * std)).toFixed(1)}V${y(clip(d + COVERAGE * std)).toFixed(1)}`);
    put(svg, "path", { d: bars.join(""), stroke: BLUE, "stroke-width": 0.8, opacity: 0.55, fill: "none" });
    for (const [s, d] of seen) put(svg, "circle", { cx: x(s), cy: y(d), r: 1.8, fill: BLUE });
    put(svg, "line", { x1: 48, x2: 370, y1: y(cable.diameter_mm), y2: y(cable.diameter_mm), stroke: "#1b232d" });
    this.mark = put(svg, "line", { y1: 6, y2: 118, stroke: "#b35900", "stroke-width": 1.6 });
    this.place = x;
  }

  at(s) {
    for (const end of ["x1", "x2"]) this.mark.setAttribute(end, this.place(s));
  }
}

// 1, 2, 5, 10, ...: the largest by which deviations can be drawn within a third of the radius.
export function magnification(cable) {
  const most = cable.diameter_mm / 6 / Math.max(4 * cable.noise_mm, 1e-9);
  const steps = [0, 1, 2, 3].flatMap((power) => [1, 2, 5].map((digit) => digit * 10 ** power));
  return Math.max(1, ...steps.filter((step) => step <= most));
}

export function drawSection(svg, cable, section) {
  svg.replaceChildren();
  const radius = cable.diameter_mm / 2, magnify = magnification(cable), limit = 3 * cable.noise_mm;
  const half = 1.42 * radius, scale = 132 / half, cx = 202, cy = 138;
  const x = (mm) => cx + scale * mm, y = (mm) => cy - scale * mm;
  const frame = { x1: cx - 132, x2: cx + 132 };
  for (const [mm, text] of ticks(-half, half, 5)) {
    put(svg, "line", { ...frame, y1: y(mm), y2: y(mm), stroke: FAINT, "stroke-width": 0.6 });
    put(svg, "line", { x1: x(mm), x2: x(mm), y1: cy - 132, y2: cy + 132, stroke: FAINT, "stroke-width": 0.6 });
    put(svg, "text", { x: cx - 138, y: y(mm) + 4, "text-anchor": "end" }, text);
    put(svg, "text", { x: x(mm), y: 284, "text-anchor": "middle" }, text);
  }
  put(svg, "text", { x: cx, y: 298, "text-anchor": "middle" }, "across the axis (mm)");
  const parts = RAMP.map(() => []);
  section.angle_deg.forEach((angle, i) => {
    const off = section.deviation_mm[i], r = Math.min(radius + magnify * off, half), turn = (angle * Math.PI) / 180;
    const color = Math.min(4, Math.max(0, Math.round(2 + (2 * off) / limit)));
    parts[color].push(`M${x(r * Math.cos(turn)).toFixed(1)} ${y(r * Math.sin(turn)).toFixed(1)}h0`);
  });
  parts.forEach((dots, k) => put(svg, "path", { d: dots.join(""), stroke: `rgb(${RAMP[k]})`, "stroke-width": 2.4, "stroke-linecap": "round", fill: "none" }));
  put(svg, "circle", { cx, cy, r: scale * radius, fill: "none", stroke: "#1b232d", "stroke-width": 1.2 });
  const free = cable.free_section;
  if (free) {
    const corners = free.angle_deg.map((angle, i) => {
      const r = radius + magnify * (free.radius_mm[i] - radius), turn = (angle * Math.PI) / 180;
      return `${x(r * Math.cos(turn)).toFixed(1)} ${y(r * Math.sin(turn)).toFixed(1)}`;
    });
    put(svg, "path", { d: `M${corners.join("L")}Z`, fill: "none", stroke: INK, "stroke-width": 1, "stroke-dasharray": "5 3" });
  }
  return magnify;
}
