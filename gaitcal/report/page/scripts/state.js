// What is chosen on the page of a result.
Gaitcal.LAYERS = ["body", "bones", "measured", "model", "errors", "forces", "fitted", "nominal", "uncertainty"];

// The presets are the tabs of the page: {title: of what it tells, layers: that it shows}.
Gaitcal.PRESETS = {};
for (const { id, dataset: { title, layers } } of document.querySelectorAll("#presets button")) {
  Gaitcal.PRESETS[id.replace("preset-", "")] = { title, layers: layers.split(" ") };
}

Gaitcal.SPEEDS = [0.1, 0.25, 0.5, 1, 2];

// The joints of curves and tables, and those of the linkage that each stands for.
Gaitcal.JOINTS = {
  hip: ["hip"], knee: ["knee"], ankle: ["talocrural", "subtalar"], trunk: ["back"], arm: ["shoulder", "elbow"], pelvis: [],
};
Gaitcal.UNPAIRED = ["trunk", "pelvis"];

// "talocrural_r" as "ankle_r"; undefined where there is no such joint.
Gaitcal.jointNamed = (text) => {
  const [, name, side] = /^([a-z]+?)(_[rl])?$/.exec(text ?? "") ?? [];
  const [found] = Object.entries(Gaitcal.JOINTS).find(([joint, parts]) => joint === name || parts.includes(name)) ?? [];
  return found && Gaitcal.UNPAIRED.includes(found) !== Boolean(side) ? `${found}${side ?? ""}` : undefined;
};

// The trial that is shown first: the first walk, else the first of another activity.
Gaitcal.firstTrial = (trials) =>
  Math.max(0, ["gait", "motion"].map((role) => trials.findIndex((trial) => trial.role === role)).find((at) => at >= 0) ?? 0);

Gaitcal.State = class extends Gaitcal.Chosen {
  // `trials`: those of the body; `result`: as the page holds it.
  constructor({ result: { sheet }, trials }) {
    const usual = {
      trial: Gaitcal.firstTrial(trials), seconds: 0, playing: false, speed: 1, window: null,
      preset: "clinician", layers: new Set(sheet ? Gaitcal.PRESETS.clinician.layers : Gaitcal.LAYERS), joint: null,
      axis: !sheet || sheet.trials.some(({ strides }) => strides.length) ? "percent" : "time", spread: "mean",
      unit: "Nm/kg", signs: "clinical", acting: "internal",
      nominal: false, norm: true, errors: true, truth: true, off: new Set(),
    };
    super(usual, Gaitcal.addressed(trials, sheet));
    Object.assign(this, { sheet, trials, lent: [] });
    const values = this.said();
    this.still = values.joint !== undefined || values.seconds !== undefined || values.window !== undefined;
    this.set(values);
    this.on(["playing"], () => this.soon());
  }

  // Another trial begins at its begin, a preset has its layers, and time has an end.
  following(values) {
    const next = { ...values };
    if ((next.trial ?? this.trial) !== this.trial) {
      next.seconds ??= 0;
      next.window ??= null;
    }
    const { duration } = this.trials[next.trial ?? this.trial].open();
    const inside = (seconds) => Math.min(duration, Math.max(0, seconds));
    if ("seconds" in next) next.seconds = inside(next.seconds);
    if (next.window) next.window = inside(next.window[1]) > inside(next.window[0]) ? next.window.map(inside) : null;
    if (next.preset && next.preset !== this.preset) {
      next.layers ??= this.near(new Set(Gaitcal.PRESETS[next.preset].layers), next);
    } else if ("joint" in next && Boolean(next.joint) !== Boolean(this.joint)) next.layers ??= this.near(this.layers, next);
    return next;
  }

  // A joint that is looked at shows its axes too, and they go again with it.
  near(layers, { joint = this.joint }) {
    const axes = ["nominal", "fitted", "uncertainty"];
    const own = [...layers].filter((layer) => joint !== null || !this.lent.includes(layer));
    this.lent = joint === null ? [] : axes.filter((layer) => !layers.has(layer));
    return new Set([...own, ...this.lent]);
  }

  // A joint may be all that the address says: view.html#knee_r
  said() {
    const joint = Gaitcal.jointNamed(window.location.hash.slice(1));
    return joint ? { joint, ...super.said() } : super.said();
  }

  soon() { if (!this.playing) super.soon(); }

  normal() {
    const layers = this.sheet ? Gaitcal.PRESETS[this.preset].layers : this.usual.layers;
    return { ...this.usual, layers: new Set([...layers, ...this.lent]) };
  }
};

Gaitcal.addressed = (trials, sheet) => {
  const milli = (value) => String(Math.round(1000 * value) / 1000);
  const among = (known) => ({
    read: (text) => new Set(known.filter((name) => text.split(",").includes(name))),
    write: (names) => [...names].sort().join(","),
  });
  // A trial is named by its name where that is short and its own, and by its number from 1 where not.
  const trial = {
    read: (text) => {
      const number = /^\d{1,4}$/.test(text) ? Number(text) - 1 : trials.findIndex(({ name }) => name === text);
      return trials[number] && number;
    },
    write: (index) => {
      const { name } = trials[index];
      const own = trials.filter((other) => other.name === name).length === 1;
      return own && name.length <= 80 && !/^\d+$/.test(name) ? name : String(index + 1);
    },
  };
  return {
    preset: Gaitcal.among(...Object.keys(Gaitcal.PRESETS)),
    axis: Gaitcal.among("percent", "time"),
    unit: Gaitcal.among("Nm", "Nm/kg", "%BWH"),
    signs: Gaitcal.among("opensim", "clinical"),
    acting: Gaitcal.among("internal", "external"),
    spread: Gaitcal.among("strides", "mean"),
    ...Object.fromEntries(["nominal", "norm", "errors", "truth"].map((field) => [field, Gaitcal.onOff])),
    joint: { read: Gaitcal.jointNamed, write: (joint) => joint ?? "" },
    speed: Gaitcal.among(...Gaitcal.SPEEDS),
    window: {
      read: (text) => {
        const [from, to] = text.split(",").map(Number.parseFloat);
        return from >= 0 && to > from ? [from, to] : undefined;
      },
      write: (window) => (window ?? []).map(milli).join(","),
    },
    layers: among(Gaitcal.LAYERS),
    off: among(Gaitcal.parts(sheet)),
    trial,
    seconds: { name: "t", read: (text) => [Number.parseFloat(text)].find(Number.isFinite), write: milli },
  };
};

// The keys of `state.off`: "trial", "trial/side/number"; trials are counted from 0.
Gaitcal.parts = (sheet) =>
  (sheet?.trials ?? []).flatMap((trial, t) => [`${t}`, ...trial.strides.map(({ side, number }) => `${t}/${side}/${number}`)]);
