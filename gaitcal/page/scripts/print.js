// The page on paper, in the order of `gaitcal report`: verdict, strides and steps; kinematics; kinetics; then everything that
// any preset tells, as appendix.
Gaitcal.PAPER_WIDTH = 690; // px between the margins of a sheet (print.css)

// {build(), clear()}
Gaitcal.print = (host, page) => {
  const { curves, stage } = page;
  const root = document.documentElement;
  let hidden = false;

  // A copy of what the stage shows, on white.
  const body = () => {
    if (!stage) return null;
    const { renderer, scene, camera } = stage.viewer;
    const source = renderer.domElement;
    const { width, height } = source;
    if (!width || !height) return null;
    stage.painted();
    renderer.render(scene, camera);
    const [wide, high] = [Math.min(width, height), Math.min(height, 1.25 * width)];
    const words = { role: "img", "aria-label": "The body, as the page showed it" };
    const copy = html("canvas.leaf-body", { width: wide, height: high, ...words });
    copy.getContext("2d").drawImage(source, (width - wide) / 2, (height - high) / 2, wide, high, 0, 0, wide, high);
    return copy;
  };
  // Who, when, how far it can be believed, and the body as it stands now.
  const head = (sheet) => {
    const { person, verdict, made, program } = sheet;
    const about = [
      html("h1", Gaitcal.named(person.name)),
      html("p.soft", Gaitcal.facts(sheet)),
      html("p.soft", `Computed ${Gaitcal.visible(made)}, ${Gaitcal.visible(program)}`),
      html("p", Gaitcal.judgement(verdict.judgement)),
      Gaitcal.verdictLines(sheet),
    ];
    return html("header.leaf-head", html("div", about), body());
  };
  // Which strides count: what is ticked on the screen is said in words.
  const strides = () => {
    const copy = Gaitcal.get("counting").cloneNode(true);
    for (const box of copy.querySelectorAll("input")) box.replaceWith(box.checked ? "✓ " : "✕ ");
    return html("div.leaf-strides", [...copy.childNodes]);
  };
  const appendix = (sheet) => {
    const scope = { page, cursors: [], wide: Gaitcal.PAPER_WIDTH };
    const part = (preset) => html("section.preset", Gaitcal.presetParts(scope, sheet, preset, sheet.trials));
    return Object.keys(Gaitcal.PRESETS).map(part);
  };
  // What speaks against the result is printed, and what a reader has unfolded, or everything on demand; what is left
  // out is counted, and named where it stands.
  const unfold = () => {
    const title = (summary) => summary.textContent;
    const open = new Set([...document.querySelectorAll("#panel details[open] > summary")].map(title));
    const every = Gaitcal.get("print-all").checked;
    const folds = [...host.querySelectorAll("details")];
    const against = (fold) => fold.closest(".reasons") !== null && !fold.classList.contains("explanation");
    for (const fold of folds) fold.open = every || against(fold) || open.has(title(fold.firstElementChild));
    const left = folds.filter((fold) => !fold.open && !fold.parentElement.closest("details:not([open])")).length;
    const words =
      `${left} parts that are folded on the screen are not printed; their titles stand where they belong. To print ` +
      "them too: Layers, About this page.";
    if (left) host.querySelector(".appendix").prepend(html("p.soft.left-out", words));
  };
  const clear = () => {
    if (!host.hasChildNodes()) return;
    root.classList.remove("on-paper");
    stage?.painted();
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
      html("section.appendix", comment("joints"), copies(".curve-peaks"), appendix(sheet)),
    );
    unfold();
  };
  window.addEventListener("beforeprint", build);
  window.addEventListener("afterprint", clear);
  return { build, clear };
};
