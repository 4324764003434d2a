"use strict";
// Below the curves, what a preset tells: of the person first, then of the chosen trial.

Gaitcal.PRESETS = {
  clinician: "Walking",
  fit: "How well the model follows the markers",
  joints: "Joints and segments",
  trust: "Can it be believed?",
  provenance: "Where it comes from",
};

// Everything of one preset; `trials` (of the sheet) that it goes on with; `steps`: an element, or null.
Gaitcal.presetParts = (page, sheet, preset, trials, { steps = null, cursors = [], level = 2 } = {}) => {
  const title = Gaitcal.PRESETS[preset] ?? "";
  const out = document.createDocumentFragment();
  out.append(Gaitcal.make(`h${level}`, {}, title));
  if (preset === "clinician" && steps) out.append(steps);
  if (preset === "trust") out.append(Gaitcal.reasons(sheet));
  out.append(new Gaitcal.Blocks({ page, trial: null, cursors }, level, title).all(sheet.sections?.[preset]));
  for (const trial of trials) {
    const blocks = trial.sections?.[preset];
    if (!blocks?.length) continue;
    const name = Gaitcal.visible(trial.name);
    const heading = Gaitcal.make(`h${level}`, {}, "Trial ", Gaitcal.named(trial.name), ", ", Gaitcal.visible(trial.role));
    out.append(heading, new Gaitcal.Blocks({ page, trial, cursors }, level, `Trial ${name}`).all(blocks));
  }
  return out;
};

Gaitcal.Sections = class {
  constructor(page) {
    this.page = page;
    this.host = document.getElementById("sections");
    this.steps = new Gaitcal.Steps(page);
    this.cursors = [];
    page.state.on(["preset", "trial", "result"], () => this.draw());
    page.state.on(["seconds", "playing"], () => this.follow());
    this.draw();
  }

  // What a reader has unfolded stays so in another trial.
  draw() {
    const { results, state } = this.page;
    const { sheet } = results[state.result];
    this.host.hidden = !sheet;
    if (!sheet) return;
    const summaries = () => [...this.host.querySelectorAll("details")].map((fold) => [fold, fold.firstElementChild.textContent]);
    const open = new Set(summaries().filter(([fold]) => fold.open).map(([, title]) => title));
    this.cursors.length = 0;
    const trial = sheet.trials[state.trial];
    const { steps, cursors } = this;
    this.host.replaceChildren(
      Gaitcal.presetParts(this.page, sheet, state.preset, trial ? [trial] : [], { steps: steps.element, cursors }),
    );
    for (const [fold, title] of summaries()) fold.open = open.has(title);
    this.follow();
  }

  follow() {
    const { seconds, playing } = this.page.state;
    for (const cursor of this.cursors) cursor(seconds, !playing);
  }
};
