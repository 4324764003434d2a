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
    this.state = new Gaitcal.State(this.results);
    this.clock = new Gaitcal.Clock(this);
    this.bare = this.results.every(({ sheet }) => sheet === null);
    document.getElementById("main").classList.toggle("bare", this.bare);
    for (const part of document.querySelectorAll(".gait")) part.hidden = this.bare;
    this.address = new Gaitcal.Address(this);
    this.stage = new Gaitcal.Stage(this);
    this.timeline = new Gaitcal.Timeline(this);
    this.controls = new Gaitcal.Controls(this);
    this.keys = new Gaitcal.Keys(this);
    if (!this.bare) this.parts();
    this.state.on(["result", "trial"], () => this.titled());
    this.titled();
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.play(!still && !this.address.said.still);
  }

  // What a page of results has beside the body: each part is made with its place in the page and the page.
  parts() {
    const part = (Part, host) => Part && new Part(document.getElementById(host), this);
    this.presets = part(Gaitcal.Presets, "presets");
    this.switches = part(Gaitcal.Switches, "switches");
    this.verdict = part(Gaitcal.Verdict, "verdict");
    this.curves = part(Gaitcal.Curves, "curves");
    this.steps = part(Gaitcal.Steps, "steps");
    this.sections = part(Gaitcal.Sections, "sections");
    this.print = part(Gaitcal.Print, "print");
    // A joint that the address names is looked at once everything below has its place.
    requestAnimationFrame(() => this.curves.reveal(false));
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
    document.getElementById("subject").textContent = scene.subject;
  }

  // A few words on the shown trial.
  about() {
    const { trial, result } = this;
    const rate = ((trial.time.length - 1) / trial.duration) * trial.stride;
    const frames = `${Gaitcal.group(trial.recorded)} frame${trial.recorded === 1 ? "" : "s"}`;
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

  play(on) {
    this.clock.play(on);
  }

  seek(seconds) {
    this.clock.seek(seconds);
  }

  get seconds() {
    return this.state.seconds;
  }

  get playing() {
    return this.state.playing;
  }

  get speed() {
    return this.state.speed;
  }

  get person() {
    return this.stage.figure.place;
  }

  get body() {
    return this.stage.figure.body;
  }
};

Gaitcal.group = (n) => String(n).replace(/\B(?=(\d{3})+$)/g, "\u202f");

Gaitcal.ordinal = (n) => {
  const last = n % 100;
  const ending = last > 10 && last < 14 ? "th" : { 1: "st", 2: "nd", 3: "rd" }[n % 10] ?? "th";
  return n === 2 ? "second" : n === 3 ? "third" : `${n}${ending}`;
};

(() => {
  const failure = document.getElementById("failure");
  try {
    window.gaitcal = new Gaitcal.Page(JSON.parse(document.getElementById("results").textContent));
  } catch (error) {
    failure.hidden = false;
    failure.textContent = `This page could not be drawn (${error.message}). It needs a browser with WebGL.`;
    throw error;
  }
})();
