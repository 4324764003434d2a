"use strict";
// The curves of a result, unpacked when they are first asked for. See gaitcal/page/sheet/ for what a sheet holds.

// Most points of a curve over time: more than a panel has pixels, so that nothing is lost to the eye.
Gaitcal.MOST_POINTS = 2000;
// 0, 1, ..., 100 %.
Gaitcal.PERCENTS = Float64Array.from({ length: 101 }, (_, i) => i);
// Time is packed in 32 bits: so near a frame (share of the step between two) is on it.
Gaitcal.ON_FRAME = 1e-3;

Gaitcal.Sheet = class {
  constructor({ sheet, leastValid }) {
    this.leastValid = leastValid;
    this.person = sheet.person;
    this.joints = sheet.rows;
    this.bands = sheet.bands;
    this.rows = new Map(sheet.rows.flatMap(({ joint, rows }) => rows.map((row) => [row.base, { joint, ...row }])));
    this.trials = sheet.trials.map((trial) => new Gaitcal.SheetTrial(trial));
  }

  // One for each result of the page, however many ask; null for a bare scene.
  static of(result) {
    if (!result?.sheet) return null;
    if (!Gaitcal.Sheet.made.has(result)) Gaitcal.Sheet.made.set(result, new Gaitcal.Sheet(result));
    return Gaitcal.Sheet.made.get(result);
  }

  band(base, kind) {
    return this.bands.find((band) => band.base === base && band.kind === kind) ?? null;
  }
};
Gaitcal.Sheet.made = new WeakMap();

Gaitcal.SheetTrial = class {
  constructor(trial) {
    Object.assign(this, {
      name: trial.name, role: trial.role, start: trial.start, duration: trial.duration, events: trial.events,
      strides: trial.strides, refused: trial.refused, relative: trial.relative,
    });
    this.packed = trial;
    this.curves = new Map();
    this.laid = new Map();
    this.known = new Map(trial.curves.map((curve) => [`${curve.base}/${curve.side}/${curve.kind}`, curve]));
    this.masks = [];
  }

  // s from the begin, of each frame that the page holds.
  get time() {
    this.frames ??= Gaitcal.floats(this.packed.time);
    return this.frames;
  }

  mask(i) {
    this.masks[i] ??= new Uint8Array(Gaitcal.bytes(this.packed.masks[i]));
    return this.masks[i];
  }

  // Valid percents of a stride as `cycles.csv` has them; null where the page was not told.
  told({ valid }, i) {
    return valid ? new Uint8Array(Gaitcal.bytes(valid[i])) : null;
  }

  // The curve of a coordinate, of a leg ("r", "l") or of none (""); null where the trial has none.
  curve(base, side, kind) {
    const name = `${base}/${side}/${kind}`;
    if (!this.curves.has(name)) this.curves.set(name, this.known.has(name) ? new Gaitcal.Curve(this, this.known.get(name)) : null);
    return this.curves.get(name);
  }

  // The last frame at or before t, and the share of the way to the next one.
  place(t) {
    const { time } = this;
    let low = 0;
    let high = time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (time[middle] <= t) low = middle;
      else high = middle;
    }
    const share = high > low ? (t - time[low]) / (time[high] - time[low]) : 0;
    if (Math.abs(share) < Gaitcal.ON_FRAME) return { low, high: low, share: 0 };
    if (Math.abs(share - 1) < Gaitcal.ON_FRAME) return { low: high, high, share: 0 };
    return { low, high, share: share < 0 || share > 1 ? NaN : share };
  }

  // The time of the frame nearest to t, not before `from` nor after `to`.
  frame(t, from = -Infinity, to = Infinity) {
    const { time } = this;
    const { low } = this.place(Math.min(Math.max(t, time[0]), time[time.length - 1]));
    const near = [low - 1, low, low + 1, low + 2].filter((i) => i >= 0 && i < time.length);
    const slack = 1e-4;
    const inside = near.filter((i) => time[i] >= from - slack && time[i] <= to + slack);
    return (inside.length ? inside : near).map((i) => time[i]).reduce((a, b) => (Math.abs(b - t) < Math.abs(a - t) ? b : a));
  }

  // Where 0, 1, ..., 100 % of a stride lie between the frames.
  places(stride) {
    if (!this.laid.has(stride)) {
      const step = (stride.stop - stride.start) / 100;
      this.laid.set(stride, Array.from(Gaitcal.PERCENTS, (percent) => this.place(stride.start + percent * step)));
    }
    return this.laid.get(stride);
  }

  // Stretches of time in which a foot is on the ground, as gaitcal/gait/cycles.py has them.
  stances(side) {
    const own = this.events.filter((event) => event.side === side).sort((a, b) => a.time - b.time);
    const changes = own.map(({ kind, time }) => ({ down: kind.endsWith("strike"), time }));
    if (!changes.length) return [];
    const out = [];
    let begin = changes[0].down ? null : 0;
    for (const { down, time } of changes) {
      if (down) begin ??= time;
      else if (begin !== null) {
        out.push([begin, time]);
        begin = null;
      }
    }
    if (begin !== null) out.push([begin, this.duration]);
    return out;
  }
};

// One variable of one trial, as in the files of the result.
Gaitcal.Curve = class {
  constructor(trial, packed) {
    this.trial = trial;
    this.packed = packed;
    this.laid = new Map();
  }

  // Values of every frame: "value", "se", "own", "nominal", "truth"; null where the trial has none.
  part(name) {
    this.parts ??= {};
    if (this.parts[name] === undefined) this.parts[name] = this.packed[name] ? new Gaitcal.Lengths(this.packed[name]).all() : null;
    return this.parts[name];
  }

  get valid() {
    return this.trial.mask(this.packed.valid);
  }

  // Linear between frames; a gap stays one, and only between two valid frames a value is valid.
  at(t) {
    const place = this.trial.place(t);
    return {
      value: Gaitcal.mixed(this.part("value"), place),
      se: this.part("se") ? Gaitcal.mixed(this.part("se"), place) : NaN,
      valid: Boolean(this.valid[place.low] && this.valid[place.high]) && !Number.isNaN(place.share),
    };
  }

  // The curve over 0, 1, ..., 100 % of a stride.
  over(stride) {
    if (!this.laid.has(stride)) {
      const places = this.trial.places(stride);
      const lay = (values) => values && Float64Array.from(places, (place) => Gaitcal.mixed(values, place));
      const valid = this.trial.told(stride, this.packed.valid) ?? Uint8Array.from(places, (place) => this.between(place));
      if (stride.turns && this.inRoom(stride)) valid.fill(0);
      this.laid.set(stride, { ...this.record(Gaitcal.PERCENTS, lay, valid), ...this.along(stride) });
    }
    return this.laid.get(stride);
  }

  between({ low, high, share }) {
    return Number(share >= 0 && this.valid[low] && this.valid[high]);
  }

  // Whether it is an angle of the pelvis, which means nothing in a stride without a line.
  inRoom({ pelvis }) {
    return this.packed.kind === "angle" && Boolean(pelvis?.[this.packed.base]);
  }

  // Angles of the pelvis are against the line of each stride, as in `cycles.csv`; over time, against that of the trial.
  along({ pelvis }) {
    const { base, kind } = this.packed;
    const own = kind === "angle" ? Object.entries(pelvis?.[base] ?? {}) : [];
    return Object.fromEntries(own.map(([part, packed]) => [part, Float64Array.from(new Gaitcal.Lengths(packed).all())]));
  }

  // The curve over the time of the trial; of a long one the least and greatest value of each stretch.
  whole() {
    if (!this.all) {
      const { time } = this.trial;
      const kept = Gaitcal.kept(this.part("value"), this.valid, Gaitcal.MOST_POINTS);
      const lay = (values) => values && Float64Array.from(kept, (i) => values[i]);
      this.all = this.record(lay(time), lay, Uint8Array.from(kept, (i) => this.valid[i]));
    }
    return this.all;
  }

  record(x, lay, valid) {
    const parts = ["value", "se", "own", "nominal", "truth"].map((name) => [name, lay(this.part(name))]);
    return { x, valid, ...Object.fromEntries(parts) };
  }
};

Gaitcal.mixed = (values, { low, high, share }) =>
  share === 0 ? values[low] : values[low] + share * (values[high] - values[low]);

// Numbers of the frames that show a long curve as it is: of each stretch the lowest and the highest, the first that is
// missing, and where validity changes.
Gaitcal.kept = (values, valid, most) => {
  const count = values.length;
  if (count <= most) return Array.from(values, (_, i) => i);
  const out = new Set([0, count - 1]);
  const size = count / (most / 2);
  for (let from = 0; from < count; from += size) {
    let [low, high, gap] = [-1, -1, -1];
    for (let i = Math.floor(from); i < Math.min(count, Math.floor(from + size)); i++) {
      if (Number.isNaN(values[i])) gap = gap < 0 ? i : gap;
      else if (low < 0) low = high = i;
      else if (values[i] < values[low]) low = i;
      else if (values[i] > values[high]) high = i;
      if (i && valid[i] !== valid[i - 1]) out.add(i - 1).add(i);
    }
    for (const i of [low, high, gap]) if (i >= 0) out.add(i);
  }
  return [...out].sort((a, b) => a - b);
};
