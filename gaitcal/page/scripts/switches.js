"use strict";
// The controls of what is shown of the curves and in which convention; those without a meaning here are not shown. The
// usual ones stand in a row, the others behind a button that says which of them are not as they were at first.
Gaitcal.Switches = class {
  constructor(host, page) {
    const { state, results } = page;
    Object.assign(this, { page, state, writers: [] });
    const sheets = results.map(({ sheet }) => sheet).filter(Boolean);
    const trials = sheets.flatMap((sheet) => sheet.trials);
    const curves = trials.flatMap((trial) => trial.curves);
    const strides = trials.some((trial) => trial.strides.length > 0);
    const moments = curves.some(({ kind }) => kind === "moment");
    const has = (field) => curves.some((curve) => curve[field] !== null);
    const meant = {
      axis: strides,
      spread: strides,
      unit: moments,
      signs: moments,
      acting: moments,
      errors: has("se"),
      norm: sheets.some(({ bands }) => bands.length),
      nominal: has("nominal"),
      truth: has("truth"),
      second: results.length > 1,
    };
    for (const [field, on] of Object.entries(meant)) if (!on) Gaitcal.get(`switch-${field}`).closest("label").remove();
    const others = Gaitcal.get("switches-others");
    const parts = others.querySelector(".parts");
    if (trials.some((trial) => trial.strides.length > 1) || trials.length > 1) this.parts(parts);
    else parts.remove();
    // Whose moments, and which of their signs, without opening anything.
    const told = host.querySelector(".told");
    told.hidden = !moments;
    const more = Gaitcal.get("switches-more");
    more.hidden = others.children.length === 0;
    more.addEventListener("click", () => {
      others.hidden = !others.hidden;
      more.setAttribute("aria-expanded", String(!others.hidden));
    });
    this.writers.push(() => {
      const set = [...others.querySelectorAll("[data-field]")].filter(({ dataset }) => state[dataset.field] !== state.usual[dataset.field]);
      const words = [...set.map((control) => this.words(control)), ...(state.off.size ? ["strides left out"] : [])];
      more.textContent = words.length ? `More: ${words.join(", ")}` : "More";
      told.textContent = `${state.acting}, ${state.signs === "clinical" ? "clinical signs" : "OpenSim’s signs"}`;
    });
    state.on([...Object.keys(meant), "off"], () => this.write());
    this.write();
  }

  // A choice in words: "external", "no truth".
  words({ dataset, labels }) {
    const value = this.state[dataset.field];
    if (typeof value !== "boolean") return value;
    return value ? labels[0].textContent : `no ${labels[0].textContent}`;
  }

  write() {
    for (const writer of this.writers) writer();
  }

  // Which trials and strides take part in curves and means.
  parts(host) {
    const { state, page } = this;
    const keys = page.results.flatMap(Gaitcal.parts).filter((key) => key.split("/").length === 4);
    const taking = (key) => !state.off.has(key) && !state.off.has(key.split("/").slice(0, 2).join("/"));
    const summary = host.firstElementChild;
    this.writers.push(() => {
      const n = keys.filter(taking).length;
      summary.textContent = `Trials and strides: ${n === keys.length ? `all ${n}` : `${n} of ${keys.length} strides`}`;
    });
    const list = ({ name, sheet }, r) => [
      page.results.length > 1 && html("p", name),
      html("ul", sheet.trials.map((trial, t) => trial.strides.length > 0 && this.trial(`${r}/${t}`, trial))),
    ];
    Gaitcal.built(host, "", page.results.map((result, r) => result.sheet && list(result, r)));
  }

  trial(key, { name, strides }) {
    const title = ({ side, number, turns }) => `${Gaitcal.LEGS[side]} ${number}${turns ? " (turns)" : ""}`;
    const each = strides.map((stride) => this.part(`${key}/${stride.side}/${stride.number}`, title(stride)));
    return html("li", this.part(key, name), each);
  }

  part(key, title) {
    const { state } = this;
    const turn = (on) => {
      const off = new Set(state.off);
      if (on) off.delete(key);
      else off.add(key);
      state.set({ off });
    };
    const label = Gaitcal.tick(title, turn, { id: `part-${key.replaceAll("/", "-")}` });
    this.writers.push(() => {
      label.control.checked = !state.off.has(key);
    });
    return label;
  }
};
