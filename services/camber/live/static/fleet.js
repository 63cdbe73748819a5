// All vehicles of the fleet: which of them has a position that may be used, and since when nothing came.

import { colour, duration, element, metres, plain, setText } from "./dom.js";
import { fleetColour } from "./overlay.js";

const MOST_SHOWN = 300;

export class CamberFleet extends HTMLElement {
  start(store, view, map) {
    Object.assign(this, { store, view, map });
    this.heading = element("h2");
    this.list = element("table");
    this.moreText = element("td");
    this.more = element("tr", {}, this.moreText);
    this.rows = new Map();
    this.append(this.heading, this.list);
    store.addEventListener("greeting", () => this.showMode());
    store.addEventListener("fleet", () => this.refresh());
  }

  // Of a fleet there are no charts: they are of one vehicle.
  showMode() {
    const fleet = this.store.greeting.mode === "fleet";
    document.body.classList.toggle("fleet", fleet);
    this.hidden = !fleet;
    this.refresh();
  }

  refresh() {
    const { fleet } = this.store, now = Date.now() / 1000, usable = fleet.filter(vehicle => fleetColour(vehicle) === "good").length;
    setText(this.heading, `Vehicles: ${fleet.length}, position usable: ${usable}`);
    const worst = [...fleet].sort((a, b) => ["bad", "unknown", "good"].indexOf(fleetColour(a)) - ["bad", "unknown", "good"].indexOf(fleetColour(b)));
    const shown = worst.slice(0, MOST_SHOWN), names = new Set(shown.map(vehicle => vehicle.vehicle));
    for (const [name, row] of this.rows) if (!names.has(name)) { row.box.remove(); this.rows.delete(name); }
    // A row stays where it is while the order is the same: one that is moved loses the focus and a click that has begun.
    shown.forEach((vehicle, place) => {
      const { box } = this.row(vehicle, now);
      if (this.list.children[place] !== box) this.list.insertBefore(box, this.list.children[place] ?? null);
    });
    if (fleet.length > MOST_SHOWN) this.list.append(this.more); else this.more.remove();
    setText(this.moreText, `${fleet.length - MOST_SHOWN} more are not listed`);
  }

  row(vehicle, now) {
    const name = vehicle.vehicle, silent = now - (vehicle.t ?? 0), state = fleetColour(vehicle);
    if (!this.rows.has(name)) this.rows.set(name, this.emptyRow(name));
    const row = this.rows.get(name);
    row.dot.style.background = colour(state);
    setText(row.why, state === "unknown" ? `silent for ${duration(silent)}` : vehicle.usable ? `${plain(vehicle.source)}, HPL ${metres(vehicle.hpl_m ?? NaN)}` : plain(vehicle.why ?? "no position"));
    return row;
  }

  emptyRow(name) {
    const choose = () => { this.view.vehicle = name; this.view.follow = true; this.map.refreshFleet(); };
    const dot = element("i", { class: "dot" }), why = element("td");
    const button = element("button", { type: "button", title: "keep it in the middle of the map", onclick: choose }, dot, name);
    return { box: element("tr", {}, element("td", {}, button), why), dot, why };
  }
}

customElements.define("camber-fleet", CamberFleet);
