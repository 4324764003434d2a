// The one clock: it moves `state.seconds` on, and around the window that is looped.
Gaitcal.clock = (page) => {
  const { state } = page;
  let before = null;
  const tick = (now) => {
    const elapsed = Math.min(0.25, Math.max(0, now - before) / 1000);
    before = state.playing ? now : null;
    if (!state.playing) return;
    const [begin, end] = state.window ?? [0, page.trial.duration];
    const next = state.seconds + elapsed * state.speed;
    state.set({ seconds: next >= begin && next <= end ? next : begin });
    requestAnimationFrame(tick);
  };
  state.on(["playing"], () => {
    if (!state.playing || before !== null) return;
    before = performance.now();
    requestAnimationFrame(tick);
  });
  return {
    play: (on = !state.playing) => state.set({ playing: on }),
    seek: (seconds) => state.set({ seconds }),
    // Whole frames on, from the nearest.
    step: (frames) => {
      const { time } = page.trial;
      const { low, high, part } = page.trial.frame(state.seconds);
      const there = Math.min(time.length - 1, Math.max(0, (part > 0.5 ? high : low) + frames));
      state.set({ playing: false, seconds: time[there] });
    },
  };
};

// px: a pointer that moved less has pressed, not dragged.
Gaitcal.DRAGGED = 5;

// Strikes, toe-offs, stance and validity of each leg along time; the slider that moves the clock; the window it loops.
Gaitcal.timeline = (page) => {
  const { state } = page;
  const { get } = Gaitcal;
  const [slider, tracks] = [get("time"), get("tracks")];
  // Places are shares of the trial, so that no change of width needs another drawing.
  const share = (seconds) => `${((100 * seconds) / (page.trial.duration || 1)).toFixed(3)}%`;

  // Loop from one time to another; nothing where they are one.
  const choose = (from, to) => {
    const window = [Math.min(from, to), Math.max(from, to)];
    if (window[1] - window[0] < 1e-3) return;
    state.set({ window, seconds: Math.min(window[1], Math.max(window[0], state.seconds)) });
  };
  const begin = () => {
    const { seconds, window } = state;
    choose(seconds, window && window[1] > seconds ? window[1] : page.trial.duration);
  };
  const end = () => {
    const { seconds, window } = state;
    choose(window && window[0] < seconds ? window[0] : 0, seconds);
  };

  const draw = (track, side, events, valid) => {
    const bar = (kind, [from, to], y, height) =>
      svg(`rect.${kind}`, { x: share(from), width: share(to - from), y, height });
    const mark = (event) => {
      const x = share(event.time);
      const made = Gaitcal.isStrike(event.kind)
        ? svg("line.strike", { x1: x, x2: x, y1: 0, y2: 12 })
        : svg("circle.off", { cx: x, cy: 7, r: 3 });
      return page.events?.on() ? page.events.movable(made, event) : made;
    };
    track.setAttribute("role", page.events?.on() ? "group" : "img");
    track.replaceChildren(
      bar("window", [0, 0], 0, 16),
      ...Gaitcal.stances(page.sheet, side, page.trial.duration).map((span) => bar("stance", span, 4, 6)),
      ...valid.map((span) => bar("valid", span, 13, 2.5)),
      ...events.map(mark),
      svg("line.now", { x1: 0, x2: 0, y1: 0, y2: 16 }),
    );
    const said = (what, when) => (when.length ? [`${what} ${when.join(", ")}`] : []);
    const times = (strike) =>
      events.filter(({ kind }) => Gaitcal.isStrike(kind) === strike).map(({ time }) => `${time.toFixed(2)} s`);
    const spans = valid.map(([from, to]) => `${from.toFixed(2)} to ${to.toFixed(2)} s`);
    const steps = [...said("foot strikes at", times(true)), ...said("foot off at", times(false))];
    const words = [...steps, ...said("torques valid", spans)].join("; ") || "no events";
    track.setAttribute("aria-label", `${Gaitcal.LEGS[side]} leg: ${words}`);
    track.parentElement.hidden = events.length === 0 && valid.length === 0;
  };
  const windowed = () => {
    const { window } = state;
    const [from, to] = window ?? [0, 0];
    for (const bar of tracks.querySelectorAll(".window")) Gaitcal.dress(bar, { x: share(from), width: share(to - from) });
    get("looped").textContent = window ? `${from.toFixed(2)} – ${to.toFixed(2)} s` : "";
    get("window-clear").disabled = window === null;
  };
  const pose = () => {
    const words = `${state.seconds.toFixed(2)} s`;
    slider.value = String(state.seconds);
    slider.setAttribute("aria-valuetext", words);
    get("clock").textContent = words;
    const x = share(state.seconds);
    for (const line of tracks.querySelectorAll(".now")) Gaitcal.dress(line, { x1: x, x2: x });
  };
  const open = () => {
    slider.max = String(page.trial.duration);
    for (const side of ["r", "l"]) {
      const events = (page.sheet?.events ?? []).filter((event) => event.side === side);
      draw(get(`track-${side}`), side, events, page.trial.valid[side]);
    }
    windowed();
    pose();
  };

  // A drag over the rows chooses a window, a click moves the clock.
  let from = null;
  const at = ({ clientX }) => {
    const { left, width } = get("track-r").getBoundingClientRect();
    return Math.min(1, Math.max(0, (clientX - left) / width)) * page.trial.duration;
  };
  const far = ({ clientX }) => Math.abs(clientX - from.x) >= Gaitcal.DRAGGED;
  const release = () => { from = null; };
  Gaitcal.dress(tracks, {
    pointerdown: (event) => {
      if (event.button > 0) return;
      from = { x: event.clientX, seconds: at(event) };
      tracks.setPointerCapture(event.pointerId);
    },
    pointermove: (event) => from && far(event) && choose(from.seconds, at(event)),
    pointerup: (event) => {
      if (from && !far(event)) state.set({ seconds: from.seconds });
      release();
    },
    pointercancel: release,
  });
  slider.addEventListener("input", () => state.set({ seconds: Number(slider.value) }));
  get("window-begin").addEventListener("click", begin);
  get("window-end").addEventListener("click", end);
  get("window-clear").addEventListener("click", () => state.set({ window: null }));
  state.on(["trial"], open);
  state.on(["seconds"], pose);
  state.on(["window"], windowed);
  open();
  return { begin, end, open, at, share };
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
