"use strict";
// What is chosen stands in the address, so that a link opens what was seen: read at the start, written after a while of
// rest, and only what differs from the page as it opens. Whatever else stands there is passed over.
Gaitcal.Address = class {
  constructor(page) {
    this.page = page;
    this.state = page.state;
    this.later = null;
    this.fields = Gaitcal.addressed(page.results);
    this.read();
    this.state.on(["playing", "seconds", "result", "layers", ...Object.keys(this.fields)], () => this.soon());
    window.addEventListener("hashchange", () => this.read());
  }

  read() {
    const text = window.location.hash.slice(1);
    const joint = Gaitcal.jointNamed(text); // view.html#knee_r
    const said = new URLSearchParams(text);
    const values = joint ? { joint } : {};
    const result = Number(said.get("result")) - 1;
    if (Number.isInteger(result) && this.page.results[result]) values.result = result;
    const { trials } = this.page.results[values.result ?? this.state.result];
    const trial = Gaitcal.trialNamed(trials, said.get("trial"));
    if (trial !== null) values.trial = trial;
    for (const [field, read] of Object.entries(this.fields)) {
      const value = said.has(field) ? read(said.get(field)) : null;
      if (value !== null) values[field] = value;
    }
    const seconds = Number.parseFloat(said.get("t"));
    if (Number.isFinite(seconds)) values.seconds = seconds;
    this.said = { still: values.joint !== undefined || values.seconds !== undefined || values.window !== undefined };
    this.state.set(values);
  }

  soon() {
    if (this.state.playing) return;
    clearTimeout(this.later);
    this.later = setTimeout(() => this.write(), 250);
  }

  write() {
    const { state } = this;
    const usual = state.defaults();
    const said = new URLSearchParams();
    const layers = Gaitcal.PRESETS.find(({ name }) => name === state.preset).layers;
    const shown = [...(this.page.bare ? usual.layers : layers), ...state.lent];
    for (const field of Object.keys(this.fields)) {
      const text = Gaitcal.addressText(state[field]);
      const normal = field === "layers" ? Gaitcal.addressText(new Set(shown)) : Gaitcal.addressText(usual[field]);
      if (text !== normal) said.set(field, text);
    }
    if (state.result > 0) said.set("result", String(state.result + 1));
    const { trials } = this.page.result;
    if (state.trial !== Gaitcal.firstTrial(this.page.result)) said.set("trial", Gaitcal.trialText(trials, state.trial));
    if (state.seconds > 0) said.set("t", String(Math.round(1000 * state.seconds) / 1000));
    const text = said.toString();
    try {
      history.replaceState(null, "", text ? `#${text}` : window.location.pathname + window.location.search);
    } catch {
      // A browser that keeps the address of a file as it is: nothing else depends on it.
    }
  }
};

// For each field that the address holds, what its text stands for; null where it stands for nothing.
Gaitcal.addressed = (results) => {
  const among = (...values) => (text) => values.find((value) => value === text) ?? null;
  const onOff = (text) => ({ 1: true, 0: false })[text] ?? null;
  const speed = (text) => Gaitcal.SPEEDS.find((value) => String(value) === text) ?? null;
  const window = (text) => {
    const [from, to] = text.split(",").map(Number.parseFloat);
    return from >= 0 && to > from ? [from, to] : null;
  };
  const layers = (text) => new Set(Gaitcal.LAYERS.map(([name]) => name).filter((name) => text.split(",").includes(name)));
  const known = new Set(results.flatMap((result, r) => Gaitcal.parts(result, r)));
  const off = (text) => new Set(text.split(",").filter((key) => known.has(key)));
  return {
    preset: among(...Gaitcal.PRESETS.map(({ name }) => name)),
    axis: among("percent", "time"),
    unit: among("Nm", "Nm/kg", "%BWH"),
    signs: among("opensim", "clinical"),
    acting: among("internal", "external"),
    spread: among("strides", "mean"),
    nominal: onOff,
    norm: onOff,
    errors: onOff,
    truth: onOff,
    second: onOff,
    joint: Gaitcal.jointNamed,
    speed,
    window,
    layers,
    off,
  };
};

Gaitcal.addressText = (value) => {
  if (value === null) return "";
  if (value instanceof Set) return [...value].sort().join(",");
  if (Array.isArray(value)) return value.map((x) => String(Math.round(1000 * x) / 1000)).join(",");
  return typeof value === "boolean" ? String(Number(value)) : String(value);
};

// A trial is named by its name where that is short and its own, and by its number from 1 where not.
Gaitcal.trialText = (trials, index) => {
  const { name } = trials[index];
  const own = trials.filter((trial) => trial.name === name).length === 1;
  return own && name.length <= 80 && !/^\d+$/.test(name) ? name : String(index + 1);
};

Gaitcal.trialNamed = (trials, text) => {
  if (text === null) return null;
  const named = trials.findIndex(({ name }) => name === text);
  if (named >= 0 && !/^\d+$/.test(text)) return named;
  const number = /^\d{1,4}$/.test(text) ? Number(text) - 1 : -1;
  return trials[number] ? number : null;
};
