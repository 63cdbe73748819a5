// Columns of what was published, as the server sends them: the newest rows of each table.

const MOST_ROWS = 216000; // six hours at 10 Hz, as the server keeps of a recording

export class Table {
  constructor(name, exact, rest) {
    this.name = name;
    this.columns = [...exact, ...rest];
    this.exact = exact.length;
    this.clear();
  }

  clear() {
    this.first = 0; // number of the row at index 0, as the server counts
    this.length = 0;
    this.capacity = 0;
    this.changes = (this.changes || 0) + 1; // grows when earlier rows moved or went
    this.arrays = Object.fromEntries(this.columns.map((name, k) => [name, k < this.exact ? new Float64Array(0) : new Float32Array(0)]));
  }

  append(first, rows, columns) {
    if (first !== this.first + this.length) {
      // Rows went out of the server's ring before they were sent: what is here stays, the gap is a gap in time.
      if (this.length === 0) this.first = first;
      else this.first = first - this.length;
    }
    this.reserve(this.length + rows);
    this.columns.forEach((name, k) => this.arrays[name].set(columns[k], this.length));
    this.length += rows;
    if (this.length > MOST_ROWS) this.drop(this.length - MOST_ROWS + MOST_ROWS / 8);
  }

  reserve(rows) {
    if (rows <= this.capacity) return;
    this.capacity = Math.max(4096, 2 ** Math.ceil(Math.log2(rows)));
    for (const name of this.columns) {
      const grown = new this.arrays[name].constructor(this.capacity);
      grown.set(this.arrays[name].subarray(0, this.length));
      this.arrays[name] = grown;
    }
  }

  drop(rows) {
    for (const name of this.columns) this.arrays[name].copyWithin(0, rows, this.length);
    this.length -= rows;
    this.first += rows;
    this.changes += 1;
  }

  // Index of the last row at or before a time, −1: none.
  at(time) {
    let low = 0, high = this.length;
    const t = this.arrays.t;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle + 1; else high = middle;
    }
    return low - 1;
  }

  get last() { return this.length ? this.arrays.t[this.length - 1] : NaN; }
  get begin() { return this.length ? this.arrays.t[0] : NaN; }
}

export class Store extends EventTarget {
  constructor() {
    super();
    this.tables = {};
    this.words = {};
    this.generation = 0;
    this.greeting = null;
    this.status = null;
    this.fleet = [];
    this.changes = null; // of the map, by the fleet
  }

  greet(greeting) {
    this.greeting = greeting;
    this.words = greeting.terms;
    this.tables = Object.fromEntries(Object.entries(greeting.columns).map(([name, { exact, rest }]) => [name, new Table(name, exact, rest)]));
    this.dispatchEvent(new Event("greeting"));
  }

  take(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    if (header.generation !== this.generation) {
      this.generation = header.generation;
      for (const table of Object.values(this.tables)) table.clear();
    }
    let offset = 4 + length;
    this.earliest = Infinity; // time of the first row of this batch
    for (const { name, first, rows } of header.tables) {
      const table = this.tables[name], columns = [];
      table.columns.forEach((_, k) => {
        if (k === table.exact) offset += -offset & 7;
        const array = k < table.exact ? new Float64Array(buffer, offset, rows) : new Float32Array(buffer, offset, rows);
        columns.push(array);
        offset += array.byteLength;
      });
      offset += -offset & 7;
      this.earliest = Math.min(this.earliest, columns[0][0]);
      table.append(first, rows, columns);
    }
    this.dispatchEvent(new Event("rows"));
  }

  get newest() { return Math.max(...["verdict", "position", "fix", "pose"].map(name => this.tables[name]?.last).filter(Number.isFinite)); }
  get oldest() { return Math.min(...["verdict", "position", "fix", "pose"].map(name => this.tables[name]?.begin).filter(Number.isFinite)); }

  // Whether a recording has been read and all of it is here.
  get complete() { return Boolean(this.status?.rows) && Object.values(this.tables).every((table, k) => table.first + table.length >= this.status.rows[k]); }

  // The judge's own text of a verdict, by the number of its row.
  async detail(row) {
    try {
      const reply = await fetch(`verdict/${this.generation}/${row}`);
      return reply.ok ? (await reply.json()).detail ?? "" : "";
    } catch { return ""; /* the server is gone: the bar says so */ }
  }

  // What the server has of a kind at a time, as a Response; null where there is nothing.
  async snapshot(kind, time) {
    const reply = await fetch(`snapshot/${kind}/${time.toFixed(3)}`);
    return reply.status === 200 ? reply : null;
  }

  word(list, place) { return Number.isFinite(place) ? this.words[list]?.[place] ?? "" : ""; }
}

// Reads until the page is closed; tries again where the server is gone.
export function connect(store) {
  const address = new URL("stream", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  address.hash = "";
  address.search = "";
  const socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") { store.take(data); return; }
    const message = JSON.parse(data);
    if (message.kind === "greeting") { store.connected = true; store.greet(message); }
    else if (message.kind === "fleet") { store.fleet = message.vehicles; store.dispatchEvent(new Event("fleet")); }
    else if (message.kind === "changes") { store.changes = message.changes; store.dispatchEvent(new Event("changes")); }
    else { store.status = message; store.dispatchEvent(new Event("status")); }
  };
  socket.onclose = () => {
    store.connected = false;
    store.dispatchEvent(new Event("status"));
    setTimeout(() => connect(store), 1000);
  };
}
