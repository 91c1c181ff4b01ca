// The WebSocket: bins and documents in, requests out. It reconnects; nothing is queued while
// offline.
const HEAD = 16 + 22 * 8;
const NOW = ["t", "position", "proxy", "normal", "asked", "force", "target", "distance", "contact", "delay"];
const VECTORS = new Set(["position", "proxy", "normal", "asked", "force", "target"]);

export class Link {
  constructor(handlers) {
    this.handlers = handlers;
    this.waiting = new Map();
    this.number = 0;
    this.pause = 250;
    // Time of the last message.
    this.heard = -Infinity;
    this.connect();
  }

  connect() {
    const url = new URL("live", location.href);
    url.protocol = "ws:";
    const socket = this.socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { this.pause = 250; this.handlers.open(); };
    socket.onmessage = ({ data }) => {
      this.heard = performance.now();
      if (typeof data === "string") this.text(JSON.parse(data));
      // A frame of the second kind has the whole of a recording.
      else this.handlers[new DataView(data).getUint32(0, true) === 2 ? "whole" : "frame"](decode(data));
    };
    socket.onclose = () => {
      for (const settle of this.waiting.values()) settle({ ok: false, error: "The connection was lost before the answer came." });
      this.waiting.clear();
      this.handlers.close();
      // Reconnect even after the end: a restarted view has the same address.
      setTimeout(() => this.connect(), this.pause);
      this.pause = Math.min(2000, this.pause * 1.6);
    };
  }

  get open() { return this.socket.readyState === WebSocket.OPEN; }

  text(message) {
    if (message.type === "answer" && this.waiting.has(message.id)) {
      this.waiting.get(message.id)(message);
      this.waiting.delete(message.id);
    } else {
      this.handlers[message.type]?.(message);
    }
  }

  // Send a request; resolves to {ok, result, error}.
  ask(request) {
    if (!this.open) return Promise.resolve({ ok: false, error: "There is no connection to the run." });
    const id = ++this.number;
    return new Promise((settle) => {
      this.waiting.set(id, settle);
      this.socket.send(JSON.stringify({ ...request, id }));
    });
  }

  // Tell that the first picture is drawn, for which the server puts off heavy work.
  drawn() { if (this.open) this.socket.send(JSON.stringify({ op: "drawn" })); }

  // Send bytes, once less than `most` of those before are waiting.
  async bytes(buffer, most) {
    while (this.open && this.socket.bufferedAmount > most) await new Promise((settle) => setTimeout(settle, 10));
    if (!this.open) throw new Error("The connection was lost.");
    this.socket.send(buffer);
  }

  // Send the hand's target: only the newest counts, so without an answer, and not into a full
  // buffer.
  hand(target) {
    if (this.open && (target === null || this.socket.bufferedAmount < 4096)) this.socket.send(JSON.stringify({ op: "hand", target }));
  }
}

function decode(buffer) {
  const head = new DataView(buffer);
  const count = head.getUint32(4, true), series = head.getUint32(8, true);
  const numbers = new Float64Array(buffer, 16, 22);
  const now = {};
  let at = 0;
  for (const name of NOW) {
    now[name] = VECTORS.has(name) ? numbers.slice(at, at + 3) : numbers[at];
    at += VECTORS.has(name) ? 3 : 1;
  }
  const values = new Float32Array(buffer, HEAD + 8 * count, 2 * series * count);
  return {
    now, count, void: head.getUint32(12, true) === 1,
    times: new Float64Array(buffer, HEAD, count),
    low: (i) => values.subarray(i * count, (i + 1) * count),
    high: (i) => values.subarray((series + i) * count, (series + i + 1) * count),
  };
}
