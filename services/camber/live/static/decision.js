// The change that is looked at: its road, its numbers and votes over time; with the operator's key it is decided here.

import { element, plain, setText } from "./dom.js";
import { centimetres, votesChart } from "./votes.js";

const LATE_MS = 8000; // longer than the server waits for map_update
const ACTIONS = {
  accept: { name: "Accept", title: "Publish this change", done: "Accepted: map_update publishes it in its next cycle." },
  reject: { name: "Reject", title: "Do not publish this change", done: "Rejected: it is not published while the votes give this height." },
  roll_back: { name: "Roll back", title: "Go back to the release before this change", done: "Rolled back: a new release has the corrections of the earlier one." },
};

export class ChangeDetail {
  constructor(store, facts) {
    Object.assign(this, { store, facts });
    this.box = element("section", { class: "chosen", hidden: true, tabIndex: -1, "aria-label": "The change that is looked at" });
    this.outcome = element("p", { role: "status" });
    this.decided = new Map(); // by kind and surface: what was decided here
  }

  // Shows a row of the list; null: none. A row that comes again with the same numbers stays as it is.
  show(kind, row) {
    const numbers = row ? JSON.stringify([kind, row, this.store.greeting?.review]) : "none";
    if (numbers === this.numbers) return;
    this.numbers = numbers;
    this.box.hidden = !row;
    if (!row) return;
    const other = this.surface !== row.surface_id;
    this.surface = row.surface_id;
    this.key = decisionKey(kind, row);
    setText(this.outcome, this.decided.get(this.key) ?? "");
    if (other) this.chart = element("div", {}, row.surface_id ? "Votes are being read." : "");
    this.box.replaceChildren(element("h3", {}, heading(kind, row)), element("dl", {}, ...this.facts(kind, row).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)])),
      this.chart, this.buttons(kind, row), this.outcome);
    if (other && row.surface_id) this.readVotes(row, this.chart);
  }

  async readVotes(row, chart) {
    try {
      const reply = await fetch(`votes/${row.surface_id}`), { days, left_out, reason } = await reply.json();
      chart.replaceChildren(days?.length ? votesChart(days, row.in_map_m ?? row.offset_m, left_out) : element("p", {}, reason ? `No votes: ${reason}` : left_out ? `Each day of votes (${left_out}) has only one or two vehicles: they are not shown.` : "No votes are kept."));
    } catch { chart.replaceChildren(element("p", {}, "No votes: camber live does not answer.")); }
  }

  buttons(kind, row) {
    const actions = { held: ["accept", "reject"], published: ["roll_back"] }[kind] ?? [];
    if (!actions.length) return element("p", {}, kind === "pending" ? "It waits for more votes; there is nothing to decide." : "");
    if (!this.store.greeting?.review) return element("p", {}, "Decide with camber map review, or start camber live with --review.");
    return element("div", { class: "actions" }, ...actions.map(action => element("button", { type: "button", disabled: this.decided.has(this.key), "data-action": action, onclick: () => this.ask(action, row) }, ACTIONS[action].name)));
  }

  ask(action, row) {
    const { key } = this, { name, title, done } = ACTIONS[action];
    const who = element("input", { name: "who", required: true, maxLength: 64, autocomplete: "name", value: rememberedName() });
    const why = element("textarea", { name: "why", required: true, maxLength: 400, rows: 3 });
    const problem = element("p", { class: "bad", role: "alert" }), send = element("button", { type: "submit" }, name);
    const dialog = element("dialog", { class: "decision" },
      element("form", { onsubmit: event => { event.preventDefault(); submit(); } },
        element("h2", {}, title), element("p", {}, question(action, row)),
        element("label", {}, "Who decides", who), element("label", {}, "Why", why), problem,
        element("div", { class: "actions" }, send, element("button", { type: "button", onclick: () => dialog.close() }, "Cancel"))));
    const submit = async () => {
      send.disabled = true;
      setText(problem, "");
      const reason = await this.send(action, row, { who: who.value, why: why.value });
      send.disabled = false;
      if (reason) { setText(problem, reason); return; }
      rememberName(who.value);
      this.decided.set(key, done);
      dialog.close();
      if (this.key === key) { setText(this.outcome, done); for (const button of this.box.querySelectorAll("[data-action]")) button.disabled = true; }
    };
    dialog.addEventListener("close", () => { dialog.remove(); this.box.focus(); });
    document.body.append(dialog); // and not in the box, which is made anew when the numbers change
    dialog.showModal();
    (who.value ? why : who).focus();
  }

  // Empty where it is recorded, else why not.
  async send(action, row, by) {
    const what = action === "roll_back" ? { map_version: String(BigInt(row.since_map_version) - 1n) } : { surface_id: row.surface_id, offset_m: row.offset_m };
    try {
      const reply = await fetch("decision", {
        method: "POST", headers: { "content-type": "application/json", "x-camber-review": this.store.greeting.review },
        body: JSON.stringify({ action, reference_sha256: row.reference_sha256, ...what, ...by }), signal: AbortSignal.timeout(LATE_MS),
      });
      return reply.ok ? "" : (await reply.json()).reason || `refused (${reply.status})`;
    } catch { return "camber live does not answer; look whether the decision is recorded before you repeat it"; }
  }
}

export const keyOf = (kind, row) => `${kind} ${row.surface_id ?? `${row.lat} ${row.lon}`}`;
const decisionKey = (kind, row) => `${keyOf(kind, row)} ${row.offset_m}`; // a decision is on a height

function heading(kind, row) {
  const state = { held: "held for review", pending: "pending", published: "published", alarm: "alarm" }[kind];
  return `${centimetres(row.offset_m ?? row.shift_m)}, ${state}`;
}

function question(action, row) {
  const road = `surface ${row.surface_id} of ${row.road}`;
  if (action === "roll_back") return `A new release gets the corrections of version ${row.since_map_version - 1}, for the whole fleet: it withdraws the change of ${road} and every one published since.`;
  return `The map has ${centimetres(row.in_map_m)} at ${road}, the votes give ${centimetres(row.offset_m)}: ${plain(row.reason)}.`;
}

const NAME = "camber-operator";
function rememberedName() { try { return localStorage.getItem(NAME) ?? ""; } catch { return ""; } }
function rememberName(name) { try { localStorage.setItem(NAME, name); } catch { /* it is typed again */ } }
