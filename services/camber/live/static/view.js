// What is shown: until when, how long, whether time runs. The address's fragment restores it.

const SPANS = [60, 120, 300, 600, 1800, 3600, 21600];

export class View extends EventTarget {
  constructor(store) {
    super();
    this.store = store;
    this.span = 120;
    this.end = NaN;
    this.running = true;
    this.hover = NaN;
    this.selected = NaN;
    this.follow = true;
    this.place = null;
    this.theme = null;
    this.colour = "sigma";
    this.points = false;
    this.scan = false;
    this.level = "all";
    this.changeKey = ""; // change of the map that is looked at
    this.pinned = false; // the end came from the address
    this.restore();
  }

  get live() { return this.store.greeting?.mode === "bus"; }
  get shown() { return this.end; } // the time of what is shown of one time
  get begin() { return this.end - this.span; }

  restore() {
    const given = new URLSearchParams(location.hash.slice(1)), number = name => given.has(name) ? Number(given.get(name)) : NaN;
    if (number("span") > 0) this.span = Math.min(Math.max(number("span"), 2), 21600);
    if (Number.isFinite(number("t"))) { this.end = number("t"); this.running = false; this.pinned = true; }
    if (Number.isFinite(number("at"))) this.selected = number("at");
    if (given.get("follow") === "0") this.follow = false;
    if (given.get("points") === "1") this.points = true;
    if (given.get("scan") === "1") this.scan = true;
    if (["light", "dark"].includes(given.get("theme"))) this.theme = given.get("theme");
    if (["sigma", "day", "level"].includes(given.get("colour"))) this.colour = given.get("colour");
    if (/^-?\d{1,2}$/.test(given.get("level") || "")) this.level = given.get("level");
    const place = (given.get("map") || "").split("/").map(Number);
    if (place.length === 4 && place.every(Number.isFinite)) this.place = place;
  }

  save() {
    const parts = new URLSearchParams();
    parts.set("span", +this.span.toFixed(1));
    if (!this.running && Number.isFinite(this.end)) parts.set("t", this.end.toFixed(2));
    if (Number.isFinite(this.selected)) parts.set("at", this.selected.toFixed(3));
    if (!this.follow) parts.set("follow", "0");
    if (this.points) parts.set("points", "1");
    if (this.scan) parts.set("scan", "1");
    if (this.theme) parts.set("theme", this.theme);
    if (this.colour !== "sigma") parts.set("colour", this.colour);
    if (this.level !== "all") parts.set("level", this.level);
    if (this.place) parts.set("map", this.place.join("/"));
    const hash = "#" + decodeURIComponent(parts.toString());
    if (hash !== location.hash) history.replaceState(null, "", hash);
  }

  change(what = "view") {
    this.saving ??= setTimeout(() => { this.saving = null; this.save(); }, 400);
    this.dispatchEvent(new Event(what));
  }

  // Called for every frame: on the bus the newest row is the end, a recording runs by the clock.
  tick(seconds) {
    const newest = this.store.newest;
    if (!Number.isFinite(newest)) return;
    if (!Number.isFinite(this.end)) this.end = newest;
    if (!this.running) return;
    if (this.live) this.end = newest;
    else {
      this.end = Math.min(this.end + seconds, newest);
      if (this.end >= newest && this.store.complete) { this.running = false; this.change(); }
    }
  }

  // A recording that has just been read is shown whole.
  showAll() {
    if (this.pinned) return;
    this.end = this.store.newest;
    this.span = Math.min(Math.max(this.end - this.store.oldest, 10), 21600);
    this.running = false;
    this.change();
  }

  toggle() {
    this.running = !this.running;
    if (this.running && !this.live && this.end >= this.store.newest) { this.end = this.store.oldest; this.span = Math.min(this.span, 60); }
    this.change();
  }

  move(seconds) {
    this.running = false;
    this.end = Math.min(Math.max(this.end + seconds, this.store.oldest), this.store.newest);
    this.change();
  }

  newest() {
    this.end = this.store.newest;
    this.running = this.live;
    this.change();
  }

  longer(by) {
    const at = SPANS.findIndex(span => span >= this.span - .5);
    this.span = SPANS[Math.min(Math.max((at < 0 ? SPANS.length : at) + by, 0), SPANS.length - 1)];
    this.change();
  }

  range(begin, end) {
    this.running = false;
    this.end = end;
    this.span = Math.max(end - begin, .5);
    this.change();
  }

  select(time) {
    this.selected = time;
    if (Number.isFinite(time) && (time > this.end || time < this.begin)) {
      this.running = false;
      this.end = Math.min(time + this.span / 4, this.store.newest);
    }
    this.change("selection");
    this.change();
  }

  lookAt(key) {
    this.changeKey = key;
    this.change("change");
  }

  point(time) {
    if (Object.is(time, this.hover)) return;
    this.hover = time;
    this.dispatchEvent(new Event("hover"));
  }
}
