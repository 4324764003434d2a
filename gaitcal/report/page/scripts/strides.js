// Which strides of a page's result count in its present state, and where the clock stands in them.
Gaitcal.Strides = class {
  constructor({ state, result }) {
    Object.assign(this, { state, sheet: new Gaitcal.Sheet(result), held: {} });
  }

  get trial() { return this.sheet.trials[this.state.trial] ?? this.sheet.trials[0]; }

  // Whether the chosen trial walks: norms are of walks.
  get ofWalks() { return (this.trial.activity ?? "gait") === "gait"; }

  // What one of the chosen trial is called.
  get one() { return this.trial.repeats ? "repetition" : "stride"; }

  // Rows of peaks of the chosen trial's activity.
  get peaks() { return this.sheet.peaks.filter((row) => row.activity === (this.trial.activity ?? "gait")); }

  // Over the cycle where the chosen trial has a stride of any leg: what has none can only be seen over time.
  get percent() { return this.state.axis === "percent" && this.trial.strides.length > 0; }

  // The strides of a leg that are on, of the chosen trial's activity: [{trial, stride}]; those that turn apart.
  on(side) {
    const found = this.sheet.trials.flatMap((trial, t) =>
      (trial.activity === this.trial.activity ? trial.strides : [])
        .filter((stride) => stride.side === side && Gaitcal.isOn(this.state, t, stride))
        .map((stride) => ({ trial, stride })),
    );
    return { straight: found.filter(({ stride }) => !stride.turns), turning: found.filter(({ stride }) => stride.turns) };
  }

  // How many straight strides are on: [right, left].
  get counts() { return ["r", "l"].map((side) => this.on(side).straight.length); }

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

  // The same, of the other leg where this one has none.
  nearAny(side, seconds) { return this.near(side, seconds) ?? this.near(side === "r" ? "l" : "r", seconds); }

  // Percent of the stride of a leg at a time; null where the leg makes no stride then.
  percentAt(side, seconds) {
    const stride = this.near(side, seconds);
    const percent = stride ? Gaitcal.percentOf(stride, seconds) : -1;
    return percent < -0.02 || percent > 100.02 ? null : Math.min(100, Math.max(0, percent));
  }

  // The frame nearest to a percent of the leg's stride; of the other leg's where it has none.
  timeAt(side, percent) {
    const { start, stop } = this.nearAny(side, this.state.seconds);
    return this.trial.frame(start + (percent / 100) * (stop - start), start, stop);
  }
};

Gaitcal.percentOf = ({ start, stop }, seconds) => (100 * (seconds - start)) / (stop - start);

// Whether a stride of a trial takes part.
Gaitcal.isOn = ({ off }, trial, { side, number }) => !off.has(`${trial}`) && !off.has(`${trial}/${side}/${number}`);
