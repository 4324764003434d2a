"use strict";
// The one clock: it moves `state.seconds` on, and around the window that is looped.
Gaitcal.Clock = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    this.before = null;
    this.state.on(["playing"], () => this.start());
  }

  play(on = !this.state.playing) {
    this.state.set({ playing: on });
  }

  seek(seconds) {
    this.state.set({ seconds });
  }

  // Whole frames on, from the nearest.
  step(frames) {
    const { trial } = this.page;
    const at = trial.frame(this.state.seconds);
    const here = at.part > 0.5 ? at.high : at.low;
    const there = Math.min(trial.time.length - 1, Math.max(0, here + frames));
    this.state.set({ playing: false, seconds: trial.time[there] });
  }

  start() {
    if (!this.state.playing || this.before !== null) return;
    this.before = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    const { state } = this;
    if (!state.playing) {
      this.before = null;
      return;
    }
    const elapsed = Math.min(0.25, Math.max(0, now - this.before) / 1000);
    this.before = now;
    const [begin, end] = state.window ?? [0, this.page.trial.duration];
    const next = state.seconds + elapsed * state.speed;
    const inside = next >= begin && next <= end;
    state.set({ seconds: inside || end <= begin ? (end <= begin ? begin : next) : begin });
    requestAnimationFrame((later) => this.tick(later));
  }
};
