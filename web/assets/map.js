// The map: tracks, stops, the way so far, fixes, and the vehicle with its protection level.
// Leaflet draws it; there are no tiles. With the heading up, the whole plane is turned.
/* global L */
import { node } from "./svg.js";
import { text } from "./texts.js";

const EARTH_M = 6378137;
const TRAIL = 3600;
const TRAIL_M = 1.0; // a point of the trail is kept every so many metres
const FIXES = 300;
const TURN_STEP_DEG = 1;

export class MapPanel {
  constructor(element, frame, legend) {
    this.following = true;
    this.headingUp = false;
    this.changed = () => {};
    this._frame = frame;
    this._legend = legend;
    this._turn = 0;
    this._trailPoints = [];
    this._fixPoints = [];
    this._tracks = [];
    this._map = L.map(element, {
      preferCanvas: true,
      zoomControl: true,
      attributionControl: false,
      zoomSnap: 0.25,
      maxZoom: 22,
      minZoom: 2,
    }).setView([50.08, 14.42], 3);
    L.control.scale({ imperial: false }).addTo(this._map);
    this._renderer = L.canvas({ padding: 0.3 });
    const options = { renderer: this._renderer, interactive: false };
    this._base = L.layerGroup().addTo(this._map);
    this._likely = L.layerGroup().addTo(this._map);
    this._trail = L.polyline([], { ...options, weight: 3 }).addTo(this._map);
    this._fixes = L.layerGroup().addTo(this._map);
    this._limit = L.polygon([], { ...options, weight: 1.5, fillOpacity: 0.15 }).addTo(this._map);
    this._icon = L.marker([0, 0], { icon: vehicleIcon(), keyboard: false, interactive: false });
    this._map.on("dragstart", () => this.follow(false));
    new ResizeObserver(() => this._map.invalidateSize()).observe(frame);
    this.restyle();
  }

  // Colours come from the style sheet, so that dark and light agree with the rest of the page.
  restyle() {
    const style = getComputedStyle(document.documentElement);
    this._colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const c = this._colour;
    this._trail.setStyle({ color: c("estimate") });
    this._limit.setStyle({ color: c("estimate"), fillColor: c("estimate") });
    this._base.eachLayer((each) => each.setStyle && each.setStyle({ color: each.options.stop ? c("ink") : c("rail"), fillColor: c("paper") }));
    this._fixes.eachLayer((each) => each.setStyle({ color: c("gnss"), fillColor: c("gnss") }));
  }

  speak() {
    const rows = [["estimate", "vehicle"], ["estimate", "trail"], ["gnss", "fixes"], ["likely", "track"]];
    this._legend.replaceChildren(
      ...rows.map(([colour, key]) => {
        const item = document.createElement("li");
        item.className = `of-${colour}`;
        item.textContent = text(key);
        return item;
      }),
    );
  }

  network(network) {
    const options = { renderer: this._renderer, interactive: false, weight: 1.6, color: this._colour("rail") };
    for (const units of network.tracks) {
      const points = [];
      let latitude = 0;
      let longitude = 0;
      for (let k = 0; k < units.length; k += 2) {
        latitude += units[k];
        longitude += units[k + 1];
        points.push([latitude / 1e7, longitude / 1e7]);
      }
      this._tracks.push(points);
      this._base.addLayer(L.polyline(points, options));
    }
    this._stops = L.layerGroup();
    const named = new Set();
    for (const [name, latitude, longitude] of network.stops) {
      const dot = L.circleMarker([latitude, longitude], {
        ...options, stop: true, radius: 4, color: this._colour("ink"), fillColor: this._colour("paper"), fillOpacity: 1,
      });
      this._base.addLayer(dot);
      const near = `${name}|${latitude.toFixed(3)}|${longitude.toFixed(3)}`;
      if (!named.has(near)) {
        named.add(near);
        const label = document.createElement("span");
        label.textContent = name; // a name is text, whatever stands in it
        this._stops.addLayer(L.marker([latitude, longitude], {
          interactive: false, keyboard: false, icon: L.divIcon({ className: "stop-name", html: label, iconSize: [0, 0] }),
        }));
      }
    }
    const near = () => (this._map.getZoom() >= 16 ? this._stops.addTo(this._map) : this._stops.remove());
    this._map.on("zoomend", near);
    near();
  }

  load(history) {
    const latitude = history.columns.indexOf("latitude_deg");
    this._trailPoints = [];
    const since = history.minute[0][0] ?? Infinity; // the hour ends with the minute: not twice
    for (const [part, end] of [[history.hour, since], [history.minute, Infinity]]) {
      part[latitude].forEach((value, k) => {
        if (part[0][k] < end) this._step(value, part[latitude + 1][k]);
      });
    }
    this._trail.setLatLngs(this._trailPoints);
  }

  add(message) {
    if (message.state) this._step(message.state.latitude_deg, message.state.longitude_deg);
    for (const point of message.fixes) this._fixPoints.push(point);
    if (this._fixPoints.length > FIXES) this._fixPoints.splice(0, this._fixPoints.length - FIXES);
  }

  _step(latitude, longitude) {
    if (latitude === null) return;
    const last = this._trailPoints[this._trailPoints.length - 1];
    if (last && metres(last, [latitude, longitude]) < TRAIL_M) return;
    this._trailPoints.push([latitude, longitude]);
    if (this._trailPoints.length > TRAIL) this._trailPoints.shift();
    this._grown = true;
  }

  draw(message) {
    const { state, match } = message;
    const seen = state || message.gnss;
    if (!seen) return;
    const here = [seen.latitude_deg, seen.longitude_deg];
    if (!this._placed) {
      this._placed = true;
      this._map.setView(here, 19, { animate: false });
      this._icon.addTo(this._map);
    }
    if (this._grown) {
      this._grown = false;
      this._trail.setLatLngs(this._trailPoints);
    }
    this._drawFixes();
    this._drawLikely(match);
    this._icon.setLatLng(here);
    if (state) {
      this._limit.setLatLngs(ellipse(state));
      const arrow = this._icon.getElement()?.firstElementChild;
      const heading = state.heading_deg ?? 0;
      if (arrow) arrow.style.transform = `rotate(${heading}deg)`;
      this._icon.getElement()?.classList.toggle("unknown", state.heading_deg === null);
      if (this.headingUp) this._rotate(-heading);
    }
    if (this.following) this._map.setView(here, this._map.getZoom(), { animate: false });
  }

  // One dot a fix, the oldest reused: nothing is made anew while one looks.
  _drawFixes() {
    const dots = this._fixes.getLayers();
    this._fixPoints.forEach((point, k) => {
      if (dots[k]) dots[k].setLatLng(point);
      else {
        const colour = this._colour("gnss");
        this._fixes.addLayer(L.circleMarker(point, {
          renderer: this._renderer, interactive: false, radius: 2.5, weight: 0, color: colour, fillColor: colour, fillOpacity: 0.9,
        }));
      }
    });
  }

  _drawLikely(match) {
    const wanted = match && match.run >= 0 ? [{ run: match.run, probability: match.probability }, ...match.alternatives] : [];
    const shown = wanted.filter((each) => each.probability >= 0.01);
    const name = shown.map((each) => `${each.run >> 1}:${each.probability.toFixed(2)}`).join(" ");
    if (name === this._shown) return;
    this._shown = name;
    this._likely.clearLayers();
    const done = new Set();
    for (const { run, probability } of shown) {
      const track = this._tracks[run >> 1];
      if (!track || done.has(run >> 1)) continue;
      done.add(run >> 1);
      this._likely.addLayer(L.polyline(track, {
        renderer: this._renderer, interactive: false, color: this._colour("likely"), weight: 7, opacity: 0.15 + 0.5 * probability,
      }));
    }
  }

  follow(on) {
    this.following = on;
    if (!on) {
      this.headingUp = false;
      this._rotate(0);
    }
    this.changed();
  }

  turn(on) {
    this.headingUp = on;
    if (on) this.following = true;
    else this._rotate(0);
    this._map.dragging[on ? "disable" : "enable"](); // in a turned plane it would go astray
    this.changed();
  }

  _rotate(degrees) {
    const turn = Math.round(degrees / TURN_STEP_DEG) * TURN_STEP_DEG;
    if (turn === this._turn && this._frame.classList.contains("turned") === this.headingUp) return;
    this._turn = turn;
    this._frame.classList.toggle("turned", this.headingUp);
    this._frame.style.setProperty("--turn", `${turn}deg`);
    this._map.invalidateSize({ pan: false });
  }
}

function vehicleIcon() {
  const svg = node("svg", { viewBox: "-12 -12 24 24", width: 34, height: 34 });
  svg.append(node("path", { d: "M0 -10 L7 9 L0 5 L-7 9 Z", class: "vehicle-arrow" }));
  return L.divIcon({ className: "vehicle-icon", html: svg, iconSize: [34, 34], iconAnchor: [17, 17] });
}

function metres(a, b) {
  const north = ((b[0] - a[0]) * Math.PI * EARTH_M) / 180;
  const east = ((b[1] - a[1]) * Math.PI * EARTH_M * Math.cos((a[0] * Math.PI) / 180)) / 180;
  return Math.hypot(north, east);
}

// The protection level is a bound along and across: an ellipse with these half axes.
function ellipse(state) {
  const heading = ((state.heading_deg ?? 0) * Math.PI) / 180;
  const degree = 180 / (Math.PI * EARTH_M);
  const points = [];
  for (let k = 0; k < 36; k += 1) {
    const along = state.protection_along_m * Math.cos((k * Math.PI) / 18);
    const right = state.protection_across_m * Math.sin((k * Math.PI) / 18);
    const north = along * Math.cos(heading) - right * Math.sin(heading);
    const east = along * Math.sin(heading) + right * Math.cos(heading);
    const latitude = state.latitude_deg + north * degree;
    points.push([latitude, state.longitude_deg + (east * degree) / Math.cos((latitude * Math.PI) / 180)]);
  }
  return points;
}
