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
    // [whether it means something here, field, title, options]; without options it is on or off.
    const all = [
      [strides, "axis", "Axis", [["percent", "% gait cycle"], ["time", "time"]]],
      [strides, "spread", "Strides", [["strides", "every stride"], ["mean", "mean ± SD"]]],
      [moments, "unit", "Moments", [["Nm/kg", "N·m/kg"], ["Nm", "N·m"], ["%BWH", "% BW·H"]]],
      [moments, "signs", "Signs", [["opensim", "OpenSim"], ["clinical", "clinical"]]],
      [moments, "acting", "Moments are", [["internal", "internal"], ["external", "external"]]],
      [has("se"), "errors", "standard errors"],
      [sheets.some(({ bands }) => bands.length), "norm", "norm band"],
      [has("nominal"), "nominal", "nominal model"],
      [has("truth"), "truth", "truth"],
      [page.results.length > 1, "second", "second result"],
    ].filter(([meant]) => meant);
    const fields = all.map(([, field]) => field);
    const made = (wanted) =>
      all.filter(([, field]) => Gaitcal.USUAL.includes(field) === wanted).map(([, ...one]) => this.made(...one));
    this.writers = [];
    Gaitcal.dress(host, { role: "group", "aria-label": "How curves are drawn" });
    const rest = made(false);
    if (trials.some((trial) => trial.strides.length > 1) || trials.length > 1) rest.push(this.parts());
    const others = html("div.others", { id: "switches-others", hidden: true }, rest);
    const more = rest.length ? this.more(others, fields.filter((field) => !Gaitcal.USUAL.includes(field))) : "";
    host.append(...made(true), more, moments ? this.convention() : "", rest.length ? others : "");
    this.state.on([...fields, "off"], () => this.write());
    this.write();
  }

  // Whose moments, and which of their signs, without opening anything.
  convention() {
    const told = html("span.told", { title: "Moments" });
    this.writers.push(() => {
      const signs = this.state.signs === "clinical" ? "clinical signs" : "OpenSim’s signs";
      told.textContent = `${this.state.acting}, ${signs}`;
    });
    return told;
  }

  // The button that opens the others and names those of them that are not as at first.
  more(others, fields) {
    const { state } = this;
    const button = Gaitcal.button("", () => open(others.hidden), {
      class: "more", id: "switches-more", "aria-controls": others.id,
    });
    const open = (on) => {
      others.hidden = !on;
      button.setAttribute("aria-expanded", String(on));
    };
    open(false);
    this.writers.push(() => {
      const set = fields.filter((field) => state[field] !== state.usual[field]).map((field) => this.words(field));
      if (state.off.size) set.push("strides left out");
      button.textContent = set.length ? `More: ${set.join(", ")}` : "More";
    });
    return button;
  }

  // A choice in words: "external", "no truth".
  words(field) {
    const value = this.state[field];
    if (typeof value !== "boolean") return value;
    const title = Gaitcal.get(`switch-${field}`).labels[0].textContent;
    return value ? title : `no ${title}`;
  }

  write() {
    for (const writer of this.writers) writer();
  }

  made(field, title, options) {
    const { state } = this;
    const id = `switch-${field}`;
    const change = (value) => state.set({ [field]: value });
    if (!options) return this.tick(title, id, () => state[field], change);
    const select = Gaitcal.select(options, change, { id });
    this.writers.push(() => {
      select.value = state[field];
    });
    const hidden = Gaitcal.USUAL.includes(field) && { class: "unseen" };
    return html("label.pick", { title }, html("span", hidden, title), select);
  }

  tick(title, id, read, change) {
    const label = Gaitcal.tick(title, change, { id });
    this.writers.push(() => {
      label.control.checked = read();
    });
    return label;
  }

  // Which trials and strides take part in curves and means.
  parts() {
    const { state, page } = this;
    const keys = page.results.flatMap(Gaitcal.parts).filter((key) => key.split("/").length === 4);
    const taking = (key) => !state.off.has(key) && !state.off.has(key.split("/").slice(0, 2).join("/"));
    const summary = html("summary");
    this.writers.push(() => {
      const n = keys.filter(taking).length;
      summary.textContent = `Trials and strides: ${n === keys.length ? `all ${n}` : `${n} of ${keys.length} strides`}`;
    });
    const list = ({ name, sheet }, r) => [
      page.results.length > 1 && html("p", name),
      html("ul", sheet.trials.map((trial, t) => trial.strides.length > 0 && this.trial(`${r}/${t}`, trial))),
    ];
    return html("details.parts", summary, page.results.map((result, r) => result.sheet && list(result, r)));
  }

  trial(key, { name, strides }) {
    const title = ({ side, number, turns }) => `${Gaitcal.LEGS[side]} ${number}${turns ? " (turns)" : ""}`;
    const each = strides.map((stride) => this.part(`${key}/${stride.side}/${stride.number}`, title(stride)));
    return html("li", this.part(key, name), each);
  }

  part(key, title) {
    const { state } = this;
    return this.tick(title, `part-${key.replaceAll("/", "-")}`, () => !state.off.has(key), (on) => {
      const off = new Set(state.off);
      if (on) off.delete(key);
      else off.add(key);
      state.set({ off });
    });
  }
};
