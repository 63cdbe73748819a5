// The page: one store, one view, components that draw them, keys.

import { connect, Store } from "./store.js";
import { View } from "./view.js";
import "./bar.js";
import "./map.js";
import "./charts.js";
import "./panels.js";
import "./stanford.js";
import "./sky.js";
import "./fleet.js";
import "./changes.js";
import { savePicture, saveTable } from "./exports.js";

const EVERY_MS = 100; // as often as batches come
const MARGIN_MS = 10; // batches and frames do not come at exact times
const SLOW_MS = 1000;

const store = new Store(), view = new View(store), find = name => document.querySelector(`camber-${name}`);
const map = find("map"), charts = find("charts"), fix = find("fix"), help = find("help");

function showTheme() {
  document.documentElement.dataset.theme = view.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  view.dispatchEvent(new Event("theme"));
}

function changeTheme() {
  view.theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  showTheme();
  view.change();
}

const actions = {
  picture: () => savePicture(store, view, map, charts), table: () => saveTable(store, view), theme: changeTheme, help: () => help.toggle(),
};

document.documentElement.dataset.theme = view.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
map.start(store, view);
charts.start(store, view);
find("bar").start(store, view, actions);
for (const name of ["fleet", "now", "fix", "health", "notes", "stanford", "sky", "changes"]) find(name).start(store, view, map);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", showTheme);
find("map").paint();

const keys = {
  " ": () => view.toggle(), ArrowLeft: event => view.move(event.shiftKey ? -60 : -1), ArrowRight: event => view.move(event.shiftKey ? 60 : 1),
  Home: () => view.move(-1e9), End: () => view.newest(), b: () => view.move(-600), "+": () => view.longer(-1), "=": () => view.longer(-1), "-": () => view.longer(1),
  w: () => fix.show(), f: () => map.setFollow(!view.follow), a: () => map.fit(), p: () => map.setPoints(!view.points), s: () => map.scan.toggle(), t: changeTheme, "?": () => help.toggle(), Escape: () => view.select(NaN),
};
addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input, textarea, dialog")) return;
  if (event.key === " " && event.target.closest("button")) return;
  const action = keys[event.key];
  if (!action || !Number.isFinite(view.end) && event.key !== "?") return;
  event.preventDefault();
  action(event);
});

let dirty = false, drawn = 0, slow = 0, before = performance.now(), whole = false;
store.addEventListener("rows", () => {
  dirty ||= view.running || !(store.earliest > view.end); // what is later than the time shown changes nothing
  store.arrived = Date.now() / 1000;
  showWhole();
  // At once, and not in the next frame: the map then draws in that frame what would come a frame later.
  if (view.live && view.running) update(performance.now());
});
store.addEventListener("status", showWhole);
store.addEventListener("greeting", () => { whole = false; });

// A recording is shown whole once it is here.
function showWhole() {
  if (whole || !store.complete || !Number.isFinite(store.newest)) return;
  whole = true;
  view.showAll();
  map.fitWhole();
}

function update(now) {
  const shown = view.end;
  view.tick((now - before) / 1000);
  before = now;
  dirty ||= view.end !== shown;
  if (!dirty || now - drawn < EVERY_MS - MARGIN_MS) return;
  dirty = false;
  drawn = now;
  view.dispatchEvent(new Event("view"));
}

function frame(now) {
  update(now);
  if (now - slow >= SLOW_MS) { slow = now; view.dispatchEvent(new Event("slow")); }
  requestAnimationFrame(frame);
}

requestAnimationFrame(frame);
connect(store);
window.camber = { store, view, map, charts };
