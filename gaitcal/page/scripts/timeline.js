"use strict";
// Strikes, toe-offs, stance and validity of each leg along time, and the slider that moves the clock.
Gaitcal.Timeline = class {
  constructor(page) {
    const get = (id) => document.getElementById(id);
    this.page = page;
    this.state = page.state;
    this.time = get("time");
    this.clock = get("clock");
    this.time.addEventListener("input", () => this.state.set({ seconds: Number(this.time.value) }));
    this.state.on(["result", "trial"], () => this.open());
    this.state.on(["seconds"], () => this.pose());
    this.open();
  }

  open() {
    this.time.max = String(this.page.trial.duration);
    this.pose();
  }

  pose() {
    const { seconds } = this.state;
    const words = `${(this.page.trial.start + seconds).toFixed(2)} s`;
    this.time.value = String(seconds);
    this.time.setAttribute("aria-valuetext", words);
    this.clock.textContent = words;
  }
};
