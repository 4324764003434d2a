"use strict";
// How far the result can be believed: the strip on top of the page, and the reasons.

Gaitcal.capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

// Each judgement has a shape of its own, and its word beside it.
Gaitcal.JUDGEMENTS = {
  trustworthy: ["M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20z", "M7 12.5l3.5 3.5L17 9"],
  doubtful: ["M12 2.5L23 21.5H1z", "M12 9v6M12 17.6v1.6"],
  refused: ["M7.9 2h8.2L22 7.9v8.2L16.1 22H7.9L2 16.1V7.9z", "M8 8l8 8M16 8l-8 8"],
};

Gaitcal.judgement = (word) => {
  const [shape, mark] = Gaitcal.JUDGEMENTS[word] ?? ["M3 3h18v18H3z", "M8 12h8"];
  const icon = Gaitcal.svg(
    "svg",
    { class: "icon", viewBox: "0 0 24 24", width: 24, height: 24, "aria-hidden": "true" },
    Gaitcal.svg("path", { class: "shape", d: shape }),
    Gaitcal.svg("path", { class: "sign", d: mark }),
  );
  const kind = `judgement ${Gaitcal.JUDGEMENTS[word] ? word : ""}`;
  return Gaitcal.make(
    "span",
    { class: kind },
    icon,
    Gaitcal.make("strong", {}, Gaitcal.capital(Gaitcal.visible(word))),
  );
};

// The three lines; where there are none, the sentence of the verdict.
Gaitcal.verdictLines = (sheet) => {
  const lines = sheet.lines?.length ? sheet.lines : [{ tone: "plain", text: sheet.verdict.sentence }];
  const line = ({ tone, text }) => {
    const [mark, words] = Gaitcal.TONES[tone] ?? ["·", ""];
    return Gaitcal.make(
      "li",
      { class: tone },
      Gaitcal.make("span", { class: "mark", "aria-hidden": "true" }, mark),
      words ? Gaitcal.make("span", { class: "unseen" }, `${words}: `) : null,
      Gaitcal.make("span", {}, Gaitcal.visible(text)),
    );
  };
  return Gaitcal.make("ul", { class: "lines" }, ...lines.map(line));
};

Gaitcal.Verdict = class {
  constructor(host, page) {
    Object.assign(this, { host, page });
    page.state.on(["result", "second"], () => this.draw());
    this.draw();
  }

  draw() {
    const { results, state } = this.page;
    const { sheet } = this.page.result;
    this.host.hidden = !sheet;
    if (!sheet) return;
    const button = (result) => {
      const name =
        results.length > 1 ? Gaitcal.make("span", { class: "whose" }, Gaitcal.named(result.name), ": ") : null;
      const words = Gaitcal.make("span", { class: "unseen" }, ": why");
      const made = Gaitcal.make(
        "button",
        { type: "button", class: "judged" },
        name,
        Gaitcal.judgement(result.sheet.verdict.judgement),
        words,
      );
      made.addEventListener("click", () => state.set({ preset: "trust", result: results.indexOf(result) }));
      return made;
    };
    const shown = results.filter((result, index) => result.sheet && (index === state.result || state.second));
    const lines = Gaitcal.verdictLines(sheet);
    lines.id = "verdict-lines";
    this.host.replaceChildren(Gaitcal.make("div", { class: "judgements" }, ...shown.map(button), this.more(lines)), lines);
  }

  // Where the window is narrow, one line is shown until more is asked for.
  more(lines) {
    if (lines.children.length < 2) return null;
    const button = Gaitcal.make("button", { type: "button", class: "more", "aria-controls": lines.id });
    const write = () => {
      lines.classList.toggle("folded", !this.unfolded);
      button.setAttribute("aria-expanded", String(Boolean(this.unfolded)));
      button.textContent = this.unfolded ? "Less" : "More";
    };
    button.addEventListener("click", () => {
      this.unfolded = !this.unfolded;
      write();
    });
    write();
    return button;
  }
};

// Reasons of more letters than this are folded: what they make of the moments stands below them.
Gaitcal.FEW_LETTERS = 320;

// What speaks for a reason, and what to do about it.
Gaitcal.told = (evidence, action) => {
  const parts = [
    evidence ? Gaitcal.make("p", {}, Gaitcal.capital(Gaitcal.visible(evidence))) : null,
    action ? Gaitcal.make("p", {}, Gaitcal.make("strong", {}, "To do: "), Gaitcal.visible(action)) : null,
  ].filter(Boolean);
  if (evidence.length + action.length <= Gaitcal.FEW_LETTERS) return parts;
  return [Gaitcal.fold(action ? "What was found here, and what to do about it" : "What was found here", ...parts)];
};

// The page of a code, as `gaitcal explain` prints it, folded away below its reason.
Gaitcal.explanation = (code, page) => {
  const title = `What this means, and what to do: ${Gaitcal.visible(code)}`;
  const blocks = new Gaitcal.Blocks({ trial: null }, 2, title).all(page);
  const command = Gaitcal.make("p", { class: "soft" }, `The same on the command line: gaitcal explain ${code}`);
  const made = Gaitcal.fold(title, blocks, command);
  made.classList.add("explanation");
  return made;
};

// Sentence, reasons (the worst first), walks and legs: at the head of the preset trust.
Gaitcal.reasons = ({ verdict, trials }) => {
  const out = Gaitcal.make("div", {
    class: `reasons ${Gaitcal.JUDGEMENTS[verdict.judgement] ? verdict.judgement : ""}`,
  });
  out.append(
    Gaitcal.make("p", { class: "whole" }, Gaitcal.judgement(verdict.judgement), " ", Gaitcal.visible(verdict.sentence)),
  );
  const severities = { error: "error", warning: "warning", info: "to know" };
  const reason = ({ severity, cause, evidence, action, trials: where, leg, code, page }) => {
    const places = [
      ...where.map(Gaitcal.named),
      ...(Gaitcal.SIDE_WORDS[leg] ? [`${Gaitcal.SIDE_WORDS[leg]} leg`] : []),
    ];
    const listed = places.flatMap((place, k) => (k ? [", ", place] : [place]));
    return Gaitcal.make(
      "li",
      { class: severity },
      Gaitcal.tag(severities[severity] ?? severity, { error: "poor", warning: "look" }[severity]),
      " ",
      Gaitcal.make("strong", {}, Gaitcal.capital(Gaitcal.visible(cause))),
      places.length ? Gaitcal.make("span", { class: "soft" }, " ", ...listed) : null,
      ...Gaitcal.told(evidence, action),
      page?.length ? Gaitcal.explanation(code, page) : null,
    );
  };
  if (verdict.reasons.length) out.append(Gaitcal.make("ol", {}, ...verdict.reasons.map(reason)));
  const tones = { trustworthy: "good", doubtful: "look", refused: "poor" };
  const judged = trials.filter((trial) => trial.verdict);
  if (judged.length) {
    const cell = (word) => ({ t: word, tone: tones[word], align: "text" });
    const table = {
      head: ["Trial", ...["Verdict", "Right leg", "Left leg"].map((t) => ({ t, align: "text" }))],
      rows: judged.map(({ name, verdict: { judgement, r, l } }) => [name, cell(judgement), cell(r), cell(l)]),
    };
    const place = Gaitcal.scroller(Gaitcal.table(table, "Verdict of each trial"), "Verdict of each trial");
    const words = new Set(judged.flatMap(({ verdict: { judgement, r, l } }) => [judgement, r, l]));
    const alike = words.size === 1 && judged.length > 1;
    out.append(alike ? Gaitcal.fold(`All trials, both legs: ${[...words][0]}`, place) : place);
  }
  return out;
};
