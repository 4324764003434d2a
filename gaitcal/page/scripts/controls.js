"use strict";
// Play, trial, speed, result, legend and presets: the controls that are always there.
Gaitcal.Controls = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    const { get } = Gaitcal;
    for (const [r, { name, scene }] of page.results.entries()) get("result").add(new Option(name || scene.subject, r));
    get("whose").hidden = page.results.length < 2;
    get("play").addEventListener("click", () => page.clock.play());
    get("open").addEventListener("click", () => this.legend(!get("main").classList.contains("open")));
    this.state.on(["result"], () => this.trials());
    this.state.on(["playing"], () => this.playing());
    this.measured();
    this.trials();
    this.playing();
  }

  // The body fills what header and footer leave of the window; how high these are follows from what is in them, and the
  // header leaves when the page is scrolled.
  measured() {
    const root = document.documentElement.style;
    const [top, controls] = ["top", "controls"].map(Gaitcal.get);
    let there = true;
    const write = () => {
      root.setProperty("--above", `${there ? top.offsetHeight : 0}px`);
      root.setProperty("--below", `${controls.offsetHeight}px`);
    };
    const heights = new ResizeObserver(write);
    for (const part of [top, controls]) heights.observe(part);
    new IntersectionObserver(([entry]) => {
      there = entry.isIntersecting;
      write();
    }).observe(top);
  }

  legend(open) {
    Gaitcal.get("main").classList.toggle("open", open);
    Gaitcal.get("open").setAttribute("aria-expanded", String(open));
  }

  trials() {
    Gaitcal.get("trial").replaceChildren(...this.page.result.trials.map(({ name }, i) => new Option(name, i)));
    Gaitcal.get("trial").value = String(this.state.trial);
  }

  playing() {
    const { playing } = this.state;
    Gaitcal.get("play").textContent = playing ? "\u275a\u275a" : "\u25b6";
    Gaitcal.get("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  }
};

// The presets as tabs.
Gaitcal.Presets = class {
  constructor(host, { state }) {
    this.state = state;
    this.names = Object.keys(Gaitcal.PRESETS);
    this.tabs = [...host.children];
    for (const [k, tab] of this.tabs.entries()) tab.addEventListener("click", () => state.set({ preset: this.names[k] }));
    host.addEventListener("keydown", (event) => this.moved(event));
    state.on(["preset"], () => this.write());
    this.write();
  }

  // Arrow keys go from tab to tab, and around.
  moved(event) {
    const here = this.tabs.indexOf(event.target);
    const last = this.tabs.length - 1;
    const there = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: last }[event.key];
    if (there === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    const tab = this.tabs[there < 0 ? last : there > last ? 0 : there];
    tab.focus();
    tab.click();
  }

  write() {
    const { preset } = this.state;
    for (const [k, tab] of this.tabs.entries()) {
      tab.setAttribute("aria-selected", String(this.names[k] === preset));
      tab.tabIndex = this.names[k] === preset ? 0 : -1;
    }
    Gaitcal.get("panel").setAttribute("aria-labelledby", `preset-${preset}`);
    Gaitcal.get("main").dataset.preset = preset;
    for (const id of ["switches", "curves", "steps"]) Gaitcal.get(id).hidden = preset !== "clinician";
  }
};
