"use strict";
// Everything together: results, what is chosen of them, and all that draws.
Gaitcal.Page = class {
  constructor(results) {
    const alike = results.length > 1 && results[0].name === results[1].name;
    this.results = results.map((result, i) => ({
      ...result,
      name: alike ? `${result.name || result.scene.subject} (${i + 1})` : result.name,
      trials: result.scene.trials.map((packed) => new Gaitcal.Trial(packed, result.scene)),
    }));
    this.bare = this.results.every(({ sheet }) => sheet === null);
    Gaitcal.get("main").classList.toggle("bare", this.bare);
    for (const part of document.querySelectorAll(".gait")) part.hidden = this.bare;
    this.state = new Gaitcal.State(this.results);
    this.clock = new Gaitcal.Clock(this);
    this.stage = new Gaitcal.Stage(this);
    this.timeline = new Gaitcal.Timeline(this);
    this.controls = new Gaitcal.Controls(this);
    this.keys = new Gaitcal.Keys(this);
    // What a page of results has beside the body: each part is made with its place in the page and the page.
    for (const name of this.bare ? [] : ["Presets", "Switches", "Verdict", "Curves", "Steps", "Sections", "Print"]) {
      const id = name.toLowerCase();
      this[id] = new Gaitcal[name](Gaitcal.get(id), this);
    }
    Gaitcal.bind(this.state);
    // A joint that the address names is looked at once everything below has its place.
    if (!this.bare) requestAnimationFrame(() => this.curves.reveal(false));
    this.state.on(["result", "trial"], () => this.titled());
    this.titled();
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.clock.play(!still && !this.state.still);
  }

  get result() {
    return this.results[this.state.result];
  }

  get trial() {
    return this.result.trials[this.state.trial].open();
  }

  // The curves and tables of the shown trial; null on a page of a bare scene.
  get sheet() {
    return this.result.sheet?.trials[this.state.trial] ?? null;
  }

  titled() {
    const { scene } = this.result;
    document.title = `${scene.subject} \u00b7 ${this.trial.name}`;
    Gaitcal.get("subject").textContent = scene.subject;
  }

  // A few words on the shown trial.
  about() {
    const { trial, result } = this;
    const rate = ((trial.time.length - 1) / trial.duration) * trial.stride;
    const frames = `${Gaitcal.numeral(trial.recorded, 0)} frame${trial.recorded === 1 ? "" : "s"}`;
    const lines = [
      `${trial.name} \u00b7 ${frames}${Number.isFinite(rate) ? ` at ${Math.round(rate)} Hz` : ""}`,
      `${result.scene.mass.toFixed(1)} kg, ${result.scene.height.toFixed(2)} m`,
    ];
    if (trial.start > 0.005) lines.push(`begins at ${trial.start.toFixed(2)} s of the recording`);
    if (trial.stride > 1) {
      lines.push(`every ${Gaitcal.ordinal(trial.stride)} frame is in this page; poses between are interpolated`);
    }
    return lines.join("\n");
  }
};

Gaitcal.ordinal = (n) => {
  const last = n % 100;
  const ending = last > 10 && last < 14 ? "th" : { 1: "st", 2: "nd", 3: "rd" }[n % 10] ?? "th";
  return n === 2 ? "second" : n === 3 ? "third" : `${n}${ending}`;
};

(() => {
  const failure = Gaitcal.get("failure");
  try {
    window.gaitcal = new Gaitcal.Page(JSON.parse(Gaitcal.get("results").textContent));
  } catch (error) {
    failure.hidden = false;
    failure.textContent = `This page could not be drawn (${error.message}). It needs a browser with WebGL.`;
    throw error;
  }
})();
