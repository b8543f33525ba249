// Devices, nodes and events. All words that come from the vehicle are put in as text, never as markup.
import { decimals, text } from "./texts.js";

const EVENTS = 200;

export function deviceTable(element, status) {
  table(element, [text("device"), text("state"), text("bytes"), text("decoded"), text("rejected"), text("lost"), ""],
    status.devices.map((each) => [each.level, [
      `${each.device}`, each.state, each.bytes_per_s === null ? "–" : decimals(each.bytes_per_s, 0),
      each.messages_decoded, each.frames_rejected, each.samples_lost,
      each.text || (each.device === "imu" && status.imu_degc !== null ? `${decimals(status.imu_degc, 1)} °C` : ""),
    ]]));
}

export function nodeTable(element, status) {
  table(element, [text("node"), text("state"), text("cpu"), text("memory"), text("lost"), ""],
    status.nodes.map((each) => [each.level, [
      each.node, each.state, each.cpu_percent === null ? "–" : `${decimals(each.cpu_percent, 1)} %`,
      `${decimals(each.rss_bytes / 1e6, 0)} MB`, each.messages_lost, each.text,
    ]]));
}

function table(element, head, rows) {
  const made = document.createElement("table");
  const top = made.createTHead().insertRow();
  for (const words of head) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.textContent = words;
    top.append(cell);
  }
  const body = made.createTBody();
  for (const [level, cells] of rows) {
    const row = body.insertRow();
    row.dataset.level = level;
    for (const words of cells) row.insertCell().textContent = String(words);
  }
  element.replaceChildren(made);
}

const seen = new Set();
export function eventList(list, events) {
  for (const each of events) {
    if (seen.has(each.number)) continue;
    seen.add(each.number);
    const item = document.createElement("li");
    item.dataset.level = each.level;
    const time = document.createElement("time");
    time.textContent = new Date(1000 * each.t_s).toLocaleTimeString();
    const words = document.createElement("span");
    words.textContent = `${each.source}: ${each.text}`;
    item.append(time, " ", words);
    list.prepend(item);
  }
  while (list.children.length > EVENTS) list.lastElementChild.remove();
  if (seen.size > 4 * EVENTS) {
    const least = Math.max(...seen) - EVENTS;
    for (const number of seen) if (number < least) seen.delete(number);
  }
  list.dataset.empty = list.children.length ? "" : text("no_events");
}
