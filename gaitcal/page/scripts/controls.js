"use strict";
// Play, trial, speed, result and legend: the controls that are always there.
Gaitcal.Controls = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    const get = (id) => document.getElementById(id);
    this.get = get;
    for (const [r, { name, scene }] of page.results.entries()) get("result").add(new Option(name || scene.subject, String(r)));
    get("whose").hidden = page.results.length < 2;
    get("result").addEventListener("change", () => this.state.set({ result: Number(get("result").value) }));
    get("trial").addEventListener("change", () => this.state.set({ trial: Number(get("trial").value) }));
    get("speed").addEventListener("change", () => this.state.set({ speed: Number(get("speed").value) }));
    get("play").addEventListener("click", () => page.clock.play());
    get("open").addEventListener("click", () => this.legend(!get("main").classList.contains("open")));
    this.state.on(["playing"], () => this.playing());
    this.state.on(["speed"], () => (get("speed").value = String(this.state.speed)));
    this.state.on(["result"], () => this.trials());
    this.state.on(["result", "trial"], () => this.chosen());
    this.measured();
    this.trials();
    this.chosen();
    this.playing();
    get("speed").value = String(this.state.speed);
  }

  // The body fills what header and footer leave of the window; how high these are follows from what is in them.
  measured() {
    const root = document.documentElement.style;
    const heights = new ResizeObserver(() => {
      root.setProperty("--above", `${this.get("top").offsetHeight}px`);
      root.setProperty("--below", `${this.get("controls").offsetHeight}px`);
    });
    for (const id of ["top", "controls"]) heights.observe(this.get(id));
  }

  legend(open) {
    this.get("main").classList.toggle("open", open);
    this.get("open").setAttribute("aria-expanded", String(open));
  }

  playing() {
    this.get("play").textContent = this.state.playing ? "\u275a\u275a" : "\u25b6";
    this.get("play").setAttribute("aria-label", this.state.playing ? "Pause" : "Play");
  }

  trials() {
    this.get("trial").replaceChildren(...this.page.result.trials.map(({ name }, i) => new Option(name, String(i))));
  }

  chosen() {
    this.get("trial").value = String(this.state.trial);
    this.get("result").value = String(this.state.result);
  }
};
