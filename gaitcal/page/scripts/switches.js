"use strict";
// The controls of what is shown of the curves and in which convention; those without a meaning here are not shown.
Gaitcal.Switches = class {
  constructor(host, page) {
    this.page = page;
    this.state = page.state;
    const sheets = page.results.map(({ sheet }) => sheet).filter(Boolean);
    const trials = sheets.flatMap((sheet) => sheet.trials);
    const curves = trials.flatMap((trial) => trial.curves);
    const strides = trials.some((trial) => trial.strides.length > 0);
    const moments = curves.some(({ kind }) => kind === "moment");
    const has = (field) => curves.some((curve) => curve[field] !== null);
    this.writers = [];
    host.setAttribute("role", "group");
    host.setAttribute("aria-label", "How curves are drawn");
    const choices = [
      [strides, "axis", "Axis", [["percent", "% gait cycle"], ["time", "time"]]],
      [strides, "spread", "Strides", [["strides", "every one"], ["mean", "mean \u00b1 SD"]]],
      [moments, "unit", "Moments", [["Nm/kg", "N\u00b7m/kg"], ["Nm", "N\u00b7m"], ["%BWH", "% BW\u00b7H"]]],
      [moments, "signs", "Signs", [["opensim", "OpenSim"], ["clinical", "clinical"]]],
      [moments, "acting", "Acting", [["internal", "internal"], ["external", "external"]]],
    ];
    for (const [meant, field, title, options] of choices) if (meant) host.append(this.choice(field, title, options));
    const boxes = [
      [has("se"), "errors", "standard errors"],
      [sheets.some(({ bands }) => bands.length), "norm", "norm band"],
      [has("nominal"), "nominal", "nominal model"],
      [has("truth"), "truth", "truth"],
      [page.results.length > 1, "second", "second result"],
    ].filter(([meant]) => meant);
    if (boxes.length) host.append(this.group("Draw", boxes.map(([, field, title]) => this.box(field, title))));
    if (trials.some((trial) => trial.strides.length > 1) || trials.length > 1) host.append(this.parts());
    const fields = [...choices.map(([, field]) => field), "errors", "norm", "nominal", "truth", "second", "off"];
    this.state.on(fields, () => this.write());
    this.write();
  }

  write() {
    for (const writer of this.writers) writer();
  }

  choice(field, title, options) {
    const label = Gaitcal.element("label", title, "pick");
    const select = document.createElement("select");
    select.id = `switch-${field}`;
    for (const [value, text] of options) select.add(new Option(text, value));
    select.addEventListener("change", () => this.state.set({ [field]: select.value }));
    this.writers.push(() => (select.value = this.state[field]));
    label.append(select);
    return label;
  }

  group(title, boxes) {
    const set = document.createElement("fieldset");
    set.append(Gaitcal.element("legend", title), ...boxes);
    return set;
  }

  box(field, title) {
    return this.tick(title, `switch-${field}`, () => this.state[field], (on) => this.state.set({ [field]: on }));
  }

  tick(title, id, read, write) {
    const label = Gaitcal.element("label", title, "tick");
    const input = document.createElement("input");
    input.type = "checkbox";
    input.id = id;
    input.addEventListener("change", () => write(input.checked));
    this.writers.push(() => (input.checked = read()));
    label.prepend(input);
    return label;
  }

  // Which trials and strides take part in curves and means.
  parts() {
    const details = Gaitcal.element("details", "", "parts");
    const summary = document.createElement("summary");
    details.append(summary);
    const all = this.page.results.flatMap((result, r) => Gaitcal.parts(result, r));
    const keys = all.filter((key) => key.split("/").length === 4);
    const taking = (key) => !this.state.off.has(key) && !this.state.off.has(key.split("/").slice(0, 2).join("/"));
    this.writers.push(() => {
      const n = keys.filter(taking).length;
      summary.textContent = `Trials and strides: ${n === keys.length ? `all ${n}` : `${n} of ${keys.length} strides`}`;
    });
    for (const [r, { name, sheet }] of this.page.results.entries()) {
      if (!sheet) continue;
      const list = document.createElement("ul");
      if (this.page.results.length > 1) details.append(Gaitcal.element("p", name));
      for (const [t, trial] of sheet.trials.entries()) if (trial.strides.length) list.append(this.trial(`${r}/${t}`, trial));
      details.append(list);
    }
    return details;
  }

  trial(key, trial) {
    const item = document.createElement("li");
    item.append(this.part(key, trial.name));
    for (const { side, number, turns } of trial.strides) {
      const title = `${Gaitcal.SIDES[side]} ${number}${turns ? " (turns)" : ""}`;
      item.append(this.part(`${key}/${side}/${number}`, title));
    }
    return item;
  }

  part(key, title) {
    return this.tick(title, `part-${key.replaceAll("/", "-")}`, () => !this.state.off.has(key), (on) => {
      const off = new Set(this.state.off);
      if (on) off.delete(key);
      else off.add(key);
      this.state.set({ off });
    });
  }
};

// An element with a text and a class.
Gaitcal.element = (name, text, kind = "") => {
  const element = document.createElement(name);
  element.textContent = text;
  if (kind) element.className = kind;
  return element;
};

// The keys of `state.off`: "result/trial", "result/trial/side/number", all counted from 0 but the stride's own number.
Gaitcal.parts = ({ sheet }, r) =>
  (sheet?.trials ?? []).flatMap((trial, t) => [
    `${r}/${t}`,
    ...trial.strides.map(({ side, number }) => `${r}/${t}/${side}/${number}`),
  ]);
