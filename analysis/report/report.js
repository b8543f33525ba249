// Runs once the figures stand. `timeline` is the range of time that all figures share, `path` what
// the map draws of the ride, `shown` and `here` what it draws of the chosen part and the instant
// under the pointer; `cursor` is the line that follows the pointer through all figures.
const [first, last] = whole;
const label = document.getElementById("shown");
const clock = (ms) => new Date(ms).toISOString().slice(11, 19);

function tell() {
  const [start, end] = [timeline.start, timeline.end];
  const length = Math.round((end - start) / 1000);
  label.textContent = `${clock(start)} – ${clock(end)} UTC, ${length} s`;
  if (path === null) return;
  const all = start <= first && end >= last;
  const { time, east, north } = path.data;
  const found = { east: [], north: [] };
  for (let k = 0; !all && k < time.length; k++) {
    if (time[k] >= start && time[k] <= end) {
      found.east.push(east[k]);
      found.north.push(north[k]);
    }
  }
  shown.data = found;
}

function follow(ms) {
  if (path === null || ms === null || Number.isNaN(ms)) return;
  const { time, east, north } = path.data;
  let [low, high] = [0, time.length - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < ms) low = middle + 1;
    else high = middle;
  }
  here.data = { east: [east[low]], north: [north[low]] };
}

let waiting = false;
function soon() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    tell();
  });
}

timeline.properties.start.change.connect(soon);
timeline.properties.end.change.connect(soon);
cursor.properties.location.change.connect(() => follow(cursor.location));
document.getElementById("whole").addEventListener("click", () => timeline.setv({ start: first, end: last }));
// A finger that goes up the page shall move the page, not choose a part of the ride.
if (matchMedia("(pointer: coarse)").matches) {
  for (const figure of figures) figure.toolbar.active_drag = null;
}
// On a phone names stand in rows, and clocks keep their distance.
if (document.body.clientWidth < 600) {
  for (const figure of figures) {
    for (const part of figure.above) if (part.type === "Legend") part.ncols = 3;
    for (const axis of figure.below) axis.ticker.desired_num_ticks = 3;
  }
}
tell();
