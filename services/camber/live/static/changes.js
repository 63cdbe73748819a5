// Changes of the map by the fleet: held for review, published, and regions with an alarm; on the map and in a list.

import { colour, element, plain, setText } from "./dom.js";

const MOST_LISTED = 100; // of a kind
const LABEL_ZOOM = 16.5; // from which on marks do not stand in one another's texts
const REGION_M = 500; // half of the side of a region, as the fusion divides the map
const REASONS = { vehicles_not_known: "by vehicles that are not known from other streets", disagreed: "vehicles disagree", too_large: "larger than is published unseen", regional_shift: "its whole region moved", step: "no neighbour changed", other: "for another reason" };
export const CHANGE_LEGEND = [["diamond", "warn", "change held for review"], ["square", "accent", "change published"], ["triangle", "bad", "region with an alarm"]];

const centimetres = value => `${value < 0 ? "−" : "+"}${(100 * Math.abs(value)).toFixed(1)} cm`;
const error = value => `±${(100 * value).toFixed(1)} cm`;
const counted = (count, name) => `${count} ${name}${count === 1 ? "" : "s"}`;
const votesOf = ({ votes, vehicles }) => votes === undefined ? counted(vehicles, "vehicle") : `${counted(votes, "vote")} of ${counted(vehicles, "vehicle")}`;

// Outlines about a place, in pixels.
const OUTLINES = {
  diamond: [[0, -8], [8, 0], [0, 8], [-8, 0]],
  square: [[-5.5, -5.5], [5.5, -5.5], [5.5, 5.5], [-5.5, 5.5]],
  triangle: [[0, -10], [10, 8], [-10, 8]],
};

function mark(overlay, at, [kind, name]) {
  const { x, y } = overlay.pixel(at), c = overlay.context, { unit } = overlay;
  c.beginPath();
  OUTLINES[kind].forEach(([px, py], k) => c[k ? "lineTo" : "moveTo"](x + px * unit, y + py * unit));
  c.closePath();
  c.fillStyle = colour(name);
  c.fill();
  c.strokeStyle = colour("card");
  c.lineWidth = 1.5 * unit;
  c.stroke();
}

function label(overlay, at, lines) {
  const { x, y } = overlay.pixel(at), c = overlay.context, { unit } = overlay;
  c.font = `${11 * unit}px system-ui, sans-serif`;
  c.lineWidth = 3 * unit;
  c.strokeStyle = colour("land");
  c.fillStyle = colour("ink");
  lines.forEach((line, k) => { const place = [line, x + 12 * unit, y + (4 + 13 * k) * unit]; c.strokeText(...place); c.fillText(...place); });
}

export function drawChanges(overlay, changes) {
  if (!changes) return;
  const [held, published, alarmed] = CHANGE_LEGEND, near = overlay.map.getZoom() >= LABEL_ZOOM;
  for (const alarm of changes.alarms) {
    const at = [alarm.lon, alarm.lat];
    if (!alarm.everywhere) overlay.shape({ kind: "bad", at, major: REGION_M, minor: REGION_M, angle: 0 });
    mark(overlay, at, alarmed);
    label(overlay, at, [`${centimetres(alarm.shift_m)}${alarm.everywhere ? " everywhere" : ""}`]);
  }
  for (const [rows, kind, sigma] of [[changes.published, published, "sigma_m"], [changes.held, held, "standard_error_m"]]) for (const row of rows) {
    const at = [row.lon, row.lat];
    mark(overlay, at, kind);
    if (near) label(overlay, at, [`${centimetres(row.offset_m)} ${error(row[sigma])}`, votesOf(row)]);
  }
}

class CamberChanges extends HTMLElement {
  start(store, view, map) {
    Object.assign(this, { store, view, map });
    this.line = element("p");
    this.list = element("div");
    this.append(element("h2", {}, "Changes of the map"), this.line, this.list);
    store.addEventListener("greeting", () => { this.hidden = store.greeting.mode !== "fleet"; this.refresh(); });
    store.addEventListener("changes", () => this.refresh());
  }

  refresh() {
    const { changes } = this.store;
    if (!changes || changes.problem) {
      this.list.replaceChildren();
      setText(this.line, changes ? `map_update does not say which: ${changes.problem}` : "No answer of map_update yet.");
      return;
    }
    const { held, published, alarms, left_out } = changes;
    setText(this.line, held.length + published.length + alarms.length ? `${held.length} held, ${published.length} published, ${counted(alarms.length, "alarm")}${left_out ? `; ${left_out} more are not shown` : ""}` : "None: no change is held or published, and no region has an alarm.");
    this.list.replaceChildren(
      ...alarms.map(row => this.row("alarm", CHANGE_LEGEND[2], row, centimetres(row.shift_m), `${Math.round(100 * row.share)} % of ${counted(row.surfaces, "surface")} ${row.everywhere ? "everywhere" : "in this region"}: a base station, a datum or the survey, not the roads`)),
      ...this.rows("held", CHANGE_LEGEND[0], held, row => `${error(row.standard_error_m)}, ${votesOf(row)} on ${counted(row.days, "day")}, ${Math.round(100 * row.agreement)} % agree; the map has ${centimetres(row.in_map_m)}; held: ${REASONS[row.reason] ?? plain(row.reason)}`),
      ...this.rows("published", CHANGE_LEGEND[1], published, row => `${error(row.sigma_m)}, ${votesOf(row)}, since version ${row.since_map_version}`),
    );
  }

  rows(kind, marking, rows, describe) {
    const made = rows.slice(0, MOST_LISTED).map(row => this.row(kind, marking, row, `${centimetres(row.offset_m)}, surface ${row.surface_id}`, describe(row)));
    if (rows.length > MOST_LISTED) made.push(element("p", {}, `${rows.length - MOST_LISTED} more ${kind} are on the map`));
    return made;
  }

  row(kind, [shape, name], { lat, lon }, title, text) {
    const show = () => { this.view.follow = false; this.map.showPlace([lon, lat], LABEL_ZOOM + .5); };
    return element("div", { class: "row", "data-kind": kind }, element("button", { type: "button", title: "show it on the map", onclick: show }, element("i", { class: shape, style: { background: colour(name) } }), title), element("p", {}, text));
  }
}

customElements.define("camber-changes", CamberChanges);
