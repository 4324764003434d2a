"use strict";
// Strikes, toe-offs, stance and validity of each leg along time; the slider that moves the clock; the window it loops.
Gaitcal.Timeline = class {
  constructor(page) {
    const get = (id) => document.getElementById(id);
    this.page = page;
    this.state = page.state;
    this.time = get("time");
    this.clock = get("clock");
    this.looped = get("looped");
    this.tracks = ["r", "l"].map((side) => ({ side, svg: get(`track-${side}`) }));
    this.time.addEventListener("input", () => this.state.set({ seconds: Number(this.time.value) }));
    this.dragged(get("tracks"));
    get("window-begin").addEventListener("click", () => this.begin());
    get("window-end").addEventListener("click", () => this.end());
    get("window-clear").addEventListener("click", () => this.state.set({ window: null }));
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
    const { duration } = this.page.trial;
    const [begin, end] = [Math.min(from, to), Math.max(from, to)].map((t) => Math.min(duration, Math.max(0, t)));
    if (end - begin < 1e-3) return;
    const { seconds } = this.state;
    this.state.set({ window: [begin, end], seconds: Math.min(end, Math.max(begin, seconds)) });
  }

  // A drag over the rows chooses a window, a click moves the clock.
  dragged(host) {
    let from = null;
    const at = (event) => {
      const box = this.tracks[0].svg.getBoundingClientRect();
      return (Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) * this.page.trial.duration);
    };
    const DRAG = 5; // pixels
    host.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      from = { x: event.clientX, seconds: at(event) };
      host.setPointerCapture(event.pointerId);
    });
    host.addEventListener("pointermove", (event) => {
      if (from && Math.abs(event.clientX - from.x) >= DRAG) this.choose(from.seconds, at(event));
    });
    host.addEventListener("pointerup", (event) => {
      if (from && Math.abs(event.clientX - from.x) < DRAG) this.state.set({ seconds: from.seconds });
      from = null;
    });
    host.addEventListener("pointercancel", () => (from = null));
  }

  open() {
    const { trial, sheet } = this.page;
    this.time.max = String(trial.duration);
    for (const { side, svg } of this.tracks) {
      const row = { side, stances: Gaitcal.stances(sheet, side, trial.duration), valid: Gaitcal.validSpans(trial, side) };
      row.events = (sheet?.events ?? []).filter((event) => event.side === side);
      this.draw(svg, row);
      svg.parentElement.hidden = row.events.length === 0 && row.valid.length === 0;
    }
    this.windowed();
    this.pose();
  }

  // Places are shares of the trial, so that no change of width needs another drawing.
  draw(svg, { side, stances, valid, events }) {
    const { duration } = this.page.trial;
    const share = (seconds) => `${((100 * seconds) / (duration || 1)).toFixed(3)}%`;
    const add = (name, kind, attributes) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", name);
      element.setAttribute("class", kind);
      for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
      svg.append(element);
      return element;
    };
    const bar = (kind, [from, to], y, height) => add("rect", kind, { x: share(from), width: share(to - from), y, height });
    svg.replaceChildren();
    bar("window", [0, 0], 0, 16);
    for (const span of stances) bar("stance", span, 4, 6);
    for (const span of valid) bar("valid", span, 13, 2.5);
    for (const { kind, time } of events) {
      if (Gaitcal.isStrike(kind)) add("line", "strike", { x1: share(time), x2: share(time), y1: 0, y2: 12 });
      else add("circle", "off", { cx: share(time), cy: 7, r: 3 });
    }
    add("line", "now", { x1: 0, x2: 0, y1: 0, y2: 16 });
    const among = (strike) => events.filter(({ kind }) => Gaitcal.isStrike(kind) === strike);
    const list = (strike) => among(strike).map(({ time }) => `${time.toFixed(2)} s`);
    const said = (what, when) => (when.length ? [`${what} ${when.join(", ")}`] : []);
    const spans = valid.map(([from, to]) => `${from.toFixed(2)} to ${to.toFixed(2)} s`);
    const steps = [...said("foot strikes at", list(true)), ...said("foot off at", list(false))];
    const words = [...steps, ...said("torques valid", spans)];
    svg.setAttribute("aria-label", `${Gaitcal.SIDES[side]} leg: ${words.join("; ") || "no events"}`);
  }

  windowed() {
    const { window } = this.state;
    const { duration } = this.page.trial;
    const [from, to] = window ?? [0, 0];
    for (const { svg } of this.tracks) {
      const rect = svg.querySelector(".window");
      rect.setAttribute("x", `${(100 * from) / (duration || 1)}%`);
      rect.setAttribute("width", `${(100 * (to - from)) / (duration || 1)}%`);
    }
    this.looped.textContent = window ? `${from.toFixed(2)} \u2013 ${to.toFixed(2)} s` : "";
    document.getElementById("window-clear").disabled = window === null;
  }

  pose() {
    const { seconds } = this.state;
    const { trial } = this.page;
    const words = `${seconds.toFixed(2)} s`;
    this.time.value = String(seconds);
    this.time.setAttribute("aria-valuetext", words);
    this.clock.textContent = words;
    const x = `${((100 * seconds) / (trial.duration || 1)).toFixed(3)}%`;
    for (const { svg } of this.tracks) {
      svg.lastChild.setAttribute("x1", x);
      svg.lastChild.setAttribute("x2", x);
    }
  }
};

Gaitcal.isStrike = (kind) => kind.endsWith("strike");

// When a foot stands, [from, to] in s: from strike to toe-off, and from the begin or to the end where one was not seen.
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

// When torques of a leg are valid, [from, to] in s.
Gaitcal.validSpans = (trial, side) => {
  const { time, validLegs } = trial;
  const leg = side === "r" ? 0 : 1;
  const spans = [];
  let from = null;
  for (let i = 0; i < time.length; i++) {
    const valid = validLegs[2 * i + leg] > 0;
    if (valid) from ??= i;
    if (from !== null && (!valid || i + 1 === time.length)) {
      spans.push([time[from], time[valid ? i : i - 1]]);
      from = null;
    }
  }
  return spans;
};
