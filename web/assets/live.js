// The page: one WebSocket in, panels that each draw their part. Nothing is ever sent.
import { LANGUAGES, choose, decimals, text } from "./texts.js";
import { MapPanel } from "./map.js";
import { Strips } from "./strips.js";
import { LinePanel } from "./line.js";
import { drawSky } from "./sky.js";
import { deviceTable, eventList, nodeTable } from "./tables.js";

const QUIET_MS = 2500; // without a frame for so long the picture is old, and says so
const AGAIN_MS = [500, 1000, 2000, 5000];
const place = (id) => document.getElementById(id);

const map = new MapPanel(place("map"), place("map-frame"), place("legend"));
const strips = new Strips(place("charts"));
const line = new LinePanel(place("line"), place("line-drawing"));
let latestStatus = null;
let latestFrame = null;
let frameAt = 0;
let tries = 0;
const latencies = [];

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  const decoder = new TextDecoder();
  socket.onmessage = (event) => take(JSON.parse(decoder.decode(event.data)));
  socket.onclose = () => {
    said("disconnected", "bad");
    setTimeout(connect, AGAIN_MS[Math.min(tries++, AGAIN_MS.length - 1)]);
  };
}

function take(message) {
  if (message.type === "first") {
    tries = 0;
    rails();
    strips.load(message.history);
    map.load(message.history);
    status(message.status);
  } else if (message.type === "frame") {
    frame(message);
  } else {
    status(message);
  }
}

let drawing = false;
function frame(message) {
  latestFrame = message;
  frameAt = performance.now();
  strips.add(message);
  map.add(message);
  if (drawing || document.hidden) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    draw(latestFrame);
    if (latestFrame.state !== null) {
      latencies.push(Date.now() / 1000 - latestFrame.state.t_s);
      if (latencies.length > 600) latencies.shift();
    }
  });
}

function draw(message) {
  said("connected", "good");
  const { state } = message;
  place("speed-value").textContent = state ? decimals(Math.abs(state.speed_mps) * 3.6, 0) : "–";
  const mode = place("mode");
  put(mode, text(state ? `mode_${state.mode}` : "mode_none"));
  mode.dataset.level = state && state.mode === "TRACKING" ? "good" : "warning";
  put(place("clock"), new Date(1000 * (state ? state.t_s : message.now_s)).toLocaleTimeString(document.documentElement.lang));
  facts(message);
  map.draw(message);
  line.draw(message);
  strips.draw();
}

// An element is touched only where something changes: a screen reader hears changes, and nothing else.
function put(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

function said(key, level) {
  const chip = place("connection");
  put(chip, text(key));
  chip.dataset.level = level;
}

function facts(message) {
  const { state, gnss, wheels, match, grade, stopping } = message;
  const rows = [];
  if (state) {
    if (state.heading_deg !== null) rows.push(["heading", `${decimals(state.heading_deg, 1)}° ±${decimals(state.heading_std_deg, 1)}`]);
    rows.push(["along", `±${decimals(state.along_std_m, 2)} m, ${text("within")} ${decimals(state.protection_along_m, 1)} m`]);
    rows.push(["across", `±${decimals(state.across_std_m, 2)} m, ${text("within")} ${decimals(state.protection_across_m, 1)} m`]);
    rows.push(["height", `${decimals(state.height_m, 1)} m`]);
  }
  if (gnss) rows.push(["gnss", `${text(`fix_${gnss.fix}`)}${gnss.carrier === "NONE" ? "" : ` ${gnss.carrier}`} · ${text("satellites_used", gnss.satellites)} · ±${decimals(gnss.std_m, 1)} m`]);
  if (wheels) {
    const parts = [];
    if (wheels.speed_mps !== null) parts.push(`${decimals(wheels.speed_mps * 3.6, 1)} km/h`);
    if (wheels.doors_open) parts.push(text("doors_open"));
    if (parts.length) rows.push(["wheels", parts.join(" · ")]);
  }
  if (match) {
    const sure = `${decimals(100 * match.probability, 1)} %`;
    rows.push(["track", match.state === "OFF_MAP" ? text("of_map") : `${match.edge || "–"} · ${decimals(match.chainage_m, 0)} m · ${sure}`]);
  }
  if (grade) rows.push(["grade", `${decimals(grade.percent, 2)} ±${decimals(grade.std_percent, 2)} %`]);
  if (stopping) {
    const ways = stopping.stops.map((each) => `${decimals(each.distance_m, 0)} m (${decimals(each.deceleration_mps2, 2)} m/s²)`);
    rows.push(["stop_distance", ways.join(" · ")]);
  }
  const list = place("facts");
  if (list.children.length !== 2 * rows.length) {
    list.replaceChildren(...rows.flatMap(() => [document.createElement("dt"), document.createElement("dd")]));
  }
  rows.forEach(([name, words], k) => {
    put(list.children[2 * k], text(name));
    put(list.children[2 * k + 1], words);
  });
}

function status(message) {
  latestStatus = message;
  put(place("vehicle"), message.vehicle);
  document.title = `${message.vehicle} – tramstream`;
  place("machine").hidden = message.devices.length + message.nodes.length === 0; // of a record that has none
  deviceTable(place("devices"), message);
  nodeTable(place("nodes"), message);
  eventList(place("events"), message.events);
  drawSky(place("sky"), place("sky-drawing"), message.satellites);
  const bad = [...message.devices, ...message.nodes].filter((each) => each.level !== "fine");
  const chip = place("trouble");
  chip.hidden = bad.length === 0;
  if (bad.length) put(chip, `${text("problems", bad.length)}: ${bad.map((each) => each.device || each.node).join(", ")}`);
  chip.dataset.level = bad.some((each) => each.level === "bad") ? "bad" : "warning";
}

// Language and colours -------------------------------------------------------------------------
function speak(language) {
  choose(language);
  keep("language", language);
  for (const each of document.querySelectorAll("[data-text]")) each.textContent = text(each.dataset.text);
  for (const each of document.querySelectorAll("[data-label]")) each.setAttribute("aria-label", text(each.dataset.label));
  strips.build();
  map.speak();
  line.forget();
  if (latestStatus) status(latestStatus);
  if (latestFrame) draw(latestFrame);
}

function keep(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {
    return; // a browser that keeps nothing: the choice lasts until the page is closed
  }
}

function kept(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null; // likewise
  }
}

function colour(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
  strips.build();
  map.restyle();
}

function dark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function turnTheme() {
  const theme = dark() ? "light" : "dark";
  keep("theme", theme);
  colour(theme);
}

// Buttons and keys -------------------------------------------------------------------------------
function window_(seconds) {
  strips.show(seconds);
  for (const each of document.querySelectorAll("button.window")) {
    each.setAttribute("aria-pressed", String(Number(each.value) === seconds));
  }
}

map.changed = () => {
  place("follow").setAttribute("aria-pressed", String(map.following));
  place("heading-up").setAttribute("aria-pressed", String(map.headingUp));
};
place("follow").onclick = () => map.follow(!map.following);
place("heading-up").onclick = () => map.turn(!map.headingUp);
place("theme").onclick = turnTheme;
place("language").onchange = (event) => speak(event.target.value);
for (const each of document.querySelectorAll("button.window")) each.onclick = () => window_(Number(each.value));
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || /^(SELECT|INPUT)$/.test(event.target.tagName)) return;
  const does = {
    f: () => map.follow(!map.following),
    h: () => map.turn(!map.headingUp),
    t: turnTheme,
    1: () => window_(60),
    2: () => window_(600),
    3: () => window_(3600),
  }[event.key];
  if (does) does();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => colour(""));
setInterval(() => {
  if (latestFrame && performance.now() - frameAt > QUIET_MS) said("disconnected", "bad");
}, 500);

// What a test, or a curious person, may look at.
window.tramstream = { latencies, frames: () => latestFrame, map, strips };

const language = kept("language") || navigator.language.slice(0, 2);
place("language").value = LANGUAGES.includes(language) ? language : "en";
colour(kept("theme") || "");
speak(place("language").value);
window_(60);

// The network is asked for once, as soon as there is a server.
let asked = false;
function rails() {
  if (asked) return;
  asked = true;
  fetch("network.json").then((answer) => answer.json()).then((network) => {
    place("no-network").hidden = network !== null;
    if (network === null) return;
    map.network(network);
    line.network(network);
  }).catch(() => { asked = false; }); // the server has gone: asked again when it is back
}
connect();
