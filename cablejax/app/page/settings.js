// What is known of the scan and where to look, as it stands in the form.

const byId = (id) => document.getElementById(id);
const GROUPS = { tolerance: 2, diameter: 2, box: 6 };
const NAMES = { tolerance: "the limits", diameter: "the diameters looked for", box: "the region" };

function option(select, value, text) {
  select.append(new Option(text, value));
}

export function offer({ units, voltages }) {
  option(byId("unit"), "", "as the file says, else guessed");
  for (const unit of units) option(byId("unit"), unit, unit);
  option(byId("catalogue"), "", "none");
  for (const voltage of voltages) option(byId("catalogue"), voltage, voltage);
}

// All settings; an Error where one cannot be read.
export function read() {
  const found = { unit: byId("unit").value || null, catalogue: byId("catalogue").value || null };
  for (const [name, count] of Object.entries(GROUPS)) {
    const texts = [...Array(count).keys()].map((i) => byId(name + i).value.trim().replace(",", "."));
    const empty = texts.filter((text) => text === "").length;
    if (empty === count) { found[name] = null; continue; }
    found[name] = texts.map(Number);
    if (empty || found[name].some((x) => !Number.isFinite(x))) throw new Error(`${NAMES[name]}: expected ${count} numbers, or none`);
  }
  return found;
}

export function show(settings) {
  byId("unit").value = settings.unit ?? "";
  byId("catalogue").value = settings.catalogue ?? "";
  for (const [name, count] of Object.entries(GROUPS)) {
    for (let i = 0; i < count; i++) byId(name + i).value = settings[name] ? +settings[name][i].toFixed(3) : "";
  }
}

export function showBox(box) {
  for (let i = 0; i < 6; i++) byId(`box${i}`).value = box ? +box[i].toFixed(3) : "";
}

// The box in the form; null where it is not whole.
export function box() {
  const texts = [...Array(6).keys()].map((i) => byId(`box${i}`).value.trim().replace(",", "."));
  const values = texts.map(Number);
  return texts.some((text) => text === "") || values.some((x) => !Number.isFinite(x)) ? null : values;
}
