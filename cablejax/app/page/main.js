// The page: what is looked at, and what follows from each click.

import { Cloud } from "./cloud.js";
import { Profile, drawSection } from "./plots.js";
import * as panel from "./panel.js";
import * as server from "./server.js";
import * as settings from "./settings.js";
import { sub } from "./matrix.js";

const byId = (id) => document.getElementById(id);
const BUSY_MS = 400, IDLE_MS = 3000;

let scans = [];  // a line each
let scan = null;  // the one that is looked at, whole
let chosen = 0;  // the number of the cable
let place = 0.5;  // of the section, as a share of the length
let sending = null;  // what is being uploaded, in words
let looked = null;  // the scan that the camera was set for

const cloud = new Cloud(byId("canvas"), { selected: (number) => number && select(number), drawn: band, moved: moveTags });
const profile = new Profile(byId("profile"), (s) => goTo(s / cable().length_mm));
byId("flat").hidden = Boolean(cloud.gl);

const cable = () => scan?.cables.find((one) => one.number === chosen);
const local = (box) => box && scan && sub(box, [...scan.cloud.origin, ...scan.cloud.origin]);

// Ask how far the program is, now and again.
async function watch() {
  let wait = IDLE_MS;
  try {
    const state = await server.get("state");
    byId("lost").hidden = true;
    scans = state.scans;
    if (scan && !scans.some((one) => one.number === scan.number)) {  // it was closed
      if (!scans.length) return location.reload();
      await open(scans.at(-1).number);
    }
    if (!scan && scans.length) await open(scans.at(-1).number);
    const short = scans.find((one) => one.number === scan?.number);
    if (short && short.version !== scan.version) await refresh();
    if (scans.some((one) => one.busy)) wait = BUSY_MS;
    list(short);
  } catch (error) {
    if (error instanceof TypeError) byId("lost").hidden = false;  // no answer at all
    else panel.showTrouble(error.message);
  }
  clearTimeout(watch.next);
  watch.next = setTimeout(watch, wait);
}

function list(short) {
  panel.listScans(scans, scan?.number, { open, remove });
  const busy = short?.busy ? `${short.name}: ${short.stage}, ${Math.floor(short.elapsed)} s` : null;
  panel.showBusy(sending ?? busy);
  byId("stop").hidden = Boolean(sending);
}

async function refresh() {
  const before = scan.cloud, fresh = await server.get(`scans/${scan.number}`);
  if (fresh.number !== scan.number) return;
  const changed = JSON.stringify([before, scan.cables?.length]) !== JSON.stringify([fresh.cloud, fresh.cables.length]) || looked !== fresh.number;
  const others = scan.cables.length !== fresh.cables.length;
  scan = fresh;
  if (others || !cable()) chosen = widest();
  if (scan.cloud && (changed || !scan.busy)) await drawPoints();
  show();
}

// The cable that is shown first: the one that the most points rest on.
function widest() {
  const most = scan.cables.reduce((best, one) => (!best || one.points > best.points ? one : best), null);
  return most ? most.number : 0;
}

async function drawPoints() {
  const points = await server.cloud(scan.number, scan.cloud.shown);
  if (!points) return;
  cloud.setPoints(...points);
  if (looked === scan.number) return;
  looked = scan.number;
  wholeScan();
}

function clear() {
  looked = null;
  cloud.setPoints(new Float32Array(), new Float32Array(), new Uint8Array());
  cloud.setBox(null);
  cloud.setCables([], 0);
}

function wholeScan() {
  if (scan?.cloud) cloud.camera.look(sub(scan.cloud.low, scan.cloud.origin), sub(scan.cloud.high, scan.cloud.origin));
}

function show() {
  panel.showTrouble(scan.error && !scan.cables.length ? scan.error : null);
  const missed = (scan.not_measured ?? []).map((one) => `Something round of about ${one.diameter_mm.toPrecision(3)} mm was not measured: ${one.reason}`);
  const dropped = scan.dropped ? [`${scan.dropped.toLocaleString("en")} invalid returns were left out.`] : [];
  panel.showNotes([...scan.warnings, ...dropped, ...(scan.scene_warnings ?? []), ...missed]);
  const drawn = Boolean(scan.cloud && cloud.gl);
  byId("hint").hidden = drawn;
  byId("tools").hidden = !drawn;
  if (scan.cloud) panel.showShown(scan);
  byId("command").hidden = false;
  byId("command").querySelector("code").textContent = scan.command;
  byId("legend").hidden = !scan.cables.length;
  showCable();
  list(scans.find((one) => one.number === scan.number));
}

function showCable() {
  const one = cable();
  panel.listCables(scan, chosen, select);
  panel.showTags(scan, chosen, select);
  panel.showCable(scan, one);
  panel.showReports(scan, one);
  if (!scan.cloud) return;
  const from = (line) => line.map((point) => sub(point, scan.cloud.origin));
  cloud.setCables(scan.cables.map((each) => ({ ...each, axis: from(each.axis_mm), pieces: from(each.pieces_mm) })), chosen);
  cloud.setBox(local(scan.settings.box));
  moveTags();  // they are new, and the next frame may be late
  if (!one) return;
  byId("low").textContent = (-3 * one.noise_mm).toPrecision(2);
  byId("high").textContent = `+${(3 * one.noise_mm).toPrecision(2)}`;
  profile.draw(one);
  goTo(place);
}

function select(number) {
  if (!scan || number === chosen) return;
  chosen = number;
  showCable();
}

// The section at a share of the length; while one is fetched, only the latest wish is kept.
function goTo(share) {
  const one = cable();
  if (!one) return;
  place = share;
  const at = share * one.length_mm;
  byId("along").value = 1000 * share;
  profile.at(at);
  cloud.setPlace(cloud.cables.find((each) => each.number === chosen), at);
  goTo.wanted = { scan: scan.number, one, at };
  if (!goTo.fetching) fetchSection();
}

async function fetchSection() {
  goTo.fetching = true;
  while (goTo.wanted) {
    const { scan: number, one, at } = goTo.wanted;
    goTo.wanted = null;
    try {
      const section = await server.get(`scans/${number}/cables/${one.number}/section?at=${at}`);
      if (scan?.number === number && cable() === one) panel.showSection(section, one, drawSection(byId("section"), one, section));
    } catch { /* measured anew meanwhile: `watch` sees to it */ }
  }
  goTo.fetching = false;
}

async function open(number) {
  scan = await server.get(`scans/${number}`);
  chosen = widest();
  settings.show(scan.settings);
  byId("shown").textContent = "";
  if (scan.cloud) await drawPoints();
  else clear();
  show();
}

async function remove(number) {
  await server.post(`scans/${number}/remove`);
  await watch();
}

// Files one after the other; what goes wrong with one does not keep the next.
async function take(files) {
  let wishes;
  try { wishes = { ...settings.read(), box: null }; } catch (error) { panel.showTrouble(error.message); return; }
  for (const file of files) {
    try {
      sending = `sending ${file.name}`;
      const number = await server.upload(file, wishes, (share) => {
        sending = `sending ${file.name}: ${Math.round(100 * share)} %`;
        panel.showBusy(sending);
      });
      sending = null;
      await open(number);
    } catch (error) { panel.showTrouble(error.message); } finally { sending = null; }
  }
  await watch();
}

async function again() {
  if (!scan) return;
  try {
    await server.post(`scans/${scan.number}/measure`, settings.read());
    panel.showTrouble(null);
    await watch();
  } catch (error) { panel.showTrouble(error.message); }
}

// A rectangle drawn on the scan: the region is the box about the points in it.
function band(a, b, done) {
  const frame = byId("band");
  frame.hidden = done;
  Object.assign(frame.style, { left: `${Math.min(a.x, b.x)}px`, top: `${Math.min(a.y, b.y)}px`, width: `${Math.abs(a.x - b.x)}px`, height: `${Math.abs(a.y - b.y)}px` });
  if (!done || !scan?.cloud) return;
  const found = cloud.boxOf(a, b, local(settings.box()));
  selecting(false);
  if (!found) return;
  const origin = scan.cloud.origin;
  settings.showBox(found.map((x, i) => x + origin[i % 3]));
  cloud.setBox(found);
  byId("options").open = true;
  byId("again").scrollIntoView({ block: "nearest" });
  byId("again").focus({ preventScroll: true });
}

function selecting(on) {
  cloud.camera.selecting = on;
  byId("canvas").classList.toggle("selecting", on);
  byId("select").setAttribute("aria-pressed", on);
}

function moveTags() {
  const tags = [...byId("tags").children];
  cloud.cables.forEach((one, i) => {
    const at = cloud.seen(one.axis[Math.floor(one.axis.length / 8)]);
    if (tags[i]) Object.assign(tags[i].style, at ? { display: "", left: `${at.x}px`, top: `${at.y}px` } : { display: "none" });
  });
}

function listen() {
  byId("file").addEventListener("change", (event) => { take([...event.target.files]); event.target.value = ""; });
  for (const name of ["dragenter", "dragover"]) addEventListener(name, (event) => { event.preventDefault(); byId("view").classList.add("over"); });
  for (const name of ["dragleave", "drop"]) addEventListener(name, () => byId("view").classList.remove("over"));
  addEventListener("drop", (event) => { event.preventDefault(); take([...event.dataTransfer.files]); });
  byId("along").addEventListener("input", (event) => goTo(event.target.value / 1000));
  byId("unit").addEventListener("change", () => scan && again());
  byId("settings").addEventListener("submit", (event) => { event.preventDefault(); again(); });
  byId("box").addEventListener("input", () => scan?.cloud && cloud.setBox(local(settings.box())));
  byId("nobox").addEventListener("click", () => { settings.showBox(null); cloud.setBox(null); });
  byId("stop").addEventListener("click", () => scan && server.post(`scans/${scan.number}/stop`).then(watch));
  byId("report").addEventListener("click", () => server.save(`scans/${scan.number}/report-${chosen}`));
  byId("reportall").addEventListener("click", () => server.save(`scans/${scan.number}/report-all`));
  byId("shell").addEventListener("change", (event) => { cloud.shell = event.target.checked; cloud.draw(); });
  byId("select").addEventListener("click", () => selecting(!cloud.camera.selecting));
  byId("fit").addEventListener("click", wholeScan);
  byId("focus").addEventListener("click", () => {
    const one = cloud.cables.find((each) => each.number === chosen);
    if (!one) return;
    const reach = one.diameter_mm / 2, corner = (pick, shift) => [0, 1, 2].map((k) => pick(...one.axis.map((point) => point[k])) + shift);
    cloud.camera.frame(corner(Math.min, -reach), corner(Math.max, reach));
  });
  addEventListener("keydown", (event) => event.key === "Escape" && selecting(false));
}

settings.offer(await server.get("state"));
listen();
await watch();
