"use strict";
// Which strides count, where the clock stands in them, and means over strides.

// Mean and spread at each point, as gaitcal/gait/ensemble.py: every stride counts the same, what is not valid is left out.
// `laid`: curves over the percents of their strides; `name`: which part of them.
Gaitcal.spread = (laid, name = "value") => {
  const out = Object.fromEntries(["n", "mean", "sd", "se"].map((key) => [key, new Float64Array(101).fill(NaN)]));
  for (let i = 0; i <= 100; i++) {
    const there = laid.filter((one) => one.valid[i] && one[name] && Number.isFinite(one[name][i]));
    const n = there.length;
    out.n[i] = n;
    if (!n) continue;
    const average = (value) => there.reduce((sum, one) => sum + value(one), 0) / n;
    const mean = average((one) => one[name][i]);
    const variance = n > 1 ? (average((one) => (one[name][i] - mean) ** 2) * n) / (n - 1) : NaN;
    out.mean[i] = mean;
    out.sd[i] = Math.sqrt(variance);
    if (!there.every((one) => one.se)) continue;
    if (n === 1) out.se[i] = there[0].se[i];
    else if (there.every((one) => one.own)) {
      const shared = average((one) => Math.sqrt(Math.max(one.se[i] ** 2 - one.own[i] ** 2, 0)));
      out.se[i] = Math.sqrt(variance / n + shared ** 2);
    }
  }
  return out;
};

// The strides of a page's results in its present state.
Gaitcal.Strides = class {
  constructor(page) {
    this.state = page.state;
    this.sheets = page.results.map(Gaitcal.Sheet.of);
    this.held = {};
  }

  get sheet() {
    return this.sheets[this.state.result];
  }

  get trial() {
    return this.sheet.trials[this.state.trial] ?? this.sheet.trials[0];
  }

  // Over the cycle where the chosen trial has a stride of any leg: what has none can only be seen over time.
  get percent() {
    return this.state.axis === "percent" && this.trial.strides.length > 0;
  }

  takesPart(result, trial, stride) {
    const { off } = this.state;
    return !off.has(`${result}/${trial}`) && !off.has(`${result}/${trial}/${stride.side}/${stride.number}`);
  }

  // The strides of a leg that are on: [{trial, stride}]; those that turn apart.
  on(result, side) {
    const found = this.sheets[result].trials.flatMap((trial, t) =>
      trial.strides
        .filter((stride) => stride.side === side && this.takesPart(result, t, stride))
        .map((stride) => ({ trial, stride })),
    );
    return { straight: found.filter(({ stride }) => !stride.turns), turning: found.filter(({ stride }) => stride.turns) };
  }

  // The stride of a leg in the chosen trial at a time; the nearest one where there is none; null without any.
  near(side, seconds) {
    const { trial } = this;
    const slack = 1e-4;
    const held = this.held[side];
    const away = (stride) => Math.max(stride.start - seconds, seconds - stride.stop);
    if (held?.trial === trial && away(held.stride) <= slack) return held.stride;
    const own = trial.strides.filter((stride) => stride.side === side);
    if (!own.length) return null;
    const stride = own.reduce((a, b) => (away(b) < away(a) - slack ? b : a));
    this.held[side] = { trial, stride };
    return stride;
  }

  // Percent of the stride of a leg at a time; null where the leg makes no stride then.
  percentAt(side, seconds) {
    const stride = this.near(side, seconds);
    if (!stride) return null;
    const percent = (100 * (seconds - stride.start)) / (stride.stop - stride.start);
    return percent < -0.02 || percent > 100.02 ? null : Math.min(100, Math.max(0, percent));
  }

  // The frame nearest to a percent of the leg's stride; of the other leg's where it has none.
  timeAt(side, percent) {
    const { seconds } = this.state;
    const stride = this.near(side, seconds) ?? this.near(side === "r" ? "l" : "r", seconds);
    return this.trial.frame(stride.start + (percent / 100) * (stride.stop - stride.start), stride.start, stride.stop);
  }
};
