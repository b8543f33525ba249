// The operator's line as a straight band: stops by chainage, the vehicle on it, heights above.
import { decimals, text } from "./texts.js";
import { node } from "./svg.js";

const HEIGHT = 150;
const FLAT_HEIGHT = 70; // without heights
const AHEAD_M = 1600;
const BEHIND_M = 400;
const NARROW = 700; // on a screen of fewer pixels half the way is shown
const NAME = 26; // longest name of a stop, in letters
const CREEP_MPS = 0.5;

export class LinePanel {
  constructor(section, element) {
    this._section = section;
    this._element = element;
    this._lines = [];
  }

  network(network) {
    this._lines = network.lines;
  }

  forget() {
    this._drawn = "";
  }

  draw(message) {
    const reference = message.match && message.match.references[0];
    const line = reference && this._lines.find((each) => each.line === reference.line && each.direction === reference.direction);
    this._section.hidden = !line;
    if (!line) return;
    const here = reference.chainage_m;
    const speed = message.state ? Math.abs(message.state.speed_mps) : 0;
    const wide = Math.max(this._element.clientWidth, 280);
    const part = wide < NARROW ? 0.5 : 1;
    const begin = here - part * BEHIND_M;
    const shown = part * (AHEAD_M + BEHIND_M);
    const x = (chainage) => ((chainage - begin) / shown) * wide;
    const tall = line.heights_m.length ? HEIGHT : FLAT_HEIGHT;
    const railY = tall - 52;
    const next = line.stops.find(([, chainage]) => chainage > here + 5);
    const title = [`${text("line")} ${line.line} → ${line.destination || line.direction}`];
    if (next) {
      const way = next[1] - here;
      const time = speed > CREEP_MPS ? ` · ${text("in_time", Math.round(way / speed))}` : "";
      title.push(`${text("next_stop")} ${next[0]}: ${decimals(way, 0)} m${time}`);
    }
    const key = `${Math.round(here)}|${title.join()}|${Math.round(speed)}|${wide}`;
    if (key === this._drawn) return;
    this._drawn = key;
    const parts = [node("rect", { x: 0, y: railY - 3, width: wide, height: 6, class: "band" })];
    parts.push(...profile(line, begin, shown, x));
    const ways = message.stopping ? message.stopping.stops.filter((each) => each.distance_m !== null) : [];
    ways.forEach((each) => parts.push(node("line", { x1: x(here), x2: x(here + each.distance_m), y1: railY, y2: railY, class: "braking" })));
    let end = -Infinity; // of the last name that was written: the next one goes below it
    for (const [name, chainage] of line.stops) {
      if (x(chainage) < 0 || x(chainage) > wide) continue;
      parts.push(node("circle", { cx: x(chainage), cy: railY, r: 6, class: "stop" }));
      const written = name.length > NAME ? `${name.slice(0, NAME - 1)}…` : name;
      const half = 3.8 * written.length;
      const below = x(chainage) - half < end;
      end = below ? -Infinity : x(chainage) + half;
      const label = node("text", { x: x(chainage), y: railY + (below ? 42 : 25), "text-anchor": "middle" });
      label.textContent = written;
      parts.push(label);
    }
    const std = message.match.std_m || 0;
    parts.push(node("rect", { x: x(here - 2 * std), y: railY - 9, width: Math.max(2, x(here + 2 * std) - x(here - 2 * std)), height: 18, class: "doubt" }));
    parts.push(node("path", { d: `M${x(here) + 11} ${railY} l-16 -9 v18 z`, class: "vehicle" }));
    const svg = node("svg", { viewBox: `0 0 ${wide} ${tall}`, role: "img", "aria-label": title.join(", ") });
    svg.append(...parts);
    const words = document.createElement("p");
    words.textContent = title.join(" · ");
    this._element.replaceChildren(words, svg);
  }
}

function profile(line, begin, shown, x) {
  if (!line.heights_m.length) return [];
  const step = line.profile_m;
  const first = Math.max(0, Math.floor(begin / step));
  const last = Math.min(line.heights_m.length - 1, Math.ceil((begin + shown) / step));
  const heights = line.heights_m.slice(first, last + 1);
  const low = Math.min(...heights);
  const high = Math.max(...heights, low + 10);
  const y = (height) => 70 - ((height - low) / (high - low)) * 52;
  const points = heights.map((height, k) => `${x((first + k) * step).toFixed(1)},${y(height).toFixed(1)}`);
  const label = (height, at) => {
    const words = node("text", { x: 4, y: at, class: "small" });
    words.textContent = `${decimals(height, 0)} m`;
    return words;
  };
  return [node("polyline", { points: points.join(" "), class: "height" }), label(high, 14), label(low, 78)];
}
