"use strict";
// Who is shown: words and numbers that people are to have, and the line that says which filters are on.

// `>1.2`, `<= 3`, `1..2` (from, to), `=5`, `5` as a test of a number that is shown with so many digits; `?`: there is no
// number; null where the text is no test.
Gaitcal.numberTest = (text, digits = 2) => {
  const plain = text.trim().replace(/,/g, ".").replace(/[−–]/g, "-");
  if (plain === "?") return (value) => Number.isNaN(value);
  const number = "(-?\\d+(?:\\.\\d*)?|-?\\.\\d+)";
  const range = new RegExp(`^${number}\\s*(?:\\.\\.+|…)\\s*${number}$`).exec(plain);
  // Numbers of the page have some seven digits: 1.2000000477 is 1.2.
  const own = (test) => (value) => test(Number(value.toPrecision(6)));
  if (range) return own((value) => value >= Number(range[1]) && value <= Number(range[2]));
  const found = new RegExp(`^(>=|<=|>|<|=|≥|≤)?\\s*${number}$`).exec(plain);
  if (!found) return null;
  const limit = Number(found[2]);
  const near = 0.5 * 10 ** -(digits ?? 0);
  return own(
    {
      ">": (value) => value > limit,
      "<": (value) => value < limit,
      ">=": (value) => value >= limit,
      "≥": (value) => value >= limit,
      "<=": (value) => value <= limit,
      "≤": (value) => value <= limit,
    }[found[1]] ?? ((value) => Math.abs(value - limit) <= near),
  );
};

Gaitcal.wordTest = (text) => {
  const wanted = text.trim().toLowerCase();
  return (value) => String(value).toLowerCase().includes(wanted);
};

// Whether a person passes all filters, as a function of the person.
Gaitcal.passing = (people, { verdict, cause, group, find, tests }) => {
  const all = [];
  if (verdict) all.push((i) => people.word("verdict", i) === verdict);
  if (group) all.push((i) => people.groupOf[i] === group);
  if (cause) all.push((i) => people.reasons.of[i].some((k) => people.reasons.causes[k].cause === cause));
  if (find.trim()) {
    const has = Gaitcal.wordTest(find);
    all.push((i) => has(people.name(i)) || has(people.groupOf[i]) || has(people.word("first_cause", i)));
  }
  for (const [name, text] of tests) {
    const column = people.columns.get(name);
    const test = column.text ? Gaitcal.wordTest(text) : Gaitcal.numberTest(text, column.digits);
    if (test && text.trim()) all.push((i) => test(column.at(i)));
  }
  return (i) => all.every((test) => test(i));
};

// Find, group, and what is filtered by, each with a button that takes it off.
Gaitcal.Filters = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices });
    const find = Gaitcal.make("input", { type: "search", id: "find", autocomplete: "off", spellcheck: "false" });
    find.addEventListener("input", () => choices.set({ find: find.value }));
    this.find = find;
    const bar = Gaitcal.make(
      "div",
      { class: "bar" },
      Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Find"), find),
    );
    if (people.groups.length > 1) {
      const all = Gaitcal.make("option", { value: "" }, "all groups");
      const options = people.groups.map((group) => Gaitcal.make("option", { value: group }, Gaitcal.visible(group)));
      this.group = Gaitcal.make("select", { id: "group" }, all, ...options);
      this.group.addEventListener("change", () => choices.set({ group: this.group.value }));
      bar.append(Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Group"), this.group));
    }
    this.said = Gaitcal.make("p", { class: "count", role: "status" });
    this.chips = Gaitcal.make("ul", { class: "chips", "aria-label": "Filters that are on" });
    host.append(bar, this.chips);
    this.bar = bar;
    bar.append(this.said);
    choices.on(Gaitcal.NARROWING, () => this.draw());
    this.draw();
  }

  draw() {
    const { choices, people } = this;
    if (this.find.value !== choices.find) this.find.value = choices.find;
    if (this.group) this.group.value = choices.group;
    const number = choices.filtered().length;
    this.said.textContent = `${number} of ${people.count} shown`;
    const chip = (words, off) => {
      const button = Gaitcal.make(
        "button",
        { type: "button", class: "chip" },
        words,
        Gaitcal.make("span", { "aria-hidden": "true" }, " ✕"),
      );
      button.setAttribute("aria-label", `Take off the filter: ${words}`);
      button.addEventListener("click", off);
      return Gaitcal.make("li", {}, button);
    };
    const chips = [];
    for (const field of ["verdict", "cause", "group", "find"]) {
      if (choices[field])
        chips.push(chip(`${field}: ${Gaitcal.visible(choices[field])}`, () => choices.set({ [field]: "" })));
    }
    for (const [name, text] of choices.tests) {
      const column = people.columns.get(name);
      const valid = column.text || Gaitcal.numberTest(text, column.digits);
      const hint = valid ? "" : " (not understood; allowed: >1.2, <=3, 1..2, ?)";
      const words = `${Gaitcal.columnWords(column)}: ${Gaitcal.visible(text)}${hint}`;
      chips.push(
        chip(words, () => choices.set({ tests: new Map([...choices.tests].filter(([other]) => other !== name)) })),
      );
    }
    if (chips.length > 1) {
      const none = Gaitcal.make("button", { type: "button", class: "chip" }, "Take off all");
      none.addEventListener("click", () => choices.clear());
      chips.push(Gaitcal.make("li", {}, none));
    }
    this.chips.replaceChildren(...chips);
  }
};

Gaitcal.columnWords = ({ title, side }) => (side ? `${title}, ${Gaitcal.SIDE_WORDS[side]}` : title);
