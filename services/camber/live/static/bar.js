// The bar above: whose data, which time, and what moves it. The help is made of the same list as the keys.

import { clock, day, duration, element, setText } from "./dom.js";

export const KEYS = [
  [" ", "space", "pause, or let time run"],
  ["ArrowLeft", "←", "back one second; with Shift one minute"],
  ["ArrowRight", "→", "forward one second; with Shift one minute"],
  ["Home", "Home", "to the beginning"],
  ["End", "End", "to the newest"],
  ["b", "b", "back ten minutes"],
  ["+", "+", "show a shorter time"],
  ["-", "−", "show a longer time"],
  ["w", "w", "show the last wrong fix"],
  ["f", "f", "keep the vehicle in the middle"],
  ["a", "a", "show the whole track"],
  ["p", "p", "points of the map's environment"],
  ["s", "s", "points of the last scan match"],
  ["t", "t", "light or dark"],
  ["Escape", "Esc", "let go of the fix looked at"],
  ["?", "?", "this list"],
];

class CamberBar extends HTMLElement {
  start(store, view, actions) {
    Object.assign(this, { store, view });
    const button = (text, title, action, kind = "") => element("button", { type: "button", title, class: kind, onclick: action }, text);
    this.heading = element("span");
    this.chip = element("span", { class: "chip" });
    this.time = element("span", { class: "time" });
    this.play = button("pause", "pause, or let time run (space)", () => view.toggle());
    this.spans = element("select", { title: "how long a time is shown", onchange: event => { view.span = Number(event.target.value); view.change(); } });
    this.append(
      element("span", { class: "name" }, "Camber ", this.heading), this.chip, this.time, element("span", { class: "spacer" }),
      element("span", { class: "group play" }, this.play, button("−10 min", "back ten minutes (b)", () => view.move(-600)), button("newest", "to the newest (End)", () => view.newest()), this.spans),
      element("span", { class: "group" }, button("PNG", "save the visible range as a picture", actions.picture, "wide"), button("CSV", "save the visible range as a table", actions.table, "wide"),
        button("light/dark", "light or dark (t)", actions.theme), button("?", "keys (?)", actions.help)),
    );
    view.addEventListener("view", () => this.refresh());
    store.addEventListener("status", () => this.refresh());
  }

  refresh() {
    const { store, view } = this, { greeting, status } = store;
    if (!greeting) return;
    setText(this.heading, greeting.title);
    document.title = `${greeting.title} · Camber`;
    const [text, kind] = this.state(greeting, status);
    setText(this.chip, text);
    this.chip.className = `chip ${kind}`;
    setText(this.time, Number.isFinite(view.end) ? `${day(view.end)} ${clock(view.end)} UTC` : "");
    setText(this.play, view.running ? "pause" : view.live ? "run" : "play");
    const span = Math.round(view.span), choices = [...new Set([60, 120, 300, 600, 1800, 3600, 21600, span])].sort((a, b) => a - b);
    if (this.spans.dataset.choices !== String(choices)) {
      this.spans.dataset.choices = String(choices);
      this.spans.replaceChildren(...choices.map(seconds => element("option", { value: seconds }, duration(seconds))));
    }
    this.spans.value = String(span);
  }

  state(greeting, status) {
    if (!this.store.connected) return ["no connection to camber live", "bad"];
    if (greeting.mode === "recording") {
      const known = { reading: ["recording, being read", "warn"], failed: ["recording cannot be read", "bad"] };
      return known[status?.state] ?? (this.view.running ? ["recording, playing", "good"] : ["recording", ""]);
    }
    if (status?.state !== "receiving") return ["waiting for the bus", "warn"];
    if (greeting.mode === "fleet") return ["live", "good"];
    if (!this.view.running) return ["paused", "warn"];
    const silent = Date.now() / 1000 - (this.store.arrived ?? 0);
    return silent < 3 ? ["live", "good"] : ["no messages", "bad"];
  }
}

class CamberHelp extends HTMLElement {
  toggle() {
    if (!this.dialog) {
      this.dialog = element("dialog", {}, element("h2", {}, "Keys"),
        element("dl", {}, ...KEYS.flatMap(([, shown, text]) => [element("dt", {}, element("kbd", {}, shown)), element("dd", {}, text)])),
        element("p", {}, "Drag in a chart to look at a part of it. Click a chart or the track to look at one fix. The address restores what is shown."),
        element("form", { method: "dialog" }, element("button", {}, "close")));
      this.append(this.dialog);
    }
    if (this.dialog.open) this.dialog.close(); else this.dialog.showModal();
  }
}

customElements.define("camber-bar", CamberBar);
customElements.define("camber-help", CamberHelp);
