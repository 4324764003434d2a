// The curves of a result, unpacked when they are first asked for. See gaitcal/report/page/page_data.py for what it holds.

// 0, 1, ..., 100 %.
Gaitcal.PERCENTS = Float64Array.from({ length: 101 }, (_, i) => i);
// Time is packed in 32 bits: so near a frame (share of the step between two) is on it.
Gaitcal.ON_FRAME = 1e-3;

Gaitcal.Sheet = class {
  constructor({ sheet }) {
    const { person, bands, peaks } = sheet;
    Object.assign(this, { person, bands, peaks });
    this.trials = sheet.trials.map((trial) => new Gaitcal.SheetTrial(trial));
  }
};

Gaitcal.SheetTrial = class {
  constructor(packed) {
    const { name, duration, events, strides, relative, activity, repeats } = packed;
    Object.assign(this, { packed, name, duration, events, strides, relative, activity, repeats });
    this.time = Gaitcal.floats(packed.time); // s from the begin, of each frame that the page holds
    this.laid = new Map();
    this.curves = new Map(
      packed.curves.map((curve) => [`${curve.base}/${curve.side}/${curve.kind}`, new Gaitcal.Curve(this, curve)]),
    );
    this.masks = packed.masks.map((mask) => new Uint8Array(Gaitcal.bytes(mask)));
  }

  // The curve of a coordinate, of a leg ("r", "l") or of none (""); undefined where the trial has none.
  curve(base, side, kind) { return this.curves.get(`${base}/${side}/${kind}`); }

  // The curve in a stride of a leg: pelvis and trunk have one for both legs.
  ofLeg(base, side, kind) { return this.curve(base, side, kind) ?? this.curve(base, "", kind); }

  // The last frame at or before t, and the share of the way to the next one; NaN outside the trial.
  place(t) {
    const { low, high, share } = Gaitcal.located(this.time, t);
    if (Math.abs(share) < Gaitcal.ON_FRAME) return { low, high: low, share: 0 };
    if (Math.abs(share - 1) < Gaitcal.ON_FRAME) return { low: high, high, share: 0 };
    return { low, high, share: share < 0 || share > 1 ? NaN : share };
  }

  // The time of the frame nearest to t, not before `from` nor after `to`.
  frame(t, from = -Infinity, to = Infinity) {
    const { low } = Gaitcal.located(this.time, t);
    const near = [low - 1, low, low + 1, low + 2].map((i) => this.time[i]).filter((time) => time !== undefined);
    const inside = near.filter((time) => time >= from - 1e-4 && time <= to + 1e-4);
    const away = (time) => Math.abs(time - t);
    return (inside.length ? inside : near).reduce((a, b) => (away(b) < away(a) ? b : a));
  }

  // Where 0, 1, ..., 100 % of a stride lie between the frames.
  places(stride) {
    if (!this.laid.has(stride)) {
      const step = (stride.stop - stride.start) / 100;
      this.laid.set(stride, Array.from(Gaitcal.PERCENTS, (percent) => this.place(stride.start + percent * step)));
    }
    return this.laid.get(stride);
  }
};

// One variable of one trial, as in the files of the result.
Gaitcal.Curve = class {
  constructor(trial, packed) {
    Object.assign(this, { trial, packed, parts: {}, laid: new Map() });
  }

  // Values of every frame: "value", "se", "own", "nominal", "truth"; null where the trial has none.
  part(name) {
    this.parts[name] ??= this.packed[name] && new Gaitcal.Lengths(this.packed[name]).all();
    return this.parts[name];
  }

  get valid() { return this.trial.masks[this.packed.valid]; }

  // The curve over 0, 1, ..., 100 % of a stride: linear between frames; a gap stays one. Valid percents are those of
  // `cycles.csv`.
  over(stride) {
    if (!this.laid.has(stride)) {
      const places = this.trial.places(stride);
      const mixed = (values, { low, high, share }) =>
        share === 0 ? values[low] : values[low] + share * (values[high] - values[low]);
      const valid = new Uint8Array(Gaitcal.bytes(stride.valid[this.packed.valid]));
      // Angles of the pelvis are against the line of each stride, as in `cycles.csv`, and mean nothing in a stride without
      // one; over time, they are against that of the trial.
      const own = (this.packed.kind === "angle" && stride.pelvis?.[this.packed.base]) || null;
      if (own && stride.turns) valid.fill(0);
      const against = Object.entries(own ?? {}).map(([part, packed]) => [part, new Gaitcal.Lengths(packed).all()]);
      const lay = (values) => values && Float64Array.from(places, (place) => mixed(values, place));
      this.laid.set(stride, { ...this.record(Gaitcal.PERCENTS, valid, lay), ...Object.fromEntries(against), lined: own !== null });
    }
    return this.laid.get(stride);
  }

  // The curve over the time of the trial.
  whole() { return this.record(this.trial.time, this.valid, (values) => values); }

  record(x, valid, lay) {
    const parts = ["value", "se", "own", "nominal", "truth"].map((name) => [name, lay(this.part(name))]);
    return { x, valid, ...Object.fromEntries(parts) };
  }
};
