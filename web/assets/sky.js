// Satellites: where they stand in the sky, and how strong they come in.
import { text } from "./texts.js";
import { node } from "./svg.js";

const STRONG_DBHZ = 50;

export function drawSky(section, element, satellites) {
  section.hidden = !satellites || satellites.length === 0;
  if (section.hidden) return;
  const used = satellites.filter((each) => each.used).length;
  const words = document.createElement("p");
  words.textContent = text("used", used, satellites.length);
  element.replaceChildren(words, plot(satellites), bars(satellites));
}

function plot(satellites) {
  const svg = node("svg", { viewBox: "-110 -110 220 220", role: "img", "aria-label": text("satellites"), class: "sky" });
  for (const radius of [100, 67, 33]) svg.append(node("circle", { r: radius, class: "ring" }));
  const north = node("text", { x: 0, y: -101, "text-anchor": "middle", class: "small" });
  north.textContent = "N";
  svg.append(north);
  for (const each of satellites) {
    if (each.elevation_deg === null || each.azimuth_deg === null) continue;
    const away = (100 * (90 - each.elevation_deg)) / 90;
    const azimuth = (each.azimuth_deg * Math.PI) / 180;
    const x = away * Math.sin(azimuth);
    const y = -away * Math.cos(azimuth);
    svg.append(node("circle", { cx: x, cy: y, r: 4 + each.cno_dbhz / 12, class: each.used ? "used" : "unused" }));
    const name = node("text", { x, y: y + 3, "text-anchor": "middle", class: "satellite" });
    name.textContent = each.name;
    svg.append(name);
  }
  return svg;
}

function bars(satellites) {
  const width = 14;
  const svg = node("svg", { viewBox: `0 0 ${Math.max(1, satellites.length) * width} 90`, role: "img", "aria-label": "C/N0, dBHz", class: "bars" });
  [...satellites].sort((a, b) => b.cno_dbhz - a.cno_dbhz).forEach((each, k) => {
    const height = (60 * each.cno_dbhz) / STRONG_DBHZ;
    svg.append(node("rect", { x: k * width + 2, y: 72 - height, width: width - 4, height, class: each.used ? "used" : "unused" }));
    const name = node("text", { x: k * width + width / 2, y: 82, "text-anchor": "middle", class: "satellite" });
    name.textContent = each.name;
    svg.append(name);
  });
  return svg;
}
