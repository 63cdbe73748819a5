// Changes of the map by the fleet: held for review, pending, published, and regions with an alarm; on the map and in a list.

import { ChangeDetail, keyOf } from "./decision.js";
import { colour, element, plain, setText } from "./dom.js";
import { centimetres } from "./votes.js";

const MOST_LISTED = 100; // of a kind
const LABEL_ZOOM = 16.5; // from which on marks do not stand in one another's texts
const REGION_M = 500; // half of the side of a region, as the fusion divides the map
const REASONS = { vehicles_not_known: "by vehicles that are not known from other streets", disagreed: "vehicles disagree", too_large: "larger than is published unseen", regional_shift: "its whole region moved", step: "no neighbour changed", other: "for another reason",
  not_significant: "not significant yet", false_discovery: "may be a false discovery", too_few_vehicles: "too few vehicles", too_few_days: "too few days", rests_on_few: "rests on few vehicles" };
const NEAR_PX = 16; // of a click on the map
export const CHANGE_LEGEND = [["diamond", "warn", "change held for review"], ["diamond", "faint", "change pending"], ["square", "accent", "change published"], ["triangle", "bad", "region with an alarm"]];
const KINDS = ["held", "pending", "published", "alarm"];

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

// Texts right of a place, unless they would stand in earlier ones; `taken`: boxes of those.
function label(overlay, at, lines, taken) {
  const { x, y } = overlay.pixel(at), c = overlay.context, { unit } = overlay;
  c.font = `${11 * unit}px system-ui, sans-serif`;
  const box = { left: x + 10 * unit, right: x + 12 * unit + Math.max(...lines.map(line => c.measureText(line).width)), top: y - 9 * unit, bottom: y + (13 * lines.length - 5) * unit };
  if (taken.some(other => box.left < other.right && other.left < box.right && box.top < other.bottom && other.top < box.bottom)) return;
  taken.push(box);
  c.lineWidth = 3 * unit;
  c.strokeStyle = colour("land");
  c.fillStyle = colour("ink");
  lines.forEach((line, k) => { const place = [line, x + 12 * unit, y + (4 + 13 * k) * unit]; c.strokeText(...place); c.fillText(...place); });
}

// Rows by kind; those drawn last are the first to be decided.
const kindsOf = changes => ({ alarm: changes.alarms, published: changes.published, pending: changes.pending, held: changes.held });

// Kind and row of the change at a place of the map; null: none.
export function changeAt(map, changes, { x, y }) {
  let best = null, least = NEAR_PX;
  for (const [kind, rows] of Object.entries(changes ? kindsOf(changes) : {})) for (const row of rows) {
    const at = map.project([row.lon, row.lat]), away = Math.hypot(at.x - x, at.y - y);
    if (away <= least) { least = away; best = { kind, row }; }
  }
  return best;
}

export function drawChanges(overlay, changes, chosen) {
  if (!changes) return;
  const [held, pending, published, alarmed] = CHANGE_LEGEND, near = overlay.map.getZoom() >= LABEL_ZOOM, labels = [];
  for (const alarm of changes.alarms) {
    const at = [alarm.lon, alarm.lat];
    if (!alarm.everywhere) overlay.shape({ kind: "bad", at, major: REGION_M, minor: REGION_M, angle: 0 });
    mark(overlay, at, alarmed);
    labels.unshift([at, [`${centimetres(alarm.shift_m)}${alarm.everywhere ? " everywhere" : ""}`]]);
  }
  for (const [name, kind, sigma] of [["published", published, "sigma_m"], ["pending", pending, "standard_error_m"], ["held", held, "standard_error_m"]]) for (const row of changes[name]) {
    const at = [row.lon, row.lat], isChosen = chosen === keyOf(name, row);
    mark(overlay, at, kind);
    if (isChosen) overlay.ring(overlay.pixel(at), 14, colour("ink"), 3);
    if (near) labels[isChosen ? "unshift" : "push"]([at, [`${centimetres(row.offset_m)} ${error(row[sigma])}`, votesOf(row)]]);
  }
  const taken = [];
  for (const [at, lines] of labels) label(overlay, at, lines, taken);
}

class CamberChanges extends HTMLElement {
  start(store, view, map) {
    Object.assign(this, { store, view, map });
    this.line = element("p");
    this.list = element("div", { class: "list" });
    this.detail = new ChangeDetail(store, facts);
    this.rows = new Map();
    this.append(element("h2", {}, "Changes of the map"), this.line, this.detail.box, this.list);
    store.addEventListener("greeting", () => { this.hidden = store.greeting.mode !== "fleet"; this.refresh(); });
    store.addEventListener("changes", () => this.refresh());
    view.addEventListener("change", () => { this.showChosen(); if (!this.detail.box.hidden) { this.detail.box.scrollIntoView({ block: "nearest" }); this.detail.box.focus(); } });
  }

  refresh() {
    const { changes } = this.store;
    if (!changes || changes.problem) {
      setText(this.line, changes ? `map_update does not say which: ${changes.problem}` : "No answer of map_update yet.");
    } else {
      const { held, pending, published, alarms, left_out } = changes;
      setText(this.line, held.length + pending.length + published.length + alarms.length ? `${held.length} held, ${pending.length} pending, ${published.length} published, ${counted(alarms.length, "alarm")}${left_out ? `; ${left_out} more are not shown` : ""}` : "None: no change is held, pending or published, and no region has an alarm.");
    }
    this.listRows(changes && !changes.problem ? kindsOf(changes) : {});
    this.showChosen();
  }

  // A row that stays keeps its element, and with it the focus and a click that has begun.
  listRows(kinds) {
    const made = [], before = this.rows;
    this.rows = new Map();
    for (const kind of ["alarm", ...KINDS.slice(0, 3)]) {
      const rows = kinds[kind] ?? [];
      for (const row of rows.slice(0, MOST_LISTED)) {
        const key = keyOf(kind, row), [title, text] = texts(kind, row), box = before.get(key) ?? this.row(kind, key);
        box.querySelector("button").lastChild.textContent = title;
        setText(box.querySelector("p"), text);
        this.rows.set(key, box);
        made.push(box);
      }
      if (rows.length > MOST_LISTED) made.push(element("p", {}, `${rows.length - MOST_LISTED} more ${kind} are on the map`));
    }
    if (made.length !== this.list.childNodes.length || made.some((box, place) => this.list.childNodes[place] !== box)) this.list.replaceChildren(...made);
  }

  row(kind, key) {
    const [shape, name] = CHANGE_LEGEND[KINDS.indexOf(kind)];
    const show = () => { const row = this.find(key)?.row; if (row) { this.view.follow = false; this.map.showPlace([row.lon, row.lat], LABEL_ZOOM + .5); this.view.lookAt(key); } };
    return element("div", { class: "row", "data-kind": kind }, element("button", { type: "button", title: "show it on the map", onclick: show }, element("i", { class: shape, style: { background: colour(name) } }), ""), element("p"));
  }

  find(key) {
    const { changes } = this.store;
    const rows = Object.entries(changes && !changes.problem ? kindsOf(changes) : {}).flatMap(([kind, list]) => list.map(row => ({ kind, row })));
    // A held change that was accepted comes again as a published one.
    return rows.find(({ kind, row }) => keyOf(kind, row) === key) ?? rows.find(({ row }) => row.surface_id && key.endsWith(` ${row.surface_id}`)) ?? null;
  }

  showChosen() {
    const chosen = this.view.changeKey ? this.find(this.view.changeKey) : null;
    this.detail.show(chosen?.kind, chosen?.row ?? null);
    for (const [key, box] of this.rows) box.classList.toggle("chosen", key === this.view.changeKey);
    this.map.mark();
  }
}

function texts(kind, row) {
  if (kind === "alarm") return [centimetres(row.shift_m), `${Math.round(100 * row.share)} % of ${counted(row.surfaces, "surface")} ${row.everywhere ? "everywhere" : "in this region"}: a base station, a datum or the survey, not the roads`];
  const title = `${centimetres(row.offset_m)}, ${row.road}, surface ${row.surface_id}`;
  if (kind === "published") return [title, `${error(row.sigma_m)}, ${votesOf(row)}, since version ${row.since_map_version}`];
  return [title, `${error(row.standard_error_m)}, ${votesOf(row)} on ${counted(row.days, "day")}, ${Math.round(100 * row.agreement)} % agree; the map has ${centimetres(row.in_map_m)}; ${kind}: ${REASONS[row.reason] ?? plain(row.reason)}`];
}

// What is known of a change, name by name.
function facts(kind, row) {
  const place = ["place", `${row.lat.toFixed(6)}°, ${row.lon.toFixed(6)}°`];
  if (kind === "alarm") return [place, ["surfaces", String(row.surfaces)], ["share that moved", `${Math.round(100 * row.share)} %`]];
  const road = [["road", row.road], ["surface", row.surface_id], place, ["contributors", counted(row.vehicles, "vehicle")]];
  if (kind === "published") return [...road, ["offset", `${centimetres(row.offset_m)} ${error(row.sigma_m)}`], ["since version", String(row.since_map_version)]];
  return [...road, ["votes", `${row.votes} on ${counted(row.days, "day")}`], ["the map has", centimetres(row.in_map_m)], ["the votes give", `${centimetres(row.offset_m)} ${error(row.standard_error_m)}`], ["agreement", `${Math.round(100 * row.agreement)} %`], ["why it waits", REASONS[row.reason] ?? plain(row.reason)]];
}

customElements.define("camber-changes", CamberChanges);
