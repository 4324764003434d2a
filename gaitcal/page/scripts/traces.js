"use strict";
// What one panel shows in the present state: lines with their bands, the normal band, stance, limits of both axes.

// More strides than these make no difference to the eye.
Gaitcal.MOST_THIN = 40;

// `subject`: {base, kind} of a panel; `strides`: Gaitcal.Strides; `conventions`: one for each result.
Gaitcal.Traces = class {
  constructor(subject, strides, conventions) {
    Object.assign(this, { ...subject, strides, conventions });
    const { state } = strides;
    this.percent = strides.percent;
    this.lines = [];
    this.turning = 0;
    if (this.percent) for (const side of ["r", "l"]) this.overCycle(state.result, side, false);
    else this.overTime(state.result, strides.trial, false);
    const other = 1 - state.result;
    if (state.second && strides.sheets[other]) {
      if (this.percent) for (const side of ["r", "l"]) this.overCycle(other, side, true);
      else this.overTime(other, strides.sheets[other].trials.find(({ name }) => name === strides.trial.name), true);
    }
    this.bands = this.percent && state.norm ? this.normal(state.result) : [];
    this.x = this.percent ? [0, 100] : [0, strides.trial.duration];
    this.y = this.limits();
  }

  // Where the curve of a leg is found: pelvis and trunk have one for both legs.
  curve(trial, side) {
    return trial.curve(this.base, side, this.kind) ?? trial.curve(this.base, "", this.kind);
  }

  overCycle(result, side, second) {
    const { strides, strides: { state } } = this;
    const { straight, turning } = strides.on(result, side);
    const lay = (found) => found.map(({ trial, stride }) => ({ stride, laid: this.curve(trial, side)?.over(stride) })).filter(({ laid }) => laid);
    const [all, bent] = [lay(straight), lay(turning)];
    this.turning += second ? 0 : bent.length;
    const draw = (laid, weight, more) => this.add(result, laid, { side, second, weight, n: all.length, ...more });
    if (all.length > 1 && (second || state.spread === "mean")) {
      const laid = all.map((one) => one.laid);
      for (const one of laid.slice(0, Gaitcal.MOST_THIN)) if (!second) draw(one, "pale");
      draw(Gaitcal.averaged(laid), "mean", { n: laid.length });
      return;
    }
    const here = second ? null : strides.near(side, state.seconds);
    const main = [...all, ...bent].find(({ stride }) => stride === here) ?? (all.length === 1 ? all[0] : null);
    for (const one of [...all, ...bent].slice(0, Gaitcal.MOST_THIN)) if (one !== main) draw(one.laid, "thin");
    if (main) draw(main.laid, "main");
  }

  overTime(result, trial, second) {
    if (!trial) return;
    for (const side of ["r", "l", ""]) {
      const curve = trial.curve(this.base, side, this.kind);
      if (curve) this.add(result, curve.whole(), { side, second, weight: "main", n: 1 });
    }
  }

  // A line in the chosen convention.
  add(result, laid, told) {
    const { state } = this.strides;
    const factor = this.conventions[result].factor(this.base, this.kind, this.percent ? told.side : "");
    const scaled = (values, by) => values?.map((value) => by * value) ?? null;
    this.lines.push({
      ...told, result, x: laid.x, valid: laid.valid,
      value: scaled(laid.value, factor),
      se: scaled(laid.se, Math.abs(factor)),
      sd: scaled(laid.sd ?? null, Math.abs(factor)),
      counts: laid.counts ?? null,
      nominal: state.nominal && told.weight !== "thin" && told.weight !== "pale" ? scaled(laid.nominal, factor) : null,
      truth: state.truth && told.weight !== "thin" && told.weight !== "pale" ? scaled(laid.truth, factor) : null,
    });
  }

  // Healthy people: one band where it is the same for both legs.
  normal(result) {
    const band = this.strides.sheets[result].band(this.base, this.kind);
    if (!band) return [];
    const of = (side) => {
      const factor = this.conventions[result].factor(this.base, this.kind, side);
      const [mean, sd] = band[side].map((values) => values.map((value) => (value === null ? NaN : value)));
      return { mean: mean.map((value) => factor * value), sd: sd.map((value) => Math.abs(factor) * value), source: band.source };
    };
    const [right, left] = [of("r"), of("l")];
    const same = right.mean.every((value, i) => !(Math.abs(value - left.mean[i]) > 1e-6));
    return same ? [right] : [right, left];
  }

  // Of what is valid; of everything where nothing is. Wide error bars may leave the picture, curves may not.
  limits() {
    let [low, high] = [Infinity, -Infinity];
    const see = (value) => {
      if (value < low) low = value;
      if (value > high) high = value;
    };
    const scan = (all) => {
      for (const line of this.lines)
        for (const part of ["value", "nominal", "truth"])
          if (line[part]) for (let i = 0; i < line.x.length; i++) if (all || line.valid[i]) see(line[part][i]);
    };
    scan(false);
    if (low > high) scan(true);
    const reach = 0.5 * (high - low);
    const [bottom, top] = [low - reach, high + reach];
    for (const line of this.lines) {
      const spread = this.strides.state.errors ? [line.se, line.sd] : [line.sd];
      for (const part of spread.filter(Boolean))
        for (let i = 0; i < line.x.length; i++)
          if (line.valid[i] && Number.isFinite(part[i])) {
            see(Math.max(bottom, line.value[i] - part[i]));
            see(Math.min(top, line.value[i] + part[i]));
          }
    }
    for (const { mean, sd } of this.bands) {
      for (const [i, value] of mean.entries()) for (const sign of [-1, 1]) see(value + sign * sd[i]);
    }
    if (low > high) return [-1, 1];
    if (this.kind !== "angle") see(0);
    const pad = Math.max(0.05 * (high - low), 1e-6);
    return [low - pad, high + pad];
  }

  // The line that a cursor reads on a side.
  main(side, second = false) {
    return this.lines.find((line) => line.second === second && line.side === side && (line.weight === "main" || line.weight === "mean")) ?? null;
  }

  // Value, its error and validity of a side's line at x; of the second result where that is asked for.
  at(side, x, second = false) {
    const line = this.main(side, second);
    if (!line) return null;
    let [low, high] = [0, line.x.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (line.x[middle] <= x) low = middle;
      else high = middle;
    }
    const raw = (x - line.x[low]) / (line.x[high] - line.x[low]);
    const share = Math.abs(raw) < Gaitcal.ON_FRAME ? 0 : Math.abs(raw - 1) < Gaitcal.ON_FRAME ? 1 : raw;
    const mixed = (values) => {
      if (!values) return NaN;
      return share === 0 ? values[low] : share === 1 ? values[high] : values[low] + share * (values[high] - values[low]);
    };
    const valid = (share === 1 || line.valid[low]) && (share === 0 || line.valid[high]);
    const n = line.counts ? line.counts[share > 0.5 ? high : low] : 1;
    const spread = line.weight === "mean" && n > 1;
    return { value: mixed(line.value), error: mixed(spread ? line.sd : line.se), valid: Boolean(valid), spread };
  }
};

// The mean of strides, in the form of one.
Gaitcal.averaged = (laid) => {
  const found = Gaitcal.spread(laid);
  const mean = (name) => (laid.some((one) => one[name]) ? Gaitcal.spread(laid, name).mean : null);
  return {
    x: Gaitcal.PERCENTS, valid: Uint8Array.from(found.n, (n) => Number(n > 0)), counts: found.n,
    value: found.mean, sd: found.sd, se: laid.every((one) => one.se) ? found.se : null,
    nominal: mean("nominal"), truth: mean("truth"),
  };
};
