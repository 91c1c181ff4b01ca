// A worker in place of the server: the page's one connection, without a network. SCENARIOS and WORKER
// are written by the build. A worker from text works by http and from a file.
const NAMES = Object.keys(SCENARIOS);
const chosen = new URLSearchParams(location.hash.slice(1)).get("scenario");
globalThis.staticPage = { names: NAMES, scenario: NAMES.includes(chosen) ? chosen : NAMES[0] };
globalThis.WebSocket = class {
  static OPEN = 1;

  constructor() {
    Object.assign(this, { readyState: 0, bufferedAmount: 0 });
    const text = SCENARIOS[staticPage.scenario] + WORKER;
    const url = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    this.worker = new Worker(url);
    this.worker.onmessage = ({ data }) => {
      if (this.readyState === 0) {
        this.readyState = 1;
        this.onopen?.();
      }
      this.onmessage?.({ data });
    };
    this.worker.onerror = ({ message, lineno }) => { console.error(`worker: ${message}, line ${lineno}`); };
  }

  send(text) { this.worker.postMessage(text); }
};
