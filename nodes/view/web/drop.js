// Recordings that are dropped on the page, or chosen: sent to the page's own server, which reads them.
const CHUNK = 1 << 17, WAITING = 1 << 20; // [bytes]

export class Drop {
  // `link` carries the file; `tell` shows a sentence.
  constructor({ input, button }, link, tell) {
    Object.assign(this, { input, button, link, tell, opens: false, busy: false });
    addEventListener("dragover", (event) => { if (this.holds(event)) event.preventDefault(); });
    addEventListener("drop", (event) => {
      const [file] = event.dataTransfer?.files ?? [];
      // A page of ours is opened by the browser itself.
      if (!file || /\.html?$/i.test(file.name)) return;
      event.preventDefault();
      this.open(file, event.shiftKey);
    });
    button.addEventListener("click", () => input.click());
    input.addEventListener("change", () => {
      const [file] = input.files;
      if (file) this.open(file, false);
      input.value = "";
    });
  }

  start(hello) {
    this.opens = hello.opens === true;
    this.button.hidden = !this.opens || !hello.replay;
  }

  holds(event) { return [...(event.dataTransfer?.types ?? [])].includes("Files"); }

  // Open a recording; with `over`, draw it over the one that is shown.
  async open(file, over) {
    if (!this.opens) {
      this.tell(`This page has no server that could read ${file.name}. In a terminal: haptic view --replay ${file.name}; or haptic bag export ${file.name} --format html, which makes a page of it.`);
      return;
    }
    if (this.busy) return;
    this.busy = true;
    try {
      const begun = await this.link.ask({ op: "open", name: file.name, size: file.size, over });
      if (!begun.ok) throw new Error(begun.error);
      for (let at = 0; at < file.size; at += CHUNK) {
        await this.link.bytes(await file.slice(at, at + CHUNK).arrayBuffer(), WAITING);
        this.tell(`${file.name}: ${Math.round((100 * Math.min(file.size, at + CHUNK)) / file.size)} % sent …`);
      }
      const opened = await this.link.ask({ op: "opened" });
      if (!opened.ok) throw new Error(opened.error);
      if (over) this.tell("");
    } catch (error) {
      this.tell(error.message);
    } finally {
      this.busy = false;
    }
  }
}
