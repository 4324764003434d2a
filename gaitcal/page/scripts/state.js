"use strict";
// What is chosen. Whoever draws listens to the fields that it shows; whoever is clicked sets them.
Gaitcal.PRESETS = [
  { name: "clinician", title: "Clinician", layers: ["body", "bones", "forces"] },
  { name: "fit", title: "Fit", layers: ["body", "measured", "model", "errors"] },
  { name: "joints", title: "Joints", layers: ["body", "bones", "nominal", "fitted", "uncertainty"] },
  { name: "trust", title: "Trust", layers: ["body", "bones", "forces"] },
  { name: "provenance", title: "Provenance", layers: ["body"] },
];

// The joints of curves and tables, and those of the linkage that each stands for.
Gaitcal.JOINTS = {
  hip: ["hip"], knee: ["knee"], ankle: ["talocrural", "subtalar"], trunk: ["back"], arm: ["shoulder", "elbow"], pelvis: [],
};

// "talocrural_r" as "ankle_r"; null where there is no such joint.
Gaitcal.jointNamed = (text) => {
  const [, name, side] = /^([a-z]+?)(_[rl])?$/.exec(text ?? "") ?? [];
  const found = Object.entries(Gaitcal.JOINTS).find(([joint, parts]) => joint === name || parts.includes(name));
  if (!found) return null;
  const paired = !["trunk", "pelvis"].includes(found[0]);
  return paired === Boolean(side) ? `${found[0]}${side ?? ""}` : null;
};

Gaitcal.State = class {
  // `results`: as the page holds them, with their trials.
  constructor(results) {
    this.results = results;
    this.listeners = [];
    this.lent = [];
    Object.assign(this, this.defaults());
  }

  defaults() {
    const trial = Gaitcal.firstTrial(this.results[0]);
    const sheet = this.results[0].sheet;
    return {
      result: 0,
      trial,
      seconds: 0,
      playing: false,
      speed: 1,
      window: null,
      preset: "clinician",
      layers: new Set(sheet ? Gaitcal.PRESETS[0].layers : Gaitcal.LAYERS.map(([name]) => name)),
      axis: !sheet || sheet.trials.some(({ strides }) => strides.length) ? "percent" : "time",
      unit: "Nm/kg",
      signs: "opensim",
      acting: "internal",
      nominal: false,
      norm: true,
      errors: true,
      truth: true,
      spread: "strides",
      off: new Set(),
      joint: null,
      second: this.results.length > 1,
    };
  }

  // `listener(state, changed)` is called after any of the fields has changed; `changed`: the Set of all that did.
  on(fields, listener) {
    this.listeners.push([fields, listener]);
  }

  set(values) {
    const changed = new Set();
    for (const [field, value] of Object.entries(this.following(values))) {
      if (Object.is(this[field], value)) continue;
      this[field] = value;
      changed.add(field);
    }
    if (changed.size === 0) return;
    for (const [fields, listener] of this.listeners) if (fields.some((field) => changed.has(field))) listener(this, changed);
  }

  // With what follows from a choice: another trial begins at its begin, a preset has its layers, and time has an end.
  following(values) {
    const next = { ...values };
    const result = next.result ?? this.result;
    if (result !== this.result) next.trial ??= Gaitcal.firstTrial(this.results[result]);
    if (result !== this.result || (next.trial ?? this.trial) !== this.trial) {
      next.seconds ??= 0;
      next.window ??= null;
    }
    const { duration } = this.results[result].trials[next.trial ?? this.trial].open();
    const inside = (seconds) => Math.min(duration, Math.max(0, seconds));
    if ("seconds" in next) next.seconds = inside(next.seconds);
    if (next.window) next.window = inside(next.window[1]) > inside(next.window[0]) ? next.window.map(inside) : null;
    if (next.preset && next.preset !== this.preset) {
      next.layers ??= this.near(new Set(Gaitcal.PRESETS.find(({ name }) => name === next.preset).layers), next);
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
};

// The trial that is shown first: the first walk.
Gaitcal.firstTrial = (result) => Math.max(0, result.trials.findIndex((trial) => trial.role === "gait"));
