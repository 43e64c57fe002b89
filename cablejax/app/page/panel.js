// The words and numbers beside the scan. Texts from files are set as text, never as HTML.

const byId = (id) => document.getElementById(id);

function make(name, className, text, ...children) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  made.append(...children);
  return made;
}

function button(className, text, pressed, click) {
  const made = make("button", className, text);
  if (pressed !== null) made.setAttribute("aria-pressed", pressed);
  made.addEventListener("click", click);
  return made;
}

const mm = (x) => `${x.toFixed(x < 100 ? 3 : 2)} mm`;
export const interval = ([low, high], digits = 3) => `${low.toFixed(digits)} to ${high.toFixed(digits)}`;

function summary(scan) {
  if (scan.cables.length) return scan.cables.map((one) => `${one.diameter_mm.toFixed(2)}`).join(", ") + " mm";
  return scan.error ? "no result" : scan.stage;
}

// The list of scans; the one that is looked at is marked.
export function listScans(scans, current, { open, remove }) {
  byId("scans").replaceChildren(...scans.map((scan) => {
    const line = make("li", scan.number === current ? "chosen" : "");
    const shown = button("open", undefined, null, () => open(scan.number));
    if (scan.number === current) shown.setAttribute("aria-current", "true");
    shown.append(make("span", "name", scan.name), make("span", scan.error && !scan.cables.length ? "what bad" : "what", summary(scan)));
    const away = button("away", "×", null, () => remove(scan.number));
    away.setAttribute("aria-label", `Close ${scan.name}`);
    line.append(shown, away);
    return line;
  }));
}

export function showBusy(text) {
  byId("busy").hidden = !text;
  byId("busy").querySelector("span").textContent = text ?? "";
}

export function showTrouble(text) {
  byId("trouble").hidden = !text;
  byId("trouble").textContent = text ?? "";
}

export function showNotes(texts) {
  byId("notes").replaceChildren(...texts.map((text) => make("p", "note", text)));
}

export function listCables(scan, chosen, select) {
  const buttons = scan.cables.map((one) => button("", `${one.number}: ${mm(one.diameter_mm)}`, one.number === chosen, () => select(one.number)));
  byId("cables").replaceChildren(...buttons);
  byId("cables").hidden = scan.cables.length < 2;
}

function rows(table, head, lines) {
  const top = make("tr", "", undefined, ...head.map((text) => make("th", "", text)));
  table.replaceChildren(top, ...lines.map((line) => make("tr", "", undefined, ...line.map((text) => make("td", "", text)))));
}

function verdicts(cable, tolerance) {
  const said = byId("verdicts");
  said.replaceChildren();
  const { readings, conformity, verdict } = cable;
  const read = readings.readings_mm.map((x) => x.toFixed(1)).join(" and ");
  said.append(`reading after IEC 60811-203: ${read} mm`, make("br"));
  if (conformity) said.append(`limits ${tolerance[0]} to ${tolerance[1]} mm: `, make("b", conformity, conformity), make("br"));
  if (verdict) said.append("nominal size: ", make("b", "", verdict));
}

// A cable's numbers.
export function showCable(scan, cable) {
  byId("found").hidden = !cable;
  if (!cable) return;
  byId("diameter").textContent = mm(cable.diameter_mm);
  byId("interval").textContent = `diameter; 95 % interval ${interval(cable.interval_mm)} mm`;
  verdicts(cable, scan.tolerance_mm);
  byId("warnings").replaceChildren(...cable.warnings.map((text) => make("p", "note", text)));
  rows(byId("numbers"), ["mm where nothing else is said", "value", "95 % interval"], cable.quantities);
  const lines = cable.budget.map((line) => [line.source, line.std_mm.toFixed(4), line.kind]);
  rows(byId("budget"), ["source", "standard uncertainty (mm)", "type"], [...lines, ["together", cable.std_mm.toFixed(4), ""]]);
}

export function showReports(scan, cable) {
  const ready = scan.reports ?? [];
  byId("report").disabled = !cable || !ready.includes(String(cable.number));
  byId("report").textContent = ready.length || !scan.busy ? "Download the report" : "The report is being written";
  byId("reportall").hidden = scan.cables.length < 2;
  byId("reportall").disabled = !ready.includes("all");
}

export function showShown(scan) {
  const { shown, of } = scan.cloud;
  const all = shown === of ? `${of.toLocaleString("en")} points` : `${shown.toLocaleString("en")} of ${of.toLocaleString("en")} points drawn; all are measured`;
  byId("shown").textContent = `${all}. Read in ${scan.unit}.`;
}

export function showSection(section, cable, magnify) {
  byId("place").textContent = `at ${section.at_mm.toFixed(1)} mm of ${cable.length_mm.toFixed(1)} mm: ${fitted(cable, section.at_mm)}`;
  const points = `${section.points.toLocaleString("en")} points within ${section.half_mm.toFixed(1)} mm`;
  const large = magnify > 1 ? `, deviations drawn ${magnify} times as large as they are` : "";
  byId("sectiontext").textContent = `${points}${large}. Solid: the fitted circle${cable.free_section ? "; dashed: the free-form section of the whole length" : ""}.`;
}

// What the nearest fitted section says.
function fitted(cable, at) {
  const { s_mm, diameter_mm, std_mm } = cable.sections;
  let best = -1;
  s_mm.forEach((s, i) => {
    if (diameter_mm[i] !== null && std_mm[i] !== null && (best < 0 || Math.abs(s - at) < Math.abs(s_mm[best] - at))) best = i;
  });
  if (best < 0) return "no section could be fitted";
  const half = 1.96 * std_mm[best], d = diameter_mm[best];
  return `section of ${d.toFixed(2)} mm (${interval([d - half, d + half], 2)})`;
}

export function showTags(scan, chosen, select) {
  const tags = byId("tags");
  tags.replaceChildren(...scan.cables.map((one) => {
    const made = button("", String(one.number), one.number === chosen, () => select(one.number));
    made.setAttribute("aria-label", `Cable ${one.number}`);
    return made;
  }));
  tags.hidden = scan.cables.length < 2;
}
