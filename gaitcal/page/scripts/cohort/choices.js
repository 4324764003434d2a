"use strict";
// What is chosen: who is shown, in which order, and what of them. It stands in the address, so that a link opens it.
Gaitcal.ROWS = 50;

Gaitcal.Choices = class {
  constructor(people) {
    this.people = people;
    this.listeners = [];
    this.usual = {
      verdict: "",
      cause: "",
      group: "",
      find: "",
      tests: new Map(),
      sort: "verdict",
      page: 0,
      rows: Gaitcal.ROWS,
      legs: "both",
      doubtful: true,
      columns: Gaitcal.USUAL_COLUMNS.filter((name) => people.columns.has(name)),
      measures: Gaitcal.USUAL_MEASURES.filter((name) => Gaitcal.distributed(people, "both").has(name)),
      shown: [],
    };
    Object.assign(this, this.usual, this.read());
    window.addEventListener("hashchange", () => this.set({ ...this.usual, ...this.read() }));
  }

  // `listener(changed)` is called after any of the fields has changed.
  on(fields, listener) {
    this.listeners.push([fields, listener]);
  }

  set(values) {
    const changed = new Set(Object.keys(values).filter((field) => !Object.is(this[field], values[field])));
    if (changed.size === 0) return;
    Object.assign(this, values);
    const narrowed = Gaitcal.NARROWING.some((field) => changed.has(field));
    if (narrowed) this.kept = null;
    if (narrowed || changed.has("sort")) {
      this.ordered = null;
      if (!changed.has("page") && this.page) {
        this.page = 0;
        changed.add("page");
      }
    }
    for (const [fields, listener] of this.listeners) if (fields.some((field) => changed.has(field))) listener(changed);
    this.soon();
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

  get narrowed() {
    return (
      this.filtered().length < this.people.count || Gaitcal.NARROWING.some((field) => field !== "tests" && this[field])
    );
  }

  clear() {
    this.set(Object.fromEntries(Gaitcal.NARROWING.map((field) => [field, this.usual[field]])));
  }

  soon() {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.write(), 250);
  }

  write() {
    const said = new URLSearchParams();
    const usual = this.texts(this.usual);
    for (const [field, text] of Object.entries(this.texts(this))) if (text !== usual[field]) said.set(field, text);
    const text = said.toString();
    try {
      history.replaceState(null, "", text ? `#${text}` : window.location.pathname + window.location.search);
    } catch {
      // A browser that keeps the address of a file as it is: nothing else depends on it.
    }
  }

  texts(of) {
    const { people } = this;
    return {
      verdict: of.verdict,
      cause: of.cause,
      group: of.group,
      find: of.find,
      sort: of.sort,
      legs: of.legs,
      page: String(of.page),
      rows: String(of.rows),
      doubtful: String(Number(of.doubtful)),
      columns: of.columns.join(","),
      measures: of.measures.join(","),
      tests: JSON.stringify([...of.tests]),
      shown: JSON.stringify(of.shown.map((i) => people.name(i))),
    };
  }

  // What the address says, of what it may say.
  read() {
    const said = new URLSearchParams(window.location.hash.slice(1));
    const { people } = this;
    const out = {};
    for (const field of ["cause", "group", "find"]) if (said.has(field)) out[field] = said.get(field).slice(0, 300);
    if (Gaitcal.VERDICTS.includes(said.get("verdict"))) out.verdict = said.get("verdict");
    if (said.get("sort") === "" || people.columns.has((said.get("sort") ?? "").replace(/^-/, "")))
      out.sort = said.get("sort");
    if (["both", "r", "l"].includes(said.get("legs"))) out.legs = said.get("legs");
    for (const field of ["page", "rows"])
      if (/^\d{1,6}$/.test(said.get(field) ?? "")) out[field] = Number(said.get(field));
    if (said.has("doubtful")) out.doubtful = said.get("doubtful") !== "0";
    const known = { columns: people.columns, measures: Gaitcal.distributed(people, "both") };
    for (const [field, names] of Object.entries(known)) {
      const found = [...new Set((said.get(field) ?? "").split(","))].filter((name) => names.has(name));
      if (found.length || (field === "measures" && said.get(field) === "")) out[field] = found;
    }
    const tests = Gaitcal.listed(said.get("tests")).filter(
      (pair) => Array.isArray(pair) && people.columns.has(pair[0]),
    );
    if (tests.length) out.tests = new Map(tests.map(([name, text]) => [name, String(text).slice(0, 100)]));
    const names = new Set(Gaitcal.listed(said.get("shown")));
    if (names.size) out.shown = people.all.filter((i) => names.has(people.name(i))).slice(0, Gaitcal.MOST_SHOWN);
    return out;
  }
};

// Fields by which fewer people are shown.
Gaitcal.NARROWING = ["verdict", "cause", "group", "find", "tests"];

Gaitcal.listed = (text) => {
  try {
    const found = JSON.parse(text ?? "[]");
    return Array.isArray(found) ? found : [];
  } catch {
    return [];
  }
};
