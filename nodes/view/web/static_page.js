// What a page without a server has beside the others: a banner, the session as Python, scenarios.
export class StaticPage {
  constructor(places, ask) {
    Object.assign(this, places, { ask });
    this.python.addEventListener("click", () => this.copy());
    this.restart.addEventListener("click", () => ask({ op: "restart" }));
    this.scenarios.addEventListener("change", () => {
      location.hash = `scenario=${encodeURIComponent(this.scenarios.value)}`;
      location.reload();
    });
  }

  get names() { return globalThis.staticPage?.names ?? []; }

  // The scenario for a link; empty if there is only one.
  get scenario() { return this.names.length > 1 ? globalThis.staticPage.scenario : ""; }

  start() {
    this.banner.hidden = this.names.length === 0;
    const several = this.names.length > 1;
    this.scenarios.hidden = !several;
    this.title.hidden = several;
    this.scenarios.replaceChildren(...this.names.map((name) => new Option(name, name, false, name === this.scenario)));
  }

  async copy() {
    const answer = await this.ask({ op: "python" });
    if (!answer.ok) return;
    this.text = answer.result.text;
    await navigator.clipboard?.writeText(this.text).catch(() => {});
    this.python.textContent = "Copied";
    setTimeout(() => { this.python.textContent = "Copy as haptic.play"; }, 1500);
  }
}
