// What is under the pointer on a line of many corners, of which `segment_index` and the next are those
// before and after the pointer. {m}: the chainage, whose value at the corners is `value`. {lines}: the
// operator's lines there; `value` holds [name, where its chainage is 0, ±1, first and last chainage].
const { index, segment_index: k, x, y } = special_vars;
const { east, north, chainage } = Object.fromEntries(
  ["east", "north", "chainage"].map((name) => [name, source.data[name][index]]),
);
const [along, up] = [east[k + 1] - east[k], north[k + 1] - north[k]];
const share = ((x - east[k]) * along + (y - north[k]) * up) / (along * along + up * up);
const at = chainage[k] + Math.min(Math.max(share, 0), 1) * (chainage[k + 1] - chainage[k]);
if (format === "m") return at.toFixed(1);
return value
  .filter(([, , , from, to]) => from <= at && at <= to)
  .map(([name, zero, sign]) => `${name} at ${Math.round(sign * (at - zero))} m`)
  .join("; ");
