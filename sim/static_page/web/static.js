// A worker in place of the server: the page's one connection, without a network. NAMES and PACKED are
// written by the build. A worker from text works by http and from a file.
const chosen = new URLSearchParams(location.hash.slice(1)).get("scenario");
globalThis.staticPage = { names: NAMES, scenario: NAMES.includes(chosen) ? chosen : NAMES[0] };

// The text of a scenario's worker: its data, then the rules that all share.
const workerText = async (scenario) => {
  const bytes = Uint8Array.from(atob(PACKED), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const { arrays, texts } = await new Response(stream).json();
  return (texts[scenario] + texts[""]).replace(/\x01(\d+)\x01/g, (_, n) => arrays[n]);
};

globalThis.WebSocket = class {
  static OPEN = 1;

  constructor() {
    Object.assign(this, { readyState: 0, bufferedAmount: 0 });
    workerText(staticPage.scenario).then((text) => this.start(text), (error) => this.fail(error));
  }

  start(text) {
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

  // Browsers before 2023 cannot decompress.
  fail(error) {
    const notice = document.getElementById("notice");
    notice.textContent = `This browser cannot open the page's data; a newer one can. (${error.message})`;
    notice.hidden = false;
    throw error;
  }

  send(text) { this.worker.postMessage(text); }
};
