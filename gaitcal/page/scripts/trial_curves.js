"use strict";
// A trial's own curves over its time, with limits and the clock's cursor: pelvis residuals, marker errors.

Gaitcal.TRIAL_CURVES = {
  residual_force: "Force at the pelvis that nothing explains",
  residual_moment: "Moment at the pelvis that nothing explains",
  marker_error: "Marker error, RMS over the markers",
};

Gaitcal.UNITS = { "N m": "N·m" };

// At most so many points are drawn; of more, the lowest and the highest of each stretch.
Gaitcal.TRIAL_POINTS = 2000;

Gaitcal.thinned = (values) => {
  const every = Math.ceil(values.length / (Gaitcal.TRIAL_POINTS / 2));
  if (every < 3) return [...values.keys()];
  const out = [];
  for (let from = 0; from < values.length; from += every) {
    let [low, high] = [from, from];
    for (let i = from; i < Math.min(values.length, from + every); i++) {
      if (!(values[i] >= values[low])) low = i;
      if (!(values[i] <= values[high])) high = i;
    }
    out.push(...new Set([Math.min(low, high), Math.max(low, high)]));
  }
  return out;
};

// A path in a box of 1000 x 1000; gaps where a value is missing or not counted.
Gaitcal.path = (time, values, top, counts = () => true) => {
  const duration = time[time.length - 1] || 1;
  let [out, drawn] = ["", false];
  for (const i of Gaitcal.thinned(values)) {
    const known = Number.isFinite(values[i]) && counts(i);
    if (known) {
      const [x, y] = [(1000 * time[i]) / duration, 1000 * (1 - values[i] / top)];
      out += `${drawn ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
    }
    drawn = known;
  }
  return out;
};

Gaitcal.TrialCurve = class {
  constructor(trial, curve, limit) {
    this.time = Gaitcal.floats(trial.time);
    this.value = new Gaitcal.Lengths(curve.value).all();
    this.nominal = curve.nominal ? new Gaitcal.Lengths(curve.nominal).all() : null;
    this.valid = new Uint8Array(Gaitcal.bytes(trial.masks[curve.valid]));
    this.unit = Gaitcal.UNITS[curve.unit] ?? Gaitcal.visible(curve.unit);
    this.title = Gaitcal.TRIAL_CURVES[curve.kind] ?? Gaitcal.visible(curve.kind);
    this.limit = Number.isFinite(limit) ? limit : null;
    this.duration = this.time[this.time.length - 1] || 1;
  }

  counted() {
    return [...this.value].filter((value, i) => this.valid[i] && Number.isFinite(value));
  }

  // What the picture says, for who does not see it.
  words() {
    const counted = this.counted();
    if (!counted.length) return `${this.title}: no valid frame.`;
    const peak = counted.reduce((a, b) => Math.max(a, b), 0);
    const told = `Peak ${Gaitcal.numeral(peak)} ${this.unit} in the valid frames`;
    if (this.limit === null) return `${told}.`;
    const above = counted.filter((value) => value > this.limit).length / counted.length;
    const share = above
      ? `above it in ${Gaitcal.numeral(100 * above, above < 0.1 ? 1 : 0)} % of them`
      : "never above it";
    return `${told}; asked of simulations ${Gaitcal.numeral(this.limit)} ${this.unit}, ${share}.`;
  }

  at(seconds) {
    const i = this.time.findIndex((t) => t >= seconds - 1e-6);
    return i < 0 ? Number.NaN : this.value[i];
  }

  // The figure; `cursors` gets what moves its line to a time.
  figure(cursors, seek) {
    const highest = [...this.value, ...(this.nominal ?? []), this.limit ?? 0]
      .filter(Number.isFinite)
      .reduce((a, b) => Math.max(a, b), 0);
    const top = 1.06 * (highest || 1);
    const path = (kind, values, counts) =>
      Gaitcal.svg("path", {
        class: kind,
        d: Gaitcal.path(this.time, values, top, counts),
        "vector-effect": "non-scaling-stroke",
      });
    const curves = Gaitcal.svg("svg", {
      viewBox: "0 0 1000 1000",
      preserveAspectRatio: "none",
      width: "100%",
      height: "100%",
    });
    if (this.nominal) curves.append(path("nominal", this.nominal));
    curves.append(
      path("unsure", this.value),
      path("counted", this.value, (i) => this.valid[i]),
    );
    const level = (value) => `${(100 * (1 - value / top)).toFixed(2)}%`;
    const rows = Gaitcal.roundTicks(0, top, 4).map(({ at, digits }) => ({
      y: level(at),
      words: Gaitcal.numeral(at, digits),
      at,
    }));
    const plot = Gaitcal.svg("svg", {
      class: "trace",
      height: 130,
      role: "img",
      "aria-label": `${this.title} over time. ${this.words()}`,
    });
    plot.append(
      ...rows.map(({ y, at }) => Gaitcal.svg("line", { class: at ? "grid" : "zero", x1: 0, x2: "100%", y1: y, y2: y })),
      curves,
    );
    if (this.limit !== null) {
      const y = level(this.limit);
      plot.append(Gaitcal.svg("line", { class: "limit", x1: 0, x2: "100%", y1: y, y2: y }));
      plot.append(
        Gaitcal.svg(
          "text",
          { class: "limit", x: "99.5%", y, dy: -3, "text-anchor": "end" },
          `asked of simulations ${Gaitcal.numeral(this.limit)} ${this.unit}`,
        ),
      );
    }
    const left = Gaitcal.svg("svg", { class: "levels", height: 130, "aria-hidden": "true" });
    left.append(
      ...rows.map(({ y, words }) => Gaitcal.svg("text", { x: "100%", dx: -5, y, dy: 4, "text-anchor": "end" }, words)),
    );
    const foot = Gaitcal.svg("svg", { class: "levels", height: 18, "aria-hidden": "true" });
    for (const { at, digits } of Gaitcal.roundTicks(0, this.duration, 6)) {
      const x = `${((100 * at) / this.duration).toFixed(2)}%`;
      const end = at > 0.95 * this.duration;
      foot.append(
        Gaitcal.svg(
          "text",
          { x, y: 12, "text-anchor": at === 0 ? "start" : end ? "end" : "middle" },
          `${Gaitcal.numeral(at, digits)} s`,
        ),
      );
    }
    const line = Gaitcal.make("div", { class: "cursor" });
    const place = Gaitcal.make("div", { class: "plot" }, plot, line);
    const now = Gaitcal.make("span", { class: "now" });
    place.addEventListener("click", (event) => {
      const box = place.getBoundingClientRect();
      seek(Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) * this.duration);
    });
    cursors.push((seconds, still) => {
      line.style.transform = `translateX(${(100 * Math.min(1, seconds / this.duration)).toFixed(3)}%)`;
      if (still) now.textContent = ` At ${seconds.toFixed(2)} s: ${Gaitcal.numeral(this.at(seconds))} ${this.unit}.`;
    });
    return Gaitcal.make(
      "figure",
      { class: "traced" },
      Gaitcal.make("figcaption", {}, Gaitcal.make("strong", {}, `${this.title}, ${this.unit}`), " ", this.words(), now),
      Gaitcal.make("div", { class: "plotted" }, left, place, Gaitcal.make("span"), foot),
    );
  }
};

Gaitcal.BLOCKS.curves = ({ kinds, limits }, blocks) => {
  const { trial, cursors, page } = blocks.scope;
  const curves = kinds.flatMap((kind) => (trial?.curves ?? []).filter((curve) => curve.kind === kind));
  if (!curves.length) return null;
  const seek = (seconds) => page.state.set({ seconds, playing: false });
  const figures = curves.map((curve) =>
    new Gaitcal.TrialCurve(trial, curve, limits?.[curve.kind]).figure(cursors, seek),
  );
  const line = (kind) => [Gaitcal.svg("line", { class: kind, x1: 1, x2: 25, y1: 7, y2: 7 })];
  const key = [
    Gaitcal.keyOf(line("counted"), "calibrated model"),
    Gaitcal.keyOf(line("unsure"), "the same, in frames that do not count"),
  ];
  if (curves.some((curve) => curve.nominal)) key.push(Gaitcal.keyOf(line("nominal"), "nominal model"));
  return Gaitcal.make(
    "div",
    { class: "traces" },
    Gaitcal.make("p", { class: "key", "aria-hidden": "true" }, ...key),
    ...figures,
  );
};
