// Asks the server for what there is at the time shown; one question at a time, at most one a second while time runs.

export class SnapshotReader {
  constructor(store, view, kind) {
    Object.assign(this, { store, view, kind, asked: null, busy: false });
  }

  // Calls back with a Response, or null where there is nothing; not at all where nothing has changed.
  async read(answer) {
    const { store, view } = this;
    if (this.busy || !Number.isFinite(view.shown)) return;
    const key = `${store.generation}/${store.greeting?.title}/${view.running ? Math.floor(view.shown) : view.shown}/${store.complete}`;
    if (key === this.asked) return;
    this.busy = true;
    this.asked = key;
    try {
      await answer(await store.snapshot(this.kind, view.shown));
    } catch { this.asked = null; /* the server is gone: the bar says so */ }
    this.busy = false;
  }
}
