"use strict";
// A trial's own curves over its time, with limits and the clock's cursor: pelvis residuals, marker errors.

Gaitcal.TRIAL_CURVES = {
  residual_force: "Force at the pelvis that nothing explains",
  residual_moment: "Moment at the pelvis that nothing explains",
  marker_error: "Marker error, RMS over the markers",
};

Gaitcal.UNITS = { "N m": "N·m" };

Gaitcal.TrialCurve = class {
  constructor(trial, curve, limit) {
    this.time = Gaitcal.floats(trial.time);
    this.value = new Gaitcal.Lengths(curve.value).all();
    this.nominal = curve.nominal ? new Gaitcal.Lengths(curve.nominal).all() : null;
    this.valid = new Uint8Array(Gaitcal.bytes(trial.masks[curve.valid]));
    this.unit = Gaitcal.UNITS[curve.unit] ?? Gaitcal.visible(curve.unit);
    this.title = Gaitcal.TRIAL_CURVES[curve.kind] ?? Gaitcal.visible(curve.kind);
    this.limit = Number.isFinite(limit) ? limit : null;
    this.duration = this.time.at(-1) || 1;
  }

  // What the picture says, for who does not see it.
  words() {
    const counted = [...this.value].filter((value, i) => this.valid[i] && Number.isFinite(value));
    if (!counted.length) return `${this.title}: no valid frame.`;
    const peak = `Peak ${Gaitcal.numeral(Math.max(...counted))} ${this.unit} in the valid frames`;
    if (this.limit === null) return `${peak}.`;
    const above = counted.filter((value) => value > this.limit).length / counted.length;
    const share = above
      ? `above it in ${Gaitcal.numeral(100 * above, above < 0.1 ? 1 : 0)} % of them`
      : "never above it";
    return `${peak}; ${this.asked}, ${share}.`;
  }

  get asked() {
    return `asked of simulations ${Gaitcal.numeral(this.limit)} ${this.unit}`;
  }

  at(seconds) {
    const i = this.time.findIndex((t) => t >= seconds - 1e-6);
    return i < 0 ? Number.NaN : this.value[i];
  }

  drawing(density) {
    const { time, value, valid, nominal, limit } = this;
    const colours = Gaitcal.pageColours();
    const highest = [...value, ...(nominal ?? []), limit ?? 0].filter(Number.isFinite).reduce((a, b) => Math.max(a, b), 0);
    const counted = value.map((one, i) => (valid[i] ? one : NaN));
    const { accent, poor } = colours;
    return {
      x: [0, this.duration],
      y: [0, 1.06 * (highest || 1)],
      lines: [
        nominal && { x: time, y: nominal, colour: colours.nominal, width: 1, dash: [6, 2] },
        { x: time, y: value, colour: accent, width: 0.9, alpha: 0.55 },
        { x: time, y: counted, colour: accent, width: 1.8 },
        limit !== null && { x: time, y: value.map(() => limit), colour: poor, width: 1.2, dash: [2, 3] },
      ].filter(Boolean),
      colours,
      density,
      font: 11,
      unit: " s",
    };
  }

  // The figure; what moves its line to a time goes to `cursors`. `wide`: px of the paper that it is drawn for.
  figure({ cursors, page, wide }) {
    const line = html("div.cursor");
    const now = html("span.now");
    const place = html("div.plot");
    let plot = null;
    const draw = (width, density = 1) => {
      plot?.destroy();
      plot = Gaitcal.plot(place, [width, Gaitcal.TRIAL_HEIGHT], this.drawing(density));
      plot.over.append(line);
      plot.over.addEventListener("click", ({ offsetX, currentTarget }) => {
        const share = Math.min(1, Math.max(0, offsetX / currentTarget.clientWidth));
        page.state.set({ seconds: share * this.duration, playing: false });
      });
    };
    if (wide) draw(wide, 2);
    else new ResizeObserver(() => place.clientWidth && draw(place.clientWidth)).observe(place);
    cursors.push((seconds, still) => {
      line.style.transform = `translateX(${(100 * Math.min(1, seconds / this.duration)).toFixed(3)}%)`;
      if (still) now.textContent = ` At ${seconds.toFixed(2)} s: ${Gaitcal.numeral(this.at(seconds))} ${this.unit}.`;
    });
    const label = `${this.title} over time. ${this.words()}`;
    Gaitcal.dress(place, { role: "img", "aria-label": label });
    return html("figure.traced",
      html("figcaption", html("strong", `${this.title}, ${this.unit}`), " ", this.words(), now), place);
  }
};

Gaitcal.TRIAL_HEIGHT = 148; // px

Gaitcal.BLOCKS.curves = ({ kinds, limits }, { scope }) => {
  const { trial } = scope;
  const curves = kinds.flatMap((kind) => (trial?.curves ?? []).filter((curve) => curve.kind === kind));
  if (!curves.length) return null;
  const key = (kind, words) => Gaitcal.keyOf(svg(`line.${kind}`, { x1: 1, x2: 25, y1: 7, y2: 7 }), words);
  const limited = curves.map((curve) => new Gaitcal.TrialCurve(trial, curve, limits?.[curve.kind]));
  return html("div.traces",
    html("p.key", { "aria-hidden": "true" },
      key("counted", "calibrated model"),
      key("unsure", "the same, in frames that do not count"),
      curves.some((curve) => curve.nominal) && key("nominal", "nominal model"),
      limited.some(({ limit }) => limit !== null) && key("limit", "asked of simulations"),
    ),
    limited.map((curve) => curve.figure(scope)),
  );
};
