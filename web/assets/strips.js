// Strips over time: the last minute ten times a second, the last hour once a second.
/* global uPlot */
import { decimals, text } from "./texts.js";

const HEIGHT = 150;
const FAST = 600;
const SLOW = 3600;
const BEGUN_AGAIN_S = 1; // time that goes back by more is that of a record that begins again

// [title, unit, least range of the axis, [[column, factor, colour, label, style]]]
const STRIPS = [
  ["speed", "km/h", 10, [
    ["gnss_speed_mps", 3.6, "gnss", "gnss"],
    ["wheel_speed_mps", 3.6, "wheels", "wheels"],
    ["speed_mps", 3.6, "estimate", "estimate"],
  ]],
  ["grade", "%", 1, [["grade_percent", 1, "estimate", "grade"], ["grade_std_percent", 1, "limit", "σ"]]],
  ["heading", "°", 4, [["heading_deg", 1, "estimate", "heading"]]],
  ["sigma", "m", 0.5, [
    ["along_std_m", 1, "estimate", "along"],
    ["across_std_m", 1, "wheels", "across"],
    ["protection_along_m", 1, "limit", "limit"],
  ]],
  ["innovation", "σ", 4, [
    ["gnss_innovation", 1, "gnss", "gnss", "points"],
    ["wheels_innovation", 1, "wheels", "wheels", "points"],
    ["map_innovation", 1, "likely", "map_source", "points"],
    ["refused", 1, "bad", "refused", "points"],
  ]],
];

// Rows of fixed number, oldest overwritten: what is kept open for days does not grow.
class Ring {
  constructor(capacity, width) {
    this._capacity = capacity;
    this._columns = Array.from({ length: width }, () => new Float64Array(capacity).fill(NaN));
    this.count = 0;
  }

  add(row) {
    const at = this.count % this._capacity;
    row.forEach((value, k) => { this._columns[k][at] = value === null ? NaN : value; });
    this.count += 1;
  }

  last(k) {
    return this.count ? this._columns[k][(this.count - 1) % this._capacity] : null;
  }

  // One column in order, `null` where nothing is known, from row `first` of those that are kept.
  column(k, factor = 1, since = -Infinity, times = null) {
    const kept = Math.min(this.count, this._capacity);
    const values = [];
    for (let n = this.count - kept; n < this.count; n += 1) {
      const at = n % this._capacity;
      if (times !== null && !(this._columns[times][at] >= since)) continue;
      const value = this._columns[k][at];
      values.push(Number.isNaN(value) ? null : value * factor);
    }
    return values;
  }
}

export class Strips {
  constructor(element) {
    this._element = element;
    this._span = 60;
    this._columns = null;
    this._charts = [];
    this._drawnAt = 0;
  }

  load(history) {
    this._columns = history.columns;
    this._begin();
    for (const [ring, part] of [[this._fast, history.minute], [this._slow, history.hour]]) {
      for (let row = 0; row < part[0].length; row += 1) ring.add(part.map((column) => column[row]));
    }
    this._last = this._fast.last(0) ?? -Infinity;
    this.draw(true);
  }

  _begin() {
    this._fast = new Ring(FAST, this._columns.length);
    this._slow = new Ring(SLOW, this._columns.length);
    this._second = null;
    this._last = -Infinity;
  }

  add(message) {
    const { row } = message;
    if (!row || !this._columns) return;
    if (row[0] < this._last - BEGUN_AGAIN_S) this._begin();
    if (row[0] <= this._last) return;
    this._last = row[0];
    this._fast.add(row);
    if (this._second !== null && Math.floor(row[0]) !== Math.floor(this._second[0])) this._slow.add(this._second);
    this._second = row;
  }

  show(seconds) {
    this._span = seconds;
    this.draw(true);
  }

  build() {
    for (const { chart } of this._charts) chart.destroy();
    this._element.replaceChildren();
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = { stroke: colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid") }, font: "12px sans-serif" };
    this._charts = STRIPS.map(([title, unit, least, series]) => {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      caption.textContent = unit === "m" || unit === "σ" ? text(title) : `${text(title)}, ${unit}`;
      const room = document.createElement("div");
      room.setAttribute("role", "img");
      room.setAttribute("aria-label", caption.textContent);
      figure.append(caption, room);
      this._element.append(figure);
      const chart = new uPlot({
        width: Math.max(200, room.clientWidth || 400),
        height: HEIGHT,
        cursor: { sync: { key: "strips" }, drag: { x: false, y: false } },
        legend: { live: true },
        scales: { x: { time: true } },
        axes: [{ ...axis, size: 28 }, { ...axis, size: 52 }],
        series: [
          { label: text("time"), value: (_, t) => (t === null ? "–" : new Date(1000 * t).toLocaleTimeString()) },
          ...series.map(([, , name, label, kind]) => ({
            label: label === "σ" ? label : text(label),
            stroke: colour(name),
            width: kind ? 0 : 1.5,
            paths: kind ? () => null : undefined,
            points: kind ? { show: true, size: 4, fill: colour(name), stroke: colour(name) } : { show: false },
            spanGaps: false,
            value: (_, v) => decimals(v, 2),
          })),
        ],
      }, [[], ...series.map(() => [])], room);
      new ResizeObserver(() => {
        if (room.clientWidth > 0 && room.clientWidth !== chart.width) chart.setSize({ width: room.clientWidth, height: HEIGHT });
      }).observe(figure);
      return { chart, series, room, figure, least };
    });
    this.draw(true);
  }

  // The minute is drawn with each frame, what is longer once a second: more nobody sees.
  draw(now = false) {
    const due = performance.now() - this._drawnAt > (this._span > 60 ? 1000 : 190);
    if (!this._columns || !(now || due)) return;
    this._drawnAt = performance.now();
    const ring = this._span > 60 ? this._slow : this._fast;
    const end = this._last > 0 ? this._last : Math.max(...ring.column(0), 0);
    const since = end - this._span;
    const times = ring.column(0, 1, since, 0);
    for (const { chart, series, room, figure, least } of this._charts) {
      const box = room.getBoundingClientRect();
      if (!now && !figure.hidden && (box.bottom < 0 || box.top > innerHeight)) continue;
      const columns = series.map(([name, factor]) => ring.column(this._columns.indexOf(name), factor, since, 0));
      if (series[0][4]) columns[columns.length - 1] = columns[columns.length - 1].map((v) => (v ? v : null));
      figure.hidden = columns.every((column) => column.every((value) => value === null)); // nobody tells it
      if (figure.hidden) continue;
      chart.setData([times, ...columns], false);
      chart.batch(() => {
        chart.setScale("x", { min: since, max: end });
        const [low, high] = range(columns, least);
        chart.setScale("y", { min: low, max: high });
      });
    }
  }
}

function range(columns, least) {
  let low = Infinity;
  let high = -Infinity;
  for (const column of columns) {
    for (const value of column) {
      if (value === null) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  if (low > high) return [0, least];
  const margin = Math.max(0.08 * (high - low), (least - high + low) / 2);
  return [low - margin, high + margin];
}
