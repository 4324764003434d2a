// Triage: how many are refused, doubtful, trustworthy or without a result, and why, the commonest cause first.
Gaitcal.CAUSES_AT_ONCE = 8;
Gaitcal.VERDICT_WORDS = {
  refused: "not to be used as they are",
  doubtful: "to be used knowing why",
  trustworthy: "nothing speaks against them",
  failed: "no result: each with its cause",
};

Gaitcal.triage = (host, people, choices) => {
  // A button that puts a filter on, and off again; of those without a result, one that leads to them.
  const filter = (words, field, value, attributes) => {
    if (value === "failed") return Gaitcal.button(words, () => Gaitcal.go("failures"), attributes);
    const turn = () => choices.set({ [field]: choices[field] === value ? "" : value });
    const button = Gaitcal.button(words, turn, attributes);
    const draw = () => button.setAttribute("aria-pressed", String(choices[field] === value));
    choices.on([field], draw);
    draw();
    return button;
  };
  const card = (word) => {
    const own = people.all.filter((i) => people.word("verdict", i) === word);
    const count = word === "failed" ? people.failures.length : own.length;
    const strideless = own.filter((i) => people.reasons.of[i].includes(people.reasons.strideless)).length;
    const words = [
      Gaitcal.judgement(word),
      html("span.value", String(count)),
      html("span.soft", Gaitcal.VERDICT_WORDS[word]),
      strideless > 0 && html("span.soft.strideless", `of these ${strideless} without a usable stride`),
    ];
    const tone = Gaitcal.JUDGEMENTS[word]?.tone ?? "";
    return html("li", filter(words, "verdict", word, { class: `card ${tone}`, disabled: count === 0 }));
  };
  const row = ({ severity, cause, actions, count }) => {
    const failed = severity === "failed";
    const most = Math.max(1, people.count + people.failures.length);
    const shown = Gaitcal.capital(Gaitcal.visible(cause));
    const button = filter(shown, "cause", failed ? severity : cause, { class: "plain-button" });
    const bar = svg("svg.share", { width: 90, height: 10, "aria-hidden": "true" },
      svg("rect.whole", { width: 90, height: 10 }),
      svg(`rect.${severity}`, { width: Math.max(2, (90 * count) / most).toFixed(1), height: 10 }),
    );
    const [action = "–", ...others] = actions;
    const more = others.length ? ` (and ${others.length} other wordings: see each person's page)` : "";
    const words = Gaitcal.visible(action + more);
    const begin = `${words.slice(0, 130).replace(/\s+\S*$/, "")} …`;
    return html("tr",
      html("th.text", { scope: "row" }, button),
      html("td.text.short", Gaitcal.tag(failed ? "no result" : severity, Gaitcal.SEVERITIES[severity])),
      html("td.text.short", html("strong", String(count)), " ", bar),
      html("td.text.action", words.length > 170 ? Gaitcal.fold(begin, html("p", words)) : words),
    );
  };
  const list = (entries, label) => {
    const head = ["Cause", "Severity", "People and sessions", "What to do"];
    const table = html("table.causes",
      html("caption", html("span", label)),
      html("thead", html("tr", head.map((text) => html("th.text", { scope: "col" }, text)))),
      html("tbody", entries.map(row)),
    );
    return Gaitcal.scroller(table, label);
  };
  const [first, rest] = [people.ranked.slice(0, Gaitcal.CAUSES_AT_ONCE), people.ranked.slice(Gaitcal.CAUSES_AT_ONCE)];
  Gaitcal.built(host, "", [
    html("ul.triage", Object.keys(Gaitcal.VERDICT_WORDS).map(card)),
    first.length ? list(first, "Causes, the commonest first") : html("p", "No cause for doubt was found in anybody."),
    rest.length > 0 && Gaitcal.fold(`${rest.length} more causes`, list(rest, "Further causes")),
  ]);
};
