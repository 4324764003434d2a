// Below the curves, what a preset tells: of the person first, then of the chosen trial. Trust tells in between what
// makes the error of the trial's peak moments, as the person is asked about that first.

// What one preset tells: of the person, then of `trials` of the sheet. `scope`: as of `Gaitcal.Blocks`.
Gaitcal.presetParts = (scope, sheet, preset, trials) => {
  const [title, own] = [Gaitcal.PRESETS[preset].title, sheet.sections?.[preset] ?? []];
  const trust = preset === "trust";
  const ofPerson = (blocks) => new Gaitcal.Blocks({ ...scope, trial: null }, 2, title).all(blocks);
  const ofTrial = (trial) => {
    const blocks = trial.sections?.[preset];
    if (!blocks?.length) return null;
    const name = Gaitcal.visible(trial.name);
    const told = blocks[0].kind === "heading" && Gaitcal.visible(blocks[0].text).includes(name);
    const above = !told && html("h2", "Trial ", Gaitcal.named(trial.name), ", ", Gaitcal.visible(trial.role));
    return html("div.of-trial", above, new Gaitcal.Blocks({ ...scope, trial }, told ? 1 : 2, `Trial ${name}`).all(blocks));
  };
  const heading = own.findIndex(({ kind }) => kind === "heading");
  const first = trust && heading >= 0 ? heading : own.length;
  return [
    (own.length > 0 || trust) && html("h2", title),
    trust && Gaitcal.reasons(sheet),
    ofPerson(own.slice(0, first)),
    trials.map(ofTrial),
    first < own.length && [html("h2.of-all", "The whole calibration"), ofPerson(own.slice(first))],
  ];
};

Gaitcal.sections = (host, page) => {
  const { state } = page;
  const cursors = [];
  const title = (fold) => fold.firstElementChild.textContent;
  const follow = () => { for (const cursor of cursors) cursor(state.seconds, !state.playing); };
  // What a reader has unfolded stays so in another trial.
  const draw = () => {
    const { sheet } = page.result;
    const open = new Set([...host.querySelectorAll("details[open]")].map(title));
    const shown = page.sheet ? [page.sheet] : [];
    cursors.length = 0;
    host.replaceChildren();
    Gaitcal.built(host, "", Gaitcal.presetParts({ page, cursors }, sheet, state.preset, shown));
    host.hidden = !host.hasChildNodes();
    for (const fold of host.querySelectorAll("details")) fold.open = open.has(title(fold));
    follow();
  };
  state.on(["preset", "trial"], draw);
  state.on(["seconds", "playing"], follow);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
};
