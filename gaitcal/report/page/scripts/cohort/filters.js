// Who is shown: words and numbers that people are to have, and the line that says which filters are on.

// `>1.2`, `<= 3`, `1..2` (from, to), `=5`, `5` as a test of a number that is shown with so many digits; `?`: there is no
// number; null where the text is no test.
Gaitcal.numberTest = (text, digits = 2) => {
  const plain = text.trim().replace(/,/g, ".").replace(/[−–]/g, "-").replace("≥", ">=").replace("≤", "<=");
  if (plain === "?") return (value) => Number.isNaN(value);
  const number = "(-?\\d+(?:\\.\\d*)?|-?\\.\\d+)";
  const [, from, to] = new RegExp(`^${number}\\s*(?:\\.\\.+|…)\\s*${number}$`).exec(plain) ?? [];
  const [, sign, limit] = new RegExp(`^(>=|<=|>|<|=)?\\s*${number}$`).exec(plain) ?? [];
  if (from === undefined && limit === undefined) return null;
  const near = 0.5 * 10 ** -(digits ?? 0);
  const tests = {
    "..": (value) => value >= Number(from) && value <= Number(to),
    ">": (value) => value > Number(limit),
    "<": (value) => value < Number(limit),
    ">=": (value) => value >= Number(limit),
    "<=": (value) => value <= Number(limit),
    "=": (value) => Math.abs(value - Number(limit)) <= near,
  };
  const test = tests[from !== undefined ? ".." : (sign ?? "=")];
  // Numbers of the page have some seven digits: 1.2000000477 is 1.2.
  return (value) => test(Number(value.toPrecision(6)));
};

Gaitcal.wordTest = (text) => {
  const wanted = text.trim().toLowerCase();
  return (value) => String(value).toLowerCase().includes(wanted);
};

// The test that the text below a column is; null where it is none.
Gaitcal.columnTest = ({ text, digits }, words) => (text ? Gaitcal.wordTest(words) : Gaitcal.numberTest(words, digits));

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
    const test = text.trim() && Gaitcal.columnTest(column, text);
    if (test) all.push((i) => test(column.at(i)));
  }
  return (i) => all.every((test) => test(i));
};

// How many are shown, and what is filtered by, each with a button that takes it off.
Gaitcal.filters = (people, choices) => {
  const group = Gaitcal.get("group");
  for (const name of people.groups) group.add(new Option(Gaitcal.visible(name), name));
  if (people.groups.length < 2) group.closest("label").remove();
  const chip = (words, off) => {
    const label = { class: "chip", "aria-label": `Take off the filter: ${words}` };
    return Gaitcal.button([words, html("span", { "aria-hidden": "true" }, " ✕")], () => choices.set(off), label);
  };
  const draw = () => {
    document.querySelector("#people .count").textContent = `${choices.filtered().length} of ${people.count} shown`;
    const on = ["verdict", "cause", "group", "find"].filter((name) => choices[name]);
    const chips = on.map((name) => chip(`${name}: ${Gaitcal.visible(choices[name])}`, { [name]: "" }));
    for (const [name, text] of choices.tests) {
      const column = people.columns.get(name);
      const hint = Gaitcal.columnTest(column, text) ? "" : " (not understood; allowed: >1.2, <=3, 1..2, ?)";
      const others = new Map([...choices.tests].filter(([other]) => other !== name));
      chips.push(chip(`${Gaitcal.columnWords(column)}: ${Gaitcal.visible(text)}${hint}`, { tests: others }));
    }
    const none = Object.fromEntries(Gaitcal.NARROWING.map((name) => [name, choices.usual[name]]));
    if (chips.length > 1) chips.push(Gaitcal.button("Take off all", () => choices.set(none), { class: "chip" }));
    document.querySelector("#people .chips").replaceChildren(...chips.map((one) => html("li", one)));
  };
  choices.on(Gaitcal.NARROWING, draw);
  draw();
};
