// How far the result can be believed: the strip on top of the page, and the reasons.

// Each judgement has a shape of its own, its word beside it, and a tone.
Gaitcal.JUDGEMENTS = {
  trustworthy: { shape: "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20z", sign: "M7 12.5l3.5 3.5L17 9", tone: "good" },
  doubtful: { shape: "M12 2.5L23 21.5H1z", sign: "M12 9v6M12 17.6v1.6", tone: "look" },
  refused: { shape: "M7.9 2h8.2L22 7.9v8.2L16.1 22H7.9L2 16.1V7.9z", sign: "M8 8l8 8M16 8l-8 8", tone: "poor" },
};
Gaitcal.SEVERITIES = { error: "poor", warning: "look", failed: "poor" };

Gaitcal.judgement = (word) => {
  const known = Object.hasOwn(Gaitcal.JUDGEMENTS, word);
  const { shape, sign } = known ? Gaitcal.JUDGEMENTS[word] : { shape: "M3 3h18v18H3z", sign: "M8 12h8" };
  return html("span.judgement", { class: known && word },
    svg("svg.icon", { viewBox: "0 0 24 24", width: 24, height: 24, "aria-hidden": "true" },
      svg("path.shape", { d: shape }), svg("path.sign", { d: sign })),
    html("strong", Gaitcal.capital(Gaitcal.visible(word))),
  );
};

// The three lines; where there are none, the sentence of the verdict.
Gaitcal.verdictLines = (sheet) => {
  const lines = sheet.lines?.length ? sheet.lines : [{ tone: "plain", text: sheet.verdict.sentence }];
  const line = ({ tone, text }) => {
    const [mark, words] = Gaitcal.TONES[tone] ?? ["·", ""];
    return html("li", { class: tone },
      html("span.mark", { "aria-hidden": "true" }, mark),
      words && html("span.unseen", `${words}: `),
      html("span", Gaitcal.visible(text)),
    );
  };
  return html("ul.lines", lines.map(line));
};

// Who it is, and of which session, in one line: what study and recordings tell, or that they do not.
Gaitcal.facts = ({ person }) =>
  person.facts.slice(1).map(([label, value]) => `${label}: ${Gaitcal.visible(value)}`).join(" · ");

Gaitcal.verdict = (host, page) => {
  const { result: { sheet }, state } = page;
  // Where the window is narrow, one line is shown until more is asked for.
  let unfolded = false;
  const more = (lines) => {
    const button = Gaitcal.button("", () => write(!unfolded), { class: "more", "aria-controls": lines.id });
    const write = (on) => {
      unfolded = on;
      lines.classList.toggle("folded", !on);
      button.setAttribute("aria-expanded", String(on));
      button.textContent = on ? "Less" : "More";
    };
    write(unfolded);
    return button;
  };
  const words = [Gaitcal.judgement(sheet.verdict.judgement), html("span.unseen", ": why")];
  const judged = Gaitcal.button(words, () => state.set({ preset: "trust" }), { class: "judged" });
  const lines = Gaitcal.verdictLines(sheet);
  lines.id = "verdict-lines";
  const buttons = [judged, lines.children.length > 1 && more(lines)];
  host.replaceChildren(html("div.judgements", buttons), lines, html("p.facts.soft", Gaitcal.facts(sheet)));
};

// Reasons of more letters than this are folded: what they make of the moments stands below them.
Gaitcal.FEW_LETTERS = 320;

// What speaks for a reason, and what to do about it.
Gaitcal.told = (evidence, action) => {
  const parts = [
    evidence && html("p", Gaitcal.capital(Gaitcal.visible(evidence))),
    action && html("p", html("strong", "To do: "), Gaitcal.visible(action)),
  ];
  if (evidence.length + action.length <= Gaitcal.FEW_LETTERS) return parts;
  return Gaitcal.fold(action ? "What was found here, and what to do about it" : "What was found here", parts);
};

// The page of a code, as `gaitcal explain` prints it, folded away below its reason.
Gaitcal.explanation = (code, page) => {
  const title = `What this means, and what to do: ${Gaitcal.visible(code)}`;
  const command = html("p.soft", `The same on the command line: gaitcal explain ${code}`);
  const made = Gaitcal.fold(title, new Gaitcal.Blocks({ trial: null }, 2, title).all(page), command);
  made.classList.add("explanation");
  return made;
};

// Sentence, reasons (the worst first), walks and legs: at the head of the preset trust.
Gaitcal.reasons = ({ verdict, trials }) => {
  const reason = ({ severity, cause, evidence, action, trials: where, leg, code, page }) => {
    const legs = Gaitcal.LEGS[leg] ? [`${Gaitcal.LEGS[leg]} leg`] : [];
    const places = [...where.map(Gaitcal.named), ...legs].flatMap((place, k) => (k ? [", ", place] : [place]));
    return html("li", { class: severity },
      Gaitcal.tag(severity === "info" ? "to know" : severity, Gaitcal.SEVERITIES[severity]),
      " ",
      html("strong", Gaitcal.capital(Gaitcal.visible(cause))),
      places.length > 0 && html("span.soft", " ", places),
      Gaitcal.told(evidence, action),
      page?.length > 0 && Gaitcal.explanation(code, page),
    );
  };
  const judged = trials.filter((trial) => trial.verdict);
  const cell = (word) => ({ t: word, tone: Gaitcal.JUDGEMENTS[word]?.tone, align: "text" });
  const title = "Verdict of each trial";
  const table = {
    head: ["Trial", ...["Verdict", "Right leg", "Left leg"].map((t) => ({ t, align: "text" }))],
    rows: judged.map(({ name, verdict: { judgement, r, l } }) => [name, cell(judgement), cell(r), cell(l)]),
  };
  const place = judged.length > 0 && Gaitcal.scroller(Gaitcal.table(table, title), title);
  const known = Object.hasOwn(Gaitcal.JUDGEMENTS, verdict.judgement);
  return html("div.reasons", { class: known && verdict.judgement },
    html("p.whole", Gaitcal.judgement(verdict.judgement), " ", Gaitcal.visible(verdict.sentence)),
    verdict.reasons.length > 0 && html("ol", verdict.reasons.map(reason)),
    place,
  );
};
