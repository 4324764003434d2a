"use strict";
// The controls of what is shown of the curves and in which convention; those without a meaning here are not shown. The
// usual ones stand in a row, the others behind a button that says which of them are not as they were at first.
Gaitcal.USUAL = ["axis", "spread", "unit", "errors", "norm"];

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
      [strides, "spread", "Strides", [["strides", "every stride"], ["mean", "mean \u00b1 SD"]]],
      [moments, "unit", "Moments", [["Nm/kg", "N\u00b7m/kg"], ["Nm", "N\u00b7m"], ["%BWH", "% BW\u00b7H"]]],
      [moments, "signs", "Signs", [["opensim", "OpenSim"], ["clinical", "clinical"]]],
      [moments, "acting", "Moments are", [["internal", "internal"], ["external", "external"]]],
    ].filter(([meant]) => meant);
    const boxes = [
      [has("se"), "errors", "standard errors"],
      [sheets.some(({ bands }) => bands.length), "norm", "norm band"],
      [has("nominal"), "nominal", "nominal model"],
      [has("truth"), "truth", "truth"],
      [page.results.length > 1, "second", "second result"],
    ].filter(([meant]) => meant);
    const fields = [...choices, ...boxes].map(([, field]) => field);
    const usual = (field) => Gaitcal.USUAL.includes(field);
    const made = (wanted) => [
      ...choices.filter(([, field]) => usual(field) === wanted).map(([, ...choice]) => this.choice(...choice)),
      ...boxes.filter(([, field]) => usual(field) === wanted).map(([, ...box]) => this.box(...box)),
    ];
    const rest = made(false);
    if (trials.some((trial) => trial.strides.length > 1) || trials.length > 1) rest.push(this.parts());
    const [button, others] = rest.length ? this.more(rest, fields.filter((field) => !usual(field))) : [];
    host.append(...[...made(true), button, moments ? this.convention() : null, others].filter(Boolean));
    this.state.on([...fields, "off"], () => this.write());
    this.write();
  }

  // Whose moments, and which of their signs, without opening anything.
  convention() {
    const told = Gaitcal.element("span", "", "told");
    told.title = "Moments";
    this.writers.push(() => {
      const signs = this.state.signs === "clinical" ? "clinical signs" : "OpenSim\u2019s signs";
      told.textContent = `${this.state.acting}, ${signs}`;
    });
    return told;
  }

  // The button, and what it opens.
  more(rest, fields) {
    const button = Gaitcal.element("button", "", "more");
    Object.assign(button, { type: "button", id: "switches-more" });
    const others = Gaitcal.element("div", "", "others");
    others.id = "switches-others";
    others.append(...rest);
    button.setAttribute("aria-controls", others.id);
    const open = (on) => {
      others.hidden = !on;
      button.setAttribute("aria-expanded", String(on));
    };
    button.addEventListener("click", () => open(others.hidden));
    open(false);
    const first = this.state.defaults();
    this.writers.push(() => {
      const set = fields.filter((field) => this.state[field] !== first[field]).map((field) => this.words(field));
      if (this.state.off.size) set.push("strides left out");
      button.textContent = set.length ? `More: ${set.join(", ")}` : "More";
    });
    return [button, others];
  }

  // A choice in words: "external", "no truth".
  words(field) {
    const value = this.state[field];
    if (typeof value !== "boolean") return value;
    const title = document.getElementById(`switch-${field}`).labels[0].textContent;
    return value ? title : `no ${title}`;
  }

  write() {
    for (const writer of this.writers) writer();
  }

  choice(field, title, options) {
    const label = Gaitcal.element("label", "", "pick");
    label.title = title;
    label.append(Gaitcal.element("span", title, Gaitcal.USUAL.includes(field) ? "unseen" : ""));
    const select = document.createElement("select");
    select.id = `switch-${field}`;
    for (const [value, text] of options) select.add(new Option(text, value));
    select.addEventListener("change", () => this.state.set({ [field]: select.value }));
    this.writers.push(() => (select.value = this.state[field]));
    label.append(select);
    return label;
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
