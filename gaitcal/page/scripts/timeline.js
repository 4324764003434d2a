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
    state.set({ seconds: next >= begin && next <= end ? next : begin });
    requestAnimationFrame((later) => this.tick(later));
  }
};

// px: a pointer that moved less has pressed, not dragged.
Gaitcal.DRAGGED = 5;

// Strikes, toe-offs, stance and validity of each leg along time; the slider that moves the clock; the window it loops.
Gaitcal.Timeline = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    this.time = Gaitcal.get("time");
    this.tracks = Gaitcal.get("tracks");
    this.time.addEventListener("input", () => this.state.set({ seconds: Number(this.time.value) }));
    this.dragged();
    Gaitcal.get("window-begin").addEventListener("click", () => this.begin());
    Gaitcal.get("window-end").addEventListener("click", () => this.end());
    Gaitcal.get("window-clear").addEventListener("click", () => this.state.set({ window: null }));
    this.state.on(["result", "trial"], () => this.open());
    this.state.on(["seconds"], () => this.pose());
    this.state.on(["window"], () => this.windowed());
    this.open();
  }

  begin() {
    const { seconds, window } = this.state;
    this.choose(seconds, window && window[1] > seconds ? window[1] : this.page.trial.duration);
  }

  end() {
    const { seconds, window } = this.state;
    this.choose(window && window[0] < seconds ? window[0] : 0, seconds);
  }

  // Loop from one time to another; nothing where they are one.
  choose(from, to) {
    const [begin, end] = [Math.min(from, to), Math.max(from, to)];
    if (end - begin < 1e-3) return;
    this.state.set({ window: [begin, end], seconds: Math.min(end, Math.max(begin, this.state.seconds)) });
  }

  // A drag over the rows chooses a window, a click moves the clock.
  dragged() {
    let from = null;
    const at = (event) => {
      const box = Gaitcal.get("track-r").getBoundingClientRect();
      return Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) * this.page.trial.duration;
    };
    const far = (event) => Math.abs(event.clientX - from.x) >= Gaitcal.DRAGGED;
    Gaitcal.dress(this.tracks, {
      pointerdown: (event) => {
        if (event.button > 0) return;
        from = { x: event.clientX, seconds: at(event) };
        this.tracks.setPointerCapture(event.pointerId);
      },
      pointermove: (event) => from && far(event) && this.choose(from.seconds, at(event)),
      pointerup: (event) => {
        if (from && !far(event)) this.state.set({ seconds: from.seconds });
        from = null;
      },
      pointercancel: () => {
        from = null;
      },
    });
  }

  // Places are shares of the trial, so that no change of width needs another drawing.
  share(seconds) {
    return `${((100 * seconds) / (this.page.trial.duration || 1)).toFixed(3)}%`;
  }

  open() {
    const { trial, sheet } = this.page;
    this.time.max = String(trial.duration);
    for (const side of ["r", "l"]) {
      const events = (sheet?.events ?? []).filter((event) => event.side === side);
      const valid = trial.validSpans(side);
      const track = Gaitcal.get(`track-${side}`);
      this.draw(track, side, events, valid);
      track.parentElement.hidden = events.length === 0 && valid.length === 0;
    }
    this.windowed();
    this.pose();
  }

  draw(track, side, events, valid) {
    const { sheet, trial } = this.page;
    const x = (seconds) => this.share(seconds);
    const bar = (kind, [from, to], y, height) => svg(`rect.${kind}`, { x: x(from), width: x(to - from), y, height });
    const mark = ({ kind, time }) =>
      Gaitcal.isStrike(kind)
        ? svg("line.strike", { x1: x(time), x2: x(time), y1: 0, y2: 12 })
        : svg("circle.off", { cx: x(time), cy: 7, r: 3 });
    track.replaceChildren(
      bar("window", [0, 0], 0, 16),
      ...Gaitcal.stances(sheet, side, trial.duration).map((span) => bar("stance", span, 4, 6)),
      ...valid.map((span) => bar("valid", span, 13, 2.5)),
      ...events.map(mark),
      svg("line.now", { x1: 0, x2: 0, y1: 0, y2: 16 }),
    );
    const said = (what, when) => (when.length ? [`${what} ${when.join(", ")}`] : []);
    const times = (strike) =>
      events.filter(({ kind }) => Gaitcal.isStrike(kind) === strike).map(({ time }) => `${time.toFixed(2)} s`);
    const words = [
      ...said("foot strikes at", times(true)),
      ...said("foot off at", times(false)),
      ...said("torques valid", valid.map(([from, to]) => `${from.toFixed(2)} to ${to.toFixed(2)} s`)),
    ];
    track.setAttribute("aria-label", `${Gaitcal.LEGS[side]} leg: ${words.join("; ") || "no events"}`);
  }

  windowed() {
    const { window } = this.state;
    const [from, to] = window ?? [0, 0];
    for (const bar of this.tracks.querySelectorAll(".window")) {
      Gaitcal.dress(bar, { x: this.share(from), width: this.share(to - from) });
    }
    Gaitcal.get("looped").textContent = window ? `${from.toFixed(2)} – ${to.toFixed(2)} s` : "";
    Gaitcal.get("window-clear").disabled = window === null;
  }

  pose() {
    const { seconds } = this.state;
    const words = `${seconds.toFixed(2)} s`;
    this.time.value = String(seconds);
    this.time.setAttribute("aria-valuetext", words);
    Gaitcal.get("clock").textContent = words;
    const x = this.share(seconds);
    for (const line of this.tracks.querySelectorAll(".now")) Gaitcal.dress(line, { x1: x, x2: x });
  }
};

Gaitcal.isStrike = (kind) => kind.endsWith("strike");

// When a foot stands, [from, to] in s, as gaitcal/gait/cycles.py: from strike to toe-off, and from the begin or to the
// end where one was not seen.
Gaitcal.stances = (sheet, side, duration) => {
  const events = (sheet?.events ?? []).filter((event) => event.side === side).sort((a, b) => a.time - b.time);
  if (events.length === 0) return [];
  const spans = [];
  let from = Gaitcal.isStrike(events[0].kind) ? null : 0;
  for (const { kind, time } of events) {
    if (Gaitcal.isStrike(kind)) from ??= time;
    else if (from !== null) {
      spans.push([from, time]);
      from = null;
    }
  }
  return from === null ? spans : [...spans, [from, duration]];
};
