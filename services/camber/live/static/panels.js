// What is true now, the fix that is looked at, the services, and what the page leaves out.

import { clock, colour, duration, element, metres, plain, rows, setText, VERDICT_COLOURS } from "./dom.js";

const STATES = { ok: "ok", starting: "warn", degraded: "warn", failing: "bad", "not answering": "bad" };

class Panel extends HTMLElement {
  start(store, view, map) {
    Object.assign(this, { store, view, map });
    this.make();
  }
}

class CamberNow extends Panel {
  make() {
    this.word = element("span");
    this.chip = element("span", { class: "chip" });
    this.why = element("div", { class: "why" });
    this.list = element("dl");
    this.append(element("h2", {}, "Position"), element("div", { class: "state" }, this.word, this.chip), this.why, this.list);
    this.view.addEventListener("view", () => this.refresh());
  }

  refresh() {
    const { store, view } = this, { position, fix, pose } = store.tables;
    if (!position) return;
    const p = position.at(view.end), f = fix.at(view.end), q = pose.at(view.end), a = position.arrays;
    const fresh = p >= 0 && view.end - a.t[p] < 2;
    setText(this.word, fresh ? plain(store.word("source", a.source[p])).toUpperCase() : "NONE");
    setText(this.chip, fresh && a.usable[p] ? "usable" : "not usable");
    this.chip.className = `chip ${fresh && a.usable[p] ? "good" : "bad"}`;
    const reason = fresh ? store.word("reason", a.reason[p]) : "none";
    setText(this.why, fresh && reason !== "none" && !a.usable[p] ? plain(reason) : fresh ? "" : "no position was published");
    rows(this.list, fresh ? [
      ["HPL", `${metres(a.hpl_m[p])}, limit ${metres(a.alert_m[p], 1)}`],
      ["VPL", `${metres(a.vpl_m[p])}, limit ${metres(a.vertical_alert_m[p], 1)}`],
      ["reference", plain(store.word("horizontal_reference", a.horizontal_reference[p]))],
      ["pose from", q >= 0 ? plain(store.word("basis", pose.arrays.basis[q])) : null],
      ["speed", q >= 0 && Number.isFinite(pose.arrays.speed_m_s[q]) ? `${(3.6 * pose.arrays.speed_m_s[q]).toFixed(0)} km/h` : null],
      ["satellites", f >= 0 && Number.isFinite(fix.arrays.satellites[f]) ? String(fix.arrays.satellites[f]) : null],
      ["error (truth)", Number.isFinite(a.error_m[p]) ? `${metres(a.error_m[p])}, up ${metres(a.error_up_m[p])}` : null],
    ] : []);
  }
}

class CamberFix extends Panel {
  make() {
    this.heading = element("h2", {}, "Last wrong fix");
    this.verdict = element("div", { class: "verdict" });
    this.reason = element("div", { class: "reason" });
    this.list = element("dl");
    this.detail = element("p", { class: "detail" });
    this.button = element("button", { type: "button", title: "show it on the map and in the charts (w)", onclick: () => this.show() }, "show it");
    this.back = element("button", { type: "button", hidden: true, onclick: () => this.view.select(NaN) }, "back to the last wrong fix");
    this.append(this.heading, this.verdict, this.reason, this.list, this.detail, this.button, this.back);
    this.view.addEventListener("view", () => this.refresh());
  }

  // Index of the last erroneous fix before a time, −1: none.
  lastWrong(time) {
    const { verdict } = this.store.tables, wrong = this.store.words.verdict.indexOf("erroneous");
    for (let k = verdict.at(time); k >= 0; k--) if (verdict.arrays.verdict[k] === wrong) return k;
    return -1;
  }

  refresh() {
    const { store, view } = this, { verdict } = store.tables;
    if (!verdict) return;
    const chosen = Number.isFinite(view.selected), at = chosen ? verdict.at(view.selected + 1e-3) : this.lastWrong(view.end), a = verdict.arrays;
    setText(this.heading, chosen ? "Fix looked at" : "Last wrong fix");
    this.button.hidden = at < 0;
    this.back.hidden = !chosen;
    if (at < 0) {
      setText(this.verdict, "none so far");
      this.verdict.style.color = "";
      setText(this.reason, "");
      setText(this.detail, "");
      rows(this.list, []);
      return;
    }
    const word = store.word("verdict", a.verdict[at]), cause = store.word("cause", a.cause[at]);
    setText(this.verdict, plain(word));
    this.verdict.style.color = colour(VERDICT_COLOURS[word] ?? "ink");
    setText(this.reason, plain(store.word("reason", a.reason[at])));
    const evidence = store.words.evidence.filter((_, place) => a.evidence[at] & 1 << place).map(plain).join(", ");
    rows(this.list, [
      ["time", `${clock(a.t[at])} UTC`],
      ["height", Number.isFinite(a.difference_m[at]) ? metres(a.difference_m[at]) : null],
      ["tolerance", Number.isFinite(a.tolerance_m[at]) ? `±${metres(a.tolerance_m[at])}` : null],
      ["off the pose", Number.isFinite(a.east_m[at]) ? `${metres(a.east_m[at])} E, ${metres(a.north_m[at])} N` : null],
      ["evidence", evidence],
      ["lasting cause", cause === "none" ? null : plain(cause)],
      ["true error", Number.isFinite(a.error_m[at]) ? metres(a.error_m[at]) : null],
    ]);
    this.showDetail(verdict.first + at);
  }

  async showDetail(row) {
    const key = `${this.store.generation}/${row}`;
    if (key === this.asked) return;
    this.asked = key;
    setText(this.detail, "");
    const text = await this.store.detail(row);
    if (key === this.asked) setText(this.detail, text);
  }

  show() {
    const { verdict } = this.store.tables, at = Number.isFinite(this.view.selected) ? verdict.at(this.view.selected + 1e-3) : this.lastWrong(this.view.end);
    if (at < 0) return;
    const time = verdict.arrays.t[at];
    this.view.running = false;
    this.view.end = Math.min(time, this.store.newest);
    this.view.select(time);
    this.map.goTo(time);
  }
}

class CamberHealth extends Panel {
  make() {
    this.list = element("div");
    this.append(element("h2", {}, "Services"), this.list);
    this.open = new Set();
    this.store.addEventListener("status", () => this.refresh());
    fetch("runbook").then(reply => reply.json()).then(entries => { this.entries = entries; }, () => null);
  }

  refresh() {
    const { greeting, status } = this.store;
    this.hidden = !greeting?.health;
    if (this.hidden || !status) return;
    const view = status.health;
    if (!view) { this.list.replaceChildren(element("p", {}, "no connection to the bus")); return; }
    this.list.replaceChildren(...view.services.map(service => this.row(service)), this.channels(view.channels), ...view.notes.map(note => element("p", {}, note)));
  }

  row({ service, state, why, health }) {
    const kind = STATES[state] ?? "bad", issues = [...health?.issues ?? []].sort((a, b) => (b.last_time_ns ?? 0) - (a.last_time_ns ?? 0));
    const head = element("div", { class: "head" }, element("span", { class: `dot ${kind}` }), element("span", { class: "grow" }, plain(service)), element("span", { class: "state" }, state));
    const made = element("div", { class: "row", "data-service": service, "data-state": kind }, head);
    if (why) made.append(element("details", { open: true }, element("summary", {}, why)));
    for (const issue of issues.slice(0, 3)) made.append(this.issue(service, issue));
    return made;
  }

  issue(service, { code, text, count }) {
    const key = `${service} ${code}`, entry = this.entries?.[code];
    const made = element("details", { open: this.open.has(key) }, element("summary", {}, `${plain(code)} ×${count}`), element("p", {}, text));
    if (entry) for (const [name, content] of [["Meaning", entry[0]], ["Effect", entry[1]], ["What to do", entry[2]]]) made.append(element("p", {}, element("b", {}, `${name}: `), (content ?? "").replaceAll("`", "")));
    made.addEventListener("toggle", () => made.open ? this.open.add(key) : this.open.delete(key));
    return made;
  }

  channels(list) {
    const cell = (text, more = {}) => element("td", more, text);
    const head = element("tr", {}, ...["channel", "Hz", "age", "queue"].map(name => element("th", {}, name)));
    const body = list.filter(channel => channel.age_s !== null).map(channel => element("tr", {},
      cell(plain(channel.channel)), cell(channel.rate_hz === null ? "" : channel.rate_hz.toFixed(1)),
      cell(channel.age_s === null ? "" : duration(channel.age_s), { class: channel.late ? "late" : "" }), cell(String(channel.waiting))));
    return element("table", {}, head, ...body);
  }
}

class CamberNotes extends Panel {
  make() {
    this.list = element("div");
    this.append(element("h2", {}, "Notes"), this.list);
    this.store.addEventListener("status", () => this.refresh());
  }

  refresh() {
    const { greeting, status } = this.store;
    if (!greeting || !status) return;
    const left = Object.entries(status.left_out).filter(([, count]) => count > 0).map(([reason, count]) => `${count.toLocaleString("en")} ${plain(reason)}`);
    const { map, map_problem, notes } = greeting;
    const lines = [
      [map ? `Map: ${map.region}${map.version ? `, version ${map.version}` : ""}${map.datum ? `, ${map.datum}` : ""}` : "No map: --map gives the page one"],
      map?.surrogate ? [`The map was not surveyed: ${map.surrogate}`] : null, map_problem ? [map_problem, "bad"] : null,
      status.problem ? [status.problem, "bad"] : null, left.length ? [`Messages not shown: ${left.join(", ")}`, left.length === 1 && status.left_out.late ? "" : "bad"] : null, ...notes.map(note => [note]),
      this.map.problem ? [this.map.problem, "bad"] : null,
    ].filter(Boolean);
    this.list.replaceChildren(...lines.map(([text, kind]) => element("p", { class: kind ?? "" }, text)));
  }
}

for (const [name, kind] of Object.entries({ now: CamberNow, fix: CamberFix, health: CamberHealth, notes: CamberNotes })) customElements.define(`camber-${name}`, kind);
