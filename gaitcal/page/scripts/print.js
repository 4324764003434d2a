"use strict";
// The page on paper: verdict and kinematics; kinetics and steps; then everything that any preset tells, as appendix.
Gaitcal.Print = class {
  constructor(host, page) {
    Object.assign(this, { host, page });
    window.addEventListener("beforeprint", () => this.build());
    window.addEventListener("afterprint", () => this.clear());
  }

  // Before a browser prints, nothing may wait: what is drawn here is drawn at once.
  build() {
    this.clear();
    const { sheet } = this.page.result;
    if (!sheet) return;
    const curves = this.curves();
    this.host.classList.add("for-print");
    this.host.append(
      Gaitcal.make("section", { class: "leaf" }, this.head(sheet), ...curves.legend, ...curves.kinematics),
      Gaitcal.make("section", { class: "leaf" }, ...curves.kinetics, this.steps(curves.notes)),
      Gaitcal.make("section", { class: "appendix" }, ...curves.peaks, ...this.appendix(sheet)),
    );
    this.unfold();
  }

  // What speaks against the result is printed, and what a reader has unfolded, or everything on demand; what is left
  // out is counted, and named where it stands.
  unfold() {
    const open = new Set(
      [...document.querySelectorAll("#panel details[open] > summary")].map(({ textContent }) => textContent),
    );
    const every = document.getElementById("print-all").checked;
    const folds = [...this.host.querySelectorAll("details")];
    const against = (fold) => fold.closest(".reasons") !== null && !fold.classList.contains("explanation");
    for (const fold of folds) fold.open = every || against(fold) || open.has(fold.firstElementChild.textContent);
    const left = folds.filter((fold) => !fold.open && !fold.parentElement.closest("details:not([open])")).length;
    if (!left) return;
    const words = `${left} parts that are folded on the screen are not printed; their titles stand where they belong. To print them too: Layers, About this page.`;
    this.host.querySelector(".appendix").prepend(Gaitcal.make("p", { class: "soft left-out" }, words));
  }

  clear() {
    if (!this.host.hasChildNodes()) return;
    const { curves } = this.page;
    curves?.forPrint(false);
    if (curves) curves.host.hidden = this.hidden;
    this.host.replaceChildren();
    this.host.classList.remove("for-print");
  }

  // Who, when, how far it can be believed, and the body as it stands now.
  head(sheet) {
    const { person, verdict } = sheet;
    const facts = [
      person.session,
      `${Gaitcal.numeral(person.mass)} kg`,
      `${Gaitcal.numeral(person.height, 2)} m`,
      sheet.made,
      sheet.program,
    ];
    return Gaitcal.make(
      "header",
      { class: "leaf-head" },
      Gaitcal.make(
        "div",
        {},
        Gaitcal.make("h1", {}, Gaitcal.named(person.name)),
        Gaitcal.make("p", { class: "soft" }, facts.filter(Boolean).map(Gaitcal.visible).join(" · ")),
        Gaitcal.make("p", {}, Gaitcal.judgement(verdict.judgement)),
        Gaitcal.verdictLines(sheet),
      ),
      this.body(),
    );
  }

  // The table, and beside it what is said of it and of the curves.
  steps(notes) {
    const parts = Gaitcal.stepsParts(this.page);
    const words = parts.filter((part) => part.tagName === "P");
    const tables = parts.filter((part) => part.tagName !== "P");
    return Gaitcal.make(
      "div",
      { class: "leaf-steps" },
      ...tables,
      Gaitcal.make("div", { class: "words" }, ...words, ...notes),
    );
  }

  // A copy of what the stage shows, on white.
  body() {
    const { viewer } = this.page.stage;
    const source = viewer.renderer.domElement;
    const [width, height] = [source.width, source.height];
    if (!width || !height) return null;
    document.documentElement.classList.add("on-paper");
    this.page.stage.painted();
    viewer.renderer.render(viewer.scene, viewer.camera);
    const [wide, high] = [Math.min(width, height), Math.min(height, 1.25 * width)];
    const copy = Gaitcal.make("canvas", {
      class: "leaf-body",
      role: "img",
      "aria-label": "The body, as the page showed it",
    });
    Object.assign(copy, { width: wide, height: high });
    copy.getContext("2d").drawImage(source, (width - wide) / 2, (height - high) / 2, wide, high, 0, 0, wide, high);
    document.documentElement.classList.remove("on-paper");
    this.page.stage.painted();
    return copy;
  }

  // The panels of both pages, light and sharp, with what is said of them.
  curves() {
    const { curves } = this.page;
    if (!curves) return { legend: [], kinematics: [], kinetics: [], notes: [], peaks: [] };
    this.hidden = curves.host.hidden;
    curves.host.hidden = false;
    curves.forPrint(true);
    const copies = (selector) => [...curves.host.querySelectorAll(selector)].map((part) => part.cloneNode(true));
    const moved = (selector) =>
      [...curves.host.querySelectorAll(selector)].filter((part) => part.querySelector(".curve-panel"));
    return {
      legend: copies(".curve-legend"),
      kinematics: moved(".kinematics"),
      kinetics: moved(".kinetics"),
      notes: copies(".curve-notes"),
      peaks: copies(".curve-peaks"),
    };
  }

  appendix(sheet) {
    const scope = { page: this.page, cursors: [] };
    return Object.keys(Gaitcal.TITLES).map((preset) => {
      const part = Gaitcal.make("section", { class: "preset" });
      part.append(Gaitcal.presetParts(scope, sheet, preset, sheet.trials));
      return part;
    });
  }
};
