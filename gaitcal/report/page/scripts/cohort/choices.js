// What is chosen: who is shown, in which order, and what of them.

// Fields by which fewer people are shown.
Gaitcal.NARROWING = ["verdict", "cause", "group", "find", "tests"];
Gaitcal.MOST_SHOWN = 4;

Gaitcal.Choices = class extends Gaitcal.Chosen {
  constructor(people) {
    const measures = people.distributed("both");
    const usual = {
      verdict: "",
      cause: "",
      group: "",
      find: "",
      tests: new Map(),
      sort: "verdict",
      page: 0,
      rows: 50,
      legs: "both",
      doubtful: true,
      columns: people.usual.columns.filter((name) => people.columns.has(name)),
      measures: people.usual.measures.filter((name) => measures.has(name)),
      shown: [],
    };
    super(usual, Gaitcal.addressed(people, measures));
    this.people = people;
    this.set(this.said());
  }

  said() { return { ...this.usual, ...super.said() }; }

  following(values) {
    const changed = (field) => field in values && !Object.is(values[field], this[field]);
    const narrowed = Gaitcal.NARROWING.some(changed);
    if (narrowed) this.kept = null;
    if (!narrowed && !changed("sort")) return values;
    this.ordered = null;
    return { page: 0, ...values };
  }

  // Everyone who passes all filters, in the order of the table of people.
  filtered() {
    this.kept ??= this.people.all.filter(Gaitcal.passing(this.people, this));
    return this.kept;
  }

  // The same in the order that is chosen; who has no value comes last.
  sorted() {
    const column = this.people.columns.get(this.sort.replace(/^-/, ""));
    if (!column) return this.filtered();
    const way = this.sort.startsWith("-") ? -1 : 1;
    const last = (value) => value === "" || Number.isNaN(value);
    const words = new Intl.Collator("en", { numeric: true });
    const rank = (verdict) => Gaitcal.VERDICTS.indexOf(verdict);
    const order = (a, b) => (column.name === "verdict" ? rank(a) - rank(b) : column.text ? words.compare(a, b) : a - b);
    this.ordered ??= this.filtered()
      .map((i) => [i, column.at(i)])
      .sort(([, a], [, b]) => (last(a) || last(b) ? last(a) - last(b) : way * order(a, b)))
      .map(([i]) => i);
    return this.ordered;
  }

  // The curves of a person are drawn over the means, or no longer; of so many the first goes.
  show(i, on = true) {
    const others = this.shown.filter((other) => other !== i);
    this.set({ shown: on ? [...others, i].slice(-Gaitcal.MOST_SHOWN) : others });
  }
};

Gaitcal.addressed = (people, measures) => {
  const words = { read: (text) => text.slice(0, 300) };
  const number = { read: (text) => (/^\d{1,6}$/.test(text) ? Number(text) : undefined) };
  const names = (known, none) => ({
    read: (text) => {
      const found = [...new Set(text.split(","))].filter((name) => known.has(name));
      return found.length || (none && text === "") ? found : undefined;
    },
    write: (list) => list.join(","),
  });
  const listed = (text) => {
    try {
      const found = JSON.parse(text);
      return Array.isArray(found) ? found : [];
    } catch {
      return [];
    }
  };
  return {
    verdict: Gaitcal.among(...Gaitcal.VERDICTS),
    cause: words,
    group: words,
    find: words,
    sort: { read: (text) => (text === "" || people.columns.has(text.replace(/^-/, "")) ? text : undefined) },
    legs: Gaitcal.among("both", "r", "l"),
    page: number,
    rows: number,
    doubtful: Gaitcal.onOff,
    columns: names(people.columns, false),
    measures: names(measures, true),
    tests: {
      read: (text) => {
        const known = listed(text).filter((pair) => Array.isArray(pair) && people.columns.has(pair[0]));
        return new Map(known.map(([name, test]) => [name, String(test).slice(0, 100)]));
      },
      write: (tests) => JSON.stringify([...tests]),
    },
    shown: {
      read: (text) => people.all.filter((i) => listed(text).includes(people.name(i))).slice(0, Gaitcal.MOST_SHOWN),
      write: (shown) => JSON.stringify(shown.map((i) => people.name(i))),
    },
  };
};
