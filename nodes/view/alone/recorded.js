// A recording inside the page, in place of the server: a page of its own position in time, as
// ReplayPage of nodes/view/replay.py. The data stand in the element #recorded: base64 of zlib.
(() => {
  const HISTORY = 30.0, AHEAD = 30.0, PERIOD = 20; // [s], [s], [ms]
  const NOW = 22; // numbers of a scene
  const WHOLE = 4000; // bins that show all of it at once
  // Number of times up to a time.
  const until = (times, at) => {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= at) low = middle + 1; else high = middle;
    }
    return low;
  };

  const opened = async () => {
    const text = document.getElementById("recorded").textContent;
    const packed = await (await fetch(`data:application/octet-stream;base64,${text}`)).arrayBuffer();
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = await new Response(stream).arrayBuffer();
    const head = new DataView(bytes).getUint32(0, true);
    const found = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, head)));
    let at = Math.ceil((4 + head) / 8) * 8;
    const part = (Kind, count) => {
      const values = new Kind(bytes, at, count);
      at = Math.ceil((at + values.byteLength) / 8) * 8;
      return values;
    };
    const { scenes, bins, bodies } = found, series = found.hello.series.length;
    return {
      ...found,
      sceneTimes: part(Float64Array, scenes), sceneNow: part(Float64Array, scenes * NOW),
      binTimes: part(Float64Array, bins), low: part(Float32Array, bins * series),
      high: found.same ? null : part(Float32Array, bins * series),
      poses: bodies ? part(Float32Array, scenes * bodies * found.pose) : null,
    };
  };

  globalThis.WebSocket = class {
    static OPEN = 1;

    constructor() {
      Object.assign(this, { readyState: 0, bufferedAmount: 0, speed: 1, playing: true, first: -1, cursor: -1, isVoid: true, shown: NaN });
      opened().then((data) => this.begin(data), (error) => this.fail(error));
    }

    fail(error) {
      const notice = document.getElementById("notice");
      notice.textContent = `The recording in this file cannot be read: ${error.message}`;
      notice.hidden = false;
      throw error;
    }

    begin(data) {
      Object.assign(this, data, { series: data.hello.series.length, at: data.hello.begin_s, since: performance.now() });
      this.readyState = 1;
      this.onopen?.();
      this.say({ ...this.hello, opens: false });
      this.onmessage?.({ data: this.whole() });
      if (this.over) this.say(this.over);
      this.go(this.at);
      setInterval(() => this.news(), PERIOD);
    }

    say(document) { this.onmessage?.({ data: typeof document === "string" ? document : JSON.stringify(document) }); }

    // Jump to a time; bins already sent stay valid.
    go(at) {
      const { begin_s: begin, end_s: end } = this.hello;
      this.at = Math.min(Math.max(at, begin), end);
      this.since = performance.now();
      const here = until(this.binTimes, this.at);
      if (!(this.first <= here && here <= this.cursor)) {
        this.first = this.cursor = until(this.binTimes, this.at - HISTORY);
        this.isVoid = true;
      }
      Object.assign(this, { logged: 0, status: 0, law: 0 });
      this.say({ type: "reset" });
    }

    time() {
      const time = performance.now();
      if (this.playing) {
        this.at = Math.min(this.hello.end_s, this.at + ((time - this.since) / 1e3) * this.speed);
        this.playing = this.at < this.hello.end_s;
      }
      this.since = time;
      return this.at;
    }

    news() {
      const at = this.time(), logged = until(this.log.times, at);
      for (let n = this.logged; n < logged; n++) this.say(this.log.items[n]);
      const status = until(this.statuses.times, at), law = until(this.laws.times, at);
      if (status && status !== this.status) this.say(this.statuses.items[status - 1]);
      if (law && law !== this.law) {
        const { document, map } = this.laws.items[law - 1];
        this.say({ type: "laws", ...document });
        if (map) this.say({ type: "map", ...map });
      }
      Object.assign(this, { logged, status, law });
      const scene = until(this.sceneTimes, at);
      let end = until(this.binTimes, at + AHEAD);
      if (!scene || !(at !== this.shown || end > this.cursor || this.isVoid)) return;
      if (this.poses) {
        const { bodies, pose } = this, n = bodies * pose, from = (scene - 1) * n;
        const poses = Array.from({ length: bodies }, (_, i) => Array.from(this.poses.subarray(from + i * pose, from + (i + 1) * pose)));
        this.say({ type: "poses", poses });
      }
      end = Math.max(end, this.cursor);
      this.onmessage?.({ data: this.frame(scene - 1, this.cursor, end, at) });
      this.first = Math.max(this.first, until(this.binTimes, at - HISTORY));
      Object.assign(this, { cursor: end, isVoid: false, shown: at });
    }

    // All bins as at most WHOLE coarser ones, as Feed.overview of nodes/view/feed.py.
    whole() {
      const { binTimes, low, series: m } = this, high = this.high ?? low, bins = binTimes.length;
      const together = Math.max(1, Math.ceil(bins / WHOLE)), n = Math.ceil(bins / together);
      const buffer = new ArrayBuffer(16 + 8 * NOW + 8 * n + 8 * m * n), head = new DataView(buffer);
      [2, n, m, 1].forEach((value, i) => head.setUint32(4 * i, value, true));
      const times = new Float64Array(buffer, 16 + 8 * NOW, n), values = new Float32Array(buffer, 16 + 8 * NOW + 8 * n, 2 * m * n);
      values.fill(NaN);
      for (let k = 0; k < bins; k++) {
        const to = Math.floor(k / together);
        if (k % together === 0) times[to] = binTimes[k];
        for (let i = 0; i < m; i++) {
          const least = i * n + to, most = (m + i) * n + to, a = low[i * bins + k], b = high[i * bins + k];
          if (!(a >= values[least]) && !Number.isNaN(a)) values[least] = a;
          if (!(b <= values[most]) && !Number.isNaN(b)) values[most] = b;
        }
      }
      return buffer;
    }

    frame(scene, first, end, at) {
      const n = Math.max(0, end - first), m = this.series, bins = this.binTimes.length;
      const buffer = new ArrayBuffer(16 + 8 * NOW + 8 * n + 8 * m * n), head = new DataView(buffer);
      [1, n, m, this.isVoid ? 1 : 0].forEach((value, i) => head.setUint32(4 * i, value, true));
      const numbers = new Float64Array(buffer, 16, NOW);
      numbers.set(this.sceneNow.subarray(scene * NOW, (scene + 1) * NOW));
      numbers[0] = at;
      new Float64Array(buffer, 16 + 8 * NOW, n).set(this.binTimes.subarray(first, end));
      const values = new Float32Array(buffer, 16 + 8 * NOW + 8 * n, 2 * m * n);
      for (let i = 0; i < m; i++) {
        values.set(this.low.subarray(i * bins + first, i * bins + end), i * n);
        values.set((this.high ?? this.low).subarray(i * bins + first, i * bins + end), (m + i) * n);
      }
      return buffer;
    }

    send(text) {
      const { op, id, t, factor } = JSON.parse(text);
      if (op === "hand") return;
      this.time();
      let error = "";
      if (op === "play") {
        this.playing = true;
        if (this.at >= this.hello.end_s) this.go(this.hello.begin_s);
      } else if (op === "pause") this.playing = false;
      else if (op === "seek" && Number.isFinite(t)) this.go(t);
      else if (op === "speed" && factor > 0 && factor <= 100) this.speed = factor;
      else error = `${op} is refused: a recording can only play, pause, seek and change speed.`;
      this.say({ type: "answer", id, op, ok: error === "", result: { t: this.at, playing: this.playing }, error });
    }
  };
})();
