// The visible range as a picture and as a table.

import { clock, colour, day, element } from "./dom.js";

const NUMBERS = ["difference_m", "tolerance_m", "east_m", "north_m", "error_m"];
const LEVELS = ["h", "hpl_m", "vpl_m", "alert_m", "vertical_alert_m", "major_m", "minor_m", "error_m", "error_up_m"];

// The charts stand beside the map as on a wide screen, or below it.
export async function savePicture(store, view, map, charts) {
  const left = await map.picture(), right = charts.picture(left && innerWidth < 760 ? left.width : charts.clientWidth * devicePixelRatio);
  const beside = left && innerWidth >= 760, head = Math.round(30 * devicePixelRatio), gap = Math.round(8 * devicePixelRatio);
  const width = beside ? left.width + gap + right.width : right.width;
  const height = head + (beside ? Math.max(left.height, right.height) : (left?.height ?? 0) + right.height);
  const whole = element("canvas", { width, height }), c = whole.getContext("2d");
  c.fillStyle = colour("card");
  c.fillRect(0, 0, width, height);
  c.fillStyle = colour("ink");
  c.font = `${Math.round(head * .5)}px system-ui, sans-serif`;
  c.fillText(`${store.greeting.title} · ${day(view.begin)} ${clock(view.begin)} to ${clock(view.end)} UTC · Camber`, head * .4, head * .68);
  if (left) c.drawImage(left, 0, head);
  c.drawImage(right, beside ? left.width + gap : 0, beside || !left ? head : head + left.height);
  whole.toBlob(blob => save(blob, `${fileName(store, view)}.png`), "image/png");
}

// One row for each position of the range, with the verdict of the same time where there is one.
export function tableText(store, view) {
  const { position, verdict } = store.tables, p = position.arrays, v = verdict.arrays;
  const lines = [["time_utc", "latitude_deg", "longitude_deg", "source", "usable", "reason", ...LEVELS, "verdict", "verdict_reason", "fix_latitude_deg", "fix_longitude_deg", ...NUMBERS.map(name => `fix_${name}`)].join(",")];
  const number = (value, digits) => Number.isFinite(value) ? value.toFixed(digits) : "";
  for (let k = position.at(view.begin - 1e-6) + 1; k < position.length && p.t[k] <= view.end; k++) {
    const at = verdict.at(p.t[k] + 1e-4), same = at >= 0 && Math.abs(v.t[at] - p.t[k]) < 1e-3;
    lines.push([
      new Date(Math.round(p.t[k] * 1000)).toISOString(), number(p.lat[k], 9), number(p.lon[k], 9), store.word("source", p.source[k]), p.usable[k], store.word("reason", p.reason[k]),
      ...LEVELS.map(name => number(p[name][k], 3)),
      ...(same ? [store.word("verdict", v.verdict[at]), store.word("reason", v.reason[at]), number(v.lat[at], 9), number(v.lon[at], 9), ...NUMBERS.map(name => number(v[name][at], 3))] : ["", "", "", "", ...NUMBERS.map(() => "")]),
    ].join(","));
  }
  return lines.join("\n") + "\n";
}

export function saveTable(store, view) { save(new Blob([tableText(store, view)], { type: "text/csv" }), `${fileName(store, view)}.csv`); }

function fileName(store, view) {
  return `camber-${store.greeting.title.replaceAll(/[^A-Za-z0-9_-]/g, "_")}-${day(view.end)}T${clock(view.end).slice(0, 8).replaceAll(":", "")}`;
}

function save(blob, name) {
  const address = URL.createObjectURL(blob);
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}
