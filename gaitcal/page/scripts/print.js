"use strict";
// The page on paper: verdict and kinematics; kinetics and steps; then everything that any preset tells, as appendix.
Gaitcal.PAPER_WIDTH = 690; // px between the margins of a sheet (print.css)

Gaitcal.Print = class {
  constructor(host, page) {
    Object.assign(this, { host, page });
    window.addEventListener("beforeprint", () => this.build());
    window.addEventListener("afterprint", () => this.clear());
  }

  // Before a browser prints, nothing may wait: what is drawn here is drawn at once, in the colours of paper.
  build() {
    this.clear();
    const { sheet } = this.page.result;
    if (!sheet) return;
    document.documentElement.classList.add("on-paper");
    const { curves } = this.page;
    const { host } = curves;
    this.hidden = host.hidden;
    host.hidden = false;
    curves.forPrint(true);
    const copies = (selector) => [...host.querySelectorAll(selector)].map((part) => part.cloneNode(true));
    const moved = (selector) =>
      [...host.querySelectorAll(selector)].filter((part) => part.querySelector(".curve-panel"));
    const steps = Gaitcal.stepsParts(this.page);
    const [words, tables] = [true, false].map((of) => steps.filter((part) => (part.tagName === "P") === of));
    const beside = html("div.words", words, copies(".curve-notes"));
    this.host.classList.add("for-print");
    this.host.append(
      html("section.leaf", this.head(sheet), copies(".curve-legend"), moved(".kinematics")),
      html("section.leaf", moved(".kinetics"), html("div.leaf-steps", tables, beside)),
      html("section.appendix", copies(".curve-peaks"), this.appendix(sheet)),
    );
    this.unfold();
  }

  // What speaks against the result is printed, and what a reader has unfolded, or everything on demand; what is left
  // out is counted, and named where it stands.
  unfold() {
    const title = (summary) => summary.textContent;
    const open = new Set([...document.querySelectorAll("#panel details[open] > summary")].map(title));
    const every = Gaitcal.get("print-all").checked;
    const folds = [...this.host.querySelectorAll("details")];
    const against = (fold) => fold.closest(".reasons") !== null && !fold.classList.contains("explanation");
    for (const fold of folds) fold.open = every || against(fold) || open.has(title(fold.firstElementChild));
    const left = folds.filter((fold) => !fold.open && !fold.parentElement.closest("details:not([open])")).length;
    if (!left) return;
    const words =
      `${left} parts that are folded on the screen are not printed; their titles stand where they belong. To print ` +
      "them too: Layers, About this page.";
    this.host.querySelector(".appendix").prepend(html("p.soft.left-out", words));
  }

  clear() {
    if (!this.host.hasChildNodes()) return;
    const { curves, stage } = this.page;
    document.documentElement.classList.remove("on-paper");
    stage.painted();
    curves.forPrint(false);
    curves.host.hidden = this.hidden;
    this.host.replaceChildren();
    this.host.classList.remove("for-print");
  }

  // Who, when, how far it can be believed, and the body as it stands now.
  head({ person, verdict, made, program, lines }) {
    const size = [`${Gaitcal.numeral(person.mass)} kg`, `${Gaitcal.numeral(person.height, 2)} m`];
    const facts = [person.session, ...size, made, program].filter(Boolean);
    return html("header.leaf-head",
      html("div",
        html("h1", Gaitcal.named(person.name)),
        html("p.soft", facts.map(Gaitcal.visible).join(" · ")),
        html("p", Gaitcal.judgement(verdict.judgement)),
        Gaitcal.verdictLines({ verdict, lines }),
      ),
      this.body(),
    );
  }

  // A copy of what the stage shows, on white.
  body() {
    const { stage } = this.page;
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
  }

  appendix(sheet) {
    const scope = { page: this.page, cursors: [], wide: Gaitcal.PAPER_WIDTH };
    return Object.keys(Gaitcal.TITLES).map((preset) =>
      html("section.preset", Gaitcal.presetParts(scope, sheet, preset, sheet.trials)));
  }
};
