"use strict";
// Below the curves, what a preset tells: of the person first, then of the chosen trial. Trust tells in between what
// makes the error of the trial's peak moments, as the person is asked about that first.

Gaitcal.TITLES = {
  clinician: "About these curves",
  fit: "The fit of the model",
  joints: "Joints and segments",
  trust: "Can it be believed?",
  provenance: "Where it comes from",
};

// What one preset tells: of the person, then of `trials` of the sheet. `scope`: as of `Gaitcal.Blocks`.
Gaitcal.presetParts = (scope, sheet, preset, trials) => {
  const out = document.createDocumentFragment();
  const [title, own] = [Gaitcal.TITLES[preset] ?? "", sheet.sections?.[preset] ?? []];
  const trust = preset === "trust";
  if (own.length || trust) out.append(Gaitcal.make("h2", {}, title));
  if (trust) out.append(Gaitcal.reasons(sheet));
  const heading = own.findIndex(({ kind }) => kind === "heading");
  const first = trust && heading >= 0 ? heading : own.length;
  out.append(new Gaitcal.Blocks({ ...scope, trial: null }, 2, title).all(own.slice(0, first)));
  for (const trial of trials) {
    const blocks = trial.sections?.[preset];
    if (!blocks?.length) continue;
    const name = Gaitcal.visible(trial.name);
    const told = blocks[0].kind === "heading" && Gaitcal.visible(blocks[0].text).includes(name);
    const above = Gaitcal.make("h2", {}, "Trial ", Gaitcal.named(trial.name), ", ", Gaitcal.visible(trial.role));
    const parts = new Gaitcal.Blocks({ ...scope, trial }, told ? 1 : 2, `Trial ${name}`).all(blocks);
    out.append(Gaitcal.make("div", { class: "of-trial" }, told ? null : above, parts));
  }
  if (first < own.length) {
    out.append(Gaitcal.make("h2", { class: "of-all" }, "The whole calibration"));
    out.append(new Gaitcal.Blocks({ ...scope, trial: null }, 2, title).all(own.slice(first)));
  }
  return out;
};

Gaitcal.Sections = class {
  constructor(host, page) {
    Object.assign(this, { host, page, cursors: [] });
    page.state.on(["preset", "trial", "result"], () => this.draw());
    page.state.on(["seconds", "playing"], () => this.follow());
    this.draw();
  }

  // What a reader has unfolded stays so in another trial.
  draw() {
    const { page, host, cursors } = this;
    const { sheet } = page.result;
    const summaries = () =>
      [...host.querySelectorAll("details")].map((fold) => [fold, fold.firstElementChild.textContent]);
    const open = new Set(
      summaries()
        .filter(([fold]) => fold.open)
        .map(([, title]) => title),
    );
    cursors.length = 0;
    const parts = sheet
      ? Gaitcal.presetParts({ page, cursors }, sheet, page.state.preset, page.sheet ? [page.sheet] : [])
      : "";
    host.replaceChildren(parts);
    host.hidden = !host.hasChildNodes();
    for (const [fold, title] of summaries()) fold.open = open.has(title);
    this.follow();
  }

  follow() {
    const { seconds, playing } = this.page.state;
    for (const cursor of this.cursors) cursor(seconds, !playing);
  }
};
