"use strict";
// The people of a cohort: columns of their table, what is joined from them, and their mean curves.

// A name as it is shown where nobody gave one.
Gaitcal.EVERYONE = "everyone";
Gaitcal.UNGROUPED = "no group";

Gaitcal.VERDICTS = ["refused", "doubtful", "trustworthy"];

Gaitcal.People = class {
  // `content`: JSON of the page; `packed`: text of the curves, which is unpacked when it is asked for.
  constructor(content, packed) {
    Object.assign(this, content);
    this.packed = packed;
    this.count = content.about.results;
    this.raw = new Map(content.columns.map((column) => [column.name, Gaitcal.opened(column)]));
    this.all = [...Array(this.count).keys()];
    const grouped = this.all.some((i) => this.word("group", i));
    this.groupOf = this.all.map((i) => this.word("group", i) || (grouped ? Gaitcal.UNGROUPED : Gaitcal.EVERYONE));
    this.groups = [...new Set(this.groupOf)].sort();
    this.grouped = grouped;
    this.columns = Gaitcal.tableColumns(this);
  }

  word(column, i) {
    return this.raw.get(column)?.at(i) ?? "";
  }

  // Name and session.
  name(i) {
    return [this.word("person", i), this.word("session", i)].filter(Boolean).join(" ");
  }

  // The person's own page, from here; a folder's name may hold what an address may not.
  link(i) {
    const page = this.word("page", i) || "";
    return page && `./${page.split("/").map(encodeURIComponent).join("/")}`;
  }

  // Whether there are walks of which no stride counts.
  strideless(i) {
    return this.reasons.of[i].includes(this.reasons.strideless);
  }

  // Of the leg; of the person where the leg has none.
  legVerdict(i, side) {
    return this.word(`verdict_${side}`, i) || this.word("verdict", i);
  }

  get points() {
    return 100 / this.every + 1;
  }

  // Packed curve of a person, variable and leg; null where nothing is known of it.
  whole(i, variable, side) {
    this.integers ??= new Int16Array(Gaitcal.bytes(this.packed()));
    const begin = ((i * this.curves.length + variable) * 2 + (side === "r" ? 0 : 1)) * this.points;
    const found = this.integers.subarray(begin, begin + this.points);
    return found.some((value) => value !== Gaitcal.GAP) ? found : null;
  }
};

// A column of the page as {at(i)}: a number (NaN where there is none) or a word.
Gaitcal.opened = (column) => {
  if (column.words) return { ...column, text: true, at: (i) => column.words[column.of[i]] };
  const numbers = Gaitcal.floats(column.numbers);
  return { ...column, text: false, at: (i) => numbers[i] };
};
