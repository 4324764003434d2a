// The page on paper, in the order of `gaitcal report`: verdict, strides and steps; kinematics; kinetics; then peaks, and what the
// preset that is shown tells.
Gaitcal.PAPER_WIDTH = 690; // px between the margins of a sheet (print.css)

// {build(), clear()}
Gaitcal.print = (host, page) => {
  const { curves } = page;
  const root = document.documentElement;
  let hidden = false;

  // Who, when, and how far it can be believed.
  const head = (sheet) => {
    const { person, verdict, made, program } = sheet;
    const about = [
      html("h1", Gaitcal.named(person.name)),
      html("p.soft", Gaitcal.facts(sheet)),
      html("p.soft", `Computed ${Gaitcal.visible(made)}, ${Gaitcal.visible(program)}`),
      html("p", Gaitcal.judgement(verdict.judgement)),
      Gaitcal.verdictLines(sheet),
    ];
    return html("header.leaf-head", about);
  };
  // Which strides count: what is ticked on the screen is said in words.
  const strides = () => {
    const copy = Gaitcal.get("counting").cloneNode(true);
    for (const box of copy.querySelectorAll("input")) box.replaceWith(box.checked ? "✓ " : "✕ ");
    return html("div.leaf-strides", [...copy.childNodes]);
  };
  const clear = () => {
    if (!host.hasChildNodes()) return;
    root.classList.remove("on-paper");
    curves.forPrint(false);
    curves.host.hidden = hidden;
    host.replaceChildren();
    host.classList.remove("for-print");
  };
  // Before a browser prints, nothing may wait: what is drawn here is drawn at once, in the colours of paper.
  const build = () => {
    clear();
    const { sheet } = page.result;
    root.classList.add("on-paper");
    hidden = curves.host.hidden;
    curves.host.hidden = false;
    curves.forPrint(true);
    const found = (selector) => [...curves.host.querySelectorAll(selector)];
    const copies = (selector) => found(selector).map((part) => part.cloneNode(true));
    const moved = (selector) => found(selector).filter((part) => part.querySelector(".curve-panel"));
    const [words, tables] = [true, false].map((text) =>
      Gaitcal.stepsParts(page).filter((part) => (part.tagName === "DETAILS") === text));
    host.classList.add("for-print");
    const comment = (section) => page.comments.of(section);
    host.append(
      html("section.leaf", head(sheet), comment("summary"), strides(),
        html("div.leaf-steps", tables, html("div.words", words)), comment("spatiotemporal")),
      html("section.leaf", copies(".curve-legend"), moved(".kinematics"), comment("kinematics"), copies(".curve-notes")),
      html("section.leaf", moved(".kinetics"), comment("kinetics")),
      html("section.appendix", comment("joints"), copies(".curve-peaks"),
        Gaitcal.presetParts({ page, cursors: [], wide: Gaitcal.PAPER_WIDTH }, sheet, page.state.preset, sheet.trials)),
    );
    for (const fold of host.querySelectorAll("details:not(.explanation)")) fold.open = true;
  };
  window.addEventListener("beforeprint", build);
  window.addEventListener("afterprint", clear);
  return { build, clear };
};
