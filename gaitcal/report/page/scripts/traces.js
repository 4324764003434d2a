// What one panel shows in the present state: lines with their bands, the normal band, limits of both axes.

// More strides than these make no difference to the eye.
Gaitcal.MOST_THIN = 40;

// `subject`: {base, kind} of a panel; `strides`: Gaitcal.Strides.
Gaitcal.Traces = class {
  constructor(subject, strides, convention) {
    Object.assign(this, { ...subject, strides, convention, percent: strides.percent, lines: [] });
    if (this.percent) for (const side of ["r", "l"]) this.overCycle(side);
    else this.overTime();
    this.bands = this.percent && strides.state.norm && strides.ofWalks ? this.normal() : [];
    this.x = this.percent ? [0, 100] : [0, strides.trial.duration];
    this.y = this.limits();
  }

  overCycle(side) {
    const { strides, strides: { state } } = this;
    const { straight, turning } = strides.on(side);
    const lay = (found) =>
      found.flatMap(({ trial, stride }) => {
        const curve = trial.ofLeg(this.base, side, this.kind);
        return curve ? [{ stride, laid: curve.over(stride) }] : [];
      });
    const [all, bent] = [lay(straight), lay(turning)];
    const draw = (laid, weight) => this.add(laid, { side, weight, n: all.length });
    if (all.length > 1 && state.spread === "mean") {
      const laid = all.map((one) => one.laid);
      for (const one of laid.slice(0, Gaitcal.MOST_THIN)) draw(one, "thin");
      draw(Gaitcal.averaged(laid), "mean");
      return;
    }
    const here = strides.near(side, state.seconds);
    const main = [...all, ...bent].find(({ stride }) => stride === here) ?? (all.length === 1 ? all[0] : null);
    for (const one of [...all, ...bent].slice(0, Gaitcal.MOST_THIN)) if (one !== main) draw(one.laid, "thin");
    if (main) draw(main.laid, "main");
  }

  overTime() {
    for (const side of ["r", "l", ""]) {
      const curve = this.strides.trial.curve(this.base, side, this.kind);
      if (curve) this.add(curve.whole(), { side, weight: "main", n: 1 });
    }
  }

  // A line in the chosen convention. `isMain`: a cursor reads it, and its models and bands are drawn.
  add(laid, line) {
    const { state } = this.strides;
    const factor = this.convention.factor(this.base, this.kind, line.side);
    const scaled = (values, by) => values?.map((value) => by * value) ?? null;
    const isMain = line.weight === "main" || line.weight === "mean";
    this.lines.push({
      ...line,
      isMain,
      x: laid.x,
      valid: laid.valid,
      lined: laid.lined,
      value: scaled(laid.value, factor),
      se: scaled(laid.se, Math.abs(factor)),
      sd: scaled(laid.sd, Math.abs(factor)),
      counts: laid.counts ?? null,
      nominal: state.nominal && isMain ? scaled(laid.nominal, factor) : null,
      truth: state.truth && isMain ? scaled(laid.truth, factor) : null,
    });
  }

  // Healthy people: one band where it is the same for both legs.
  normal() {
    const band = this.strides.sheet.bands.find(({ base, kind }) => base === this.base && kind === this.kind);
    if (!band) return [];
    const of = (side) => {
      const factor = this.convention.factor(this.base, this.kind, side);
      const scaled = (values, by) => values.map((value) => (value === null ? NaN : by * value));
      return { mean: scaled(band[side][0], factor), sd: scaled(band[side][1], Math.abs(factor)) };
    };
    const [right, left] = [of("r"), of("l")];
    const same = right.mean.every((value, i) => !(Math.abs(value - left.mean[i]) > 1e-6));
    return same ? [right] : [right, left];
  }

  // Of what is valid; of everything where nothing is. Wide error bars may leave the picture, curves may not.
  limits() {
    let [low, high] = [Infinity, -Infinity];
    const include = (value) => {
      if (value < low) low = value;
      if (value > high) high = value;
    };
    const curves = this.lines.flatMap(({ value, nominal, truth, valid }) =>
      [value, nominal, truth].filter(Boolean).map((values) => [values, valid]),
    );
    for (const [values, valid] of curves) values.filter((_, i) => valid[i]).forEach(include);
    if (low > high) for (const [values] of curves) values.forEach(include);
    const [bottom, top] = [1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low];
    for (const { se, sd, value, valid } of this.lines) {
      for (const half of [this.strides.state.errors && se, sd].filter(Boolean)) {
        half.forEach((error, i) => {
          if (!valid[i] || !Number.isFinite(error)) return;
          include(Math.max(bottom, value[i] - error));
          include(Math.min(top, value[i] + error));
        });
      }
    }
    for (const { mean, sd } of this.bands) Object.values(Gaitcal.around(mean, sd)).flat().forEach(include);
    if (low > high) return [-1, 1];
    if (this.kind !== "angle") include(0);
    const pad = Math.max(0.05 * (high - low), 1e-6);
    return [low - pad, high + pad];
  }

  // The line that a cursor reads on a side.
  main(side) { return this.lines.find((line) => line.side === side && line.isMain) ?? null; }

  // Whether a line is drawn and read with the error of its mean, where it is known; else with the deviation of strides.
  tellsErrors(line) { return Boolean(this.strides.state.errors && line.se); }

  // Value, error and validity of a leg at a time, as the files have them; of means and of angles that are told against
  // the line of a stride, at the leg's place `x` on the axis, null where it has none.
  at(side, x, seconds) {
    const line = this.main(side);
    if (!line || !this.percent || line.lined || line.weight === "mean") return x === null ? null : this.on(line, x);
    const { base, kind } = this;
    const curve = this.strides.trial.ofLeg(base, side, kind);
    if (!curve) return null;
    const factor = this.convention.factor(base, kind, side);
    const { value, error, valid } = this.on(curve.whole(), seconds);
    return { value: factor * value, error: Math.abs(factor) * error, valid };
  }

  // The same of a line at x; null of none.
  on(line, x) {
    if (!line) return null;
    const { low, high, share: raw } = Gaitcal.located(line.x, x);
    const share = Math.abs(raw) < Gaitcal.ON_FRAME ? 0 : Math.abs(raw - 1) < Gaitcal.ON_FRAME ? 1 : raw;
    const mixed = (values) => {
      if (!values) return NaN;
      return share === 0 ? values[low] : share === 1 ? values[high] : values[low] + share * (values[high] - values[low]);
    };
    const valid = (share === 1 || line.valid[low]) && (share === 0 || line.valid[high]);
    const many = line.weight === "mean" && line.counts[share > 0.5 ? high : low] > 1;
    const error = mixed(many && !this.tellsErrors(line) ? line.sd : line.se);
    return { value: mixed(line.value), error, valid: Boolean(valid) };
  }
};
