// All vehicles of the fleet: which of them has a position that may be used, and since when nothing came.

import { colour, duration, element, metres, plain, setText } from "./dom.js";
import { fleetColour } from "./overlay.js";

const MOST_SHOWN = 300;

export class CamberFleet extends HTMLElement {
  start(store, view, map) {
    Object.assign(this, { store, view, map });
    this.heading = element("h2");
    this.list = element("table");
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
    this.list.replaceChildren(...worst.slice(0, MOST_SHOWN).map(vehicle => this.row(vehicle, now)));
    if (fleet.length > MOST_SHOWN) this.list.append(element("tr", {}, element("td", {}, `${fleet.length - MOST_SHOWN} more are not listed`)));
  }

  row(vehicle, now) {
    const { view } = this, silent = now - (vehicle.t ?? 0), state = fleetColour(vehicle);
    const why = state === "unknown" ? `silent for ${duration(silent)}` : vehicle.usable ? `${plain(vehicle.source)}, HPL ${metres(vehicle.hpl_m ?? NaN)}` : plain(vehicle.why ?? "no position");
    const choose = () => { view.vehicle = vehicle.vehicle; view.follow = true; this.map.refreshFleet(); };
    return element("tr", {}, element("td", {}, element("button", { type: "button", title: "keep it in the middle of the map", onclick: choose }, element("i", { class: "dot", style: { background: colour(state) } }), vehicle.vehicle)), element("td", {}, why));
  }
}

customElements.define("camber-fleet", CamberFleet);
