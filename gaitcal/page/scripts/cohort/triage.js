"use strict";
// Triage: how many are refused, doubtful, trustworthy or without a result, and why, the commonest cause first.
Gaitcal.CAUSES_AT_ONCE = 8;
Gaitcal.VERDICT_WORDS = {
  refused: "not to be used as they are",
  doubtful: "to be used knowing why",
  trustworthy: "nothing speaks against them",
  failed: "no result: each with its cause",
};
Gaitcal.SEVERITIES = { error: "poor", warning: "look", failed: "poor" };

Gaitcal.Triage = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices });
    this.buttons = [];
    const cards = Gaitcal.make(
      "ul",
      { class: "cards triage" },
      ...["refused", "doubtful", "trustworthy", "failed"].map((word) => this.card(word)),
    );
    host.append(cards, this.causes());
    choices.on(["verdict", "cause"], () => this.draw());
    this.draw();
  }

  card(word) {
    const { people } = this;
    const failed = word === "failed";
    const own = people.all.filter((i) => people.word("verdict", i) === word);
    const count = failed ? people.failures.length : own.length;
    const strideless = own.filter((i) => people.strideless(i)).length;
    const tone = { refused: "poor", doubtful: "look", trustworthy: "good", failed: "" }[word];
    const button = Gaitcal.make(
      "button",
      { type: "button", class: `card ${tone}`, disabled: count === 0 },
      Gaitcal.judgement(word),
      Gaitcal.make("span", { class: "value" }, String(count)),
      Gaitcal.make("span", { class: "soft" }, Gaitcal.VERDICT_WORDS[word]),
      strideless
        ? Gaitcal.make("span", { class: "soft strideless" }, `of these ${strideless} without a usable stride`)
        : null,
    );
    if (failed) button.addEventListener("click", () => Gaitcal.go("failures"));
    else this.toggle(button, "verdict", word);
    return Gaitcal.make("li", {}, button);
  }

  // A button that puts a filter on, and off again.
  toggle(button, field, value) {
    button.addEventListener("click", () => this.choices.set({ [field]: this.choices[field] === value ? "" : value }));
    this.buttons.push([button, field, value]);
  }

  draw() {
    for (const [button, field, value] of this.buttons)
      button.setAttribute("aria-pressed", String(this.choices[field] === value));
  }

  // Each cause once, those of failures too, the one of most people first.
  ranked() {
    const { people } = this;
    const found = new Map();
    const note = (severity, cause, action) => {
      const entry = found.get(cause) ?? { severity, cause, actions: new Set(), count: 0 };
      if (severity === "error") entry.severity = severity;
      if (action) entry.actions.add(action);
      return found.set(cause, entry).get(cause);
    };
    for (const indices of people.reasons.of) {
      const own = new Set(
        indices
          .map((k) => people.reasons.causes[k])
          .map(({ severity, cause, action }) => note(severity, cause, action)),
      );
      for (const entry of own) entry.count++;
    }
    for (const { cause, what_to_do: action } of people.failures) note("failed", cause, action).count++;
    return [...found.values()].sort((a, b) => b.count - a.count || (a.cause < b.cause ? -1 : 1));
  }

  causes() {
    const ranked = this.ranked();
    if (!ranked.length) return Gaitcal.make("p", {}, "No cause for doubt was found in anybody.");
    const [first, rest] = [ranked.slice(0, Gaitcal.CAUSES_AT_ONCE), ranked.slice(Gaitcal.CAUSES_AT_ONCE)];
    const out = Gaitcal.make("div", {}, this.list(first, "Causes, the commonest first"));
    if (rest.length) out.append(Gaitcal.fold(`${rest.length} more causes`, this.list(rest, "Further causes")));
    return out;
  }

  list(entries, label) {
    const most = Math.max(1, this.people.count + this.people.failures.length);
    const head = ["Cause", "Severity", "People and sessions", "What to do"].map((text) =>
      Gaitcal.make("th", { scope: "col", class: "text" }, text),
    );
    const rows = entries.map((entry) => this.row(entry, most));
    const table = Gaitcal.make(
      "table",
      { class: "causes" },
      Gaitcal.make("caption", {}, Gaitcal.make("span", {}, label)),
      Gaitcal.make("thead", {}, Gaitcal.make("tr", {}, ...head)),
      Gaitcal.make("tbody", {}, ...rows),
    );
    return Gaitcal.scroller(table, label);
  }

  row({ severity, cause, actions, count }, most) {
    const button = Gaitcal.make(
      "button",
      { type: "button", class: "plain-button" },
      Gaitcal.capital(Gaitcal.visible(cause)),
    );
    if (severity === "failed") button.addEventListener("click", () => Gaitcal.go("failures"));
    else this.toggle(button, "cause", cause);
    const bar = Gaitcal.svg(
      "svg",
      { class: "share", width: 90, height: 10, "aria-hidden": "true" },
      Gaitcal.svg("rect", { class: "whole", width: 90, height: 10 }),
      Gaitcal.svg("rect", { class: severity, width: Math.max(2, (90 * count) / most).toFixed(1), height: 10 }),
    );
    const [action = "–", ...others] = [...actions];
    const words = others.length ? `${action} (and ${others.length} other wordings: see each person's page)` : action;
    const long = words.length > 170;
    const told = long
      ? Gaitcal.fold(`${words.slice(0, 130).replace(/\s+\S*$/, "")} …`, Gaitcal.make("p", {}, Gaitcal.visible(words)))
      : Gaitcal.visible(words);
    const word = severity === "failed" ? "no result" : severity;
    return Gaitcal.make(
      "tr",
      {},
      Gaitcal.make("th", { scope: "row", class: "text" }, button),
      Gaitcal.make("td", { class: "text short" }, Gaitcal.tag(word, Gaitcal.SEVERITIES[severity])),
      Gaitcal.make("td", { class: "text short" }, Gaitcal.make("strong", {}, String(count)), " ", bar),
      Gaitcal.make("td", { class: "text action" }, told),
    );
  }
};
