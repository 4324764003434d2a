// The people of a cohort: columns of their table, and their mean curves.

// A name as it is shown where nobody gave one.
Gaitcal.EVERYONE = "everyone";
Gaitcal.UNGROUPED = "no group";

Gaitcal.VERDICTS = ["refused", "doubtful", "trustworthy"];

Gaitcal.People = class {
  // `content`: JSON of the page; `packed`: text of the curves, which is unpacked when it is asked for.
  constructor(content, packed) {
    Object.assign(this, content, { packed, count: content.about.results });
    this.columns = new Map();
    for (const column of content.columns) this.columns.set(column.name, this.opened(column));
    this.all = [...Array(this.count).keys()];
    this.grouped = this.all.some((i) => this.word("group", i));
    this.groupOf = this.all.map((i) => this.word("group", i) || (this.grouped ? Gaitcal.UNGROUPED : Gaitcal.EVERYONE));
    this.groups = [...new Set(this.groupOf)].sort();
    this.points = 100 / content.every + 1;
  }

  // A column with at(i): a word, or a number (NaN where there is none), its own or that of another column.
  opened(column) {
    const { words, numbers, of, sign, error } = column;
    if (words) return { ...column, text: true, at: (i) => words[of[i]] };
    const values = numbers && Gaitcal.floats(numbers);
    const at = numbers ? (i) => values[i] : (i) => sign * this.columns.get(of).at(i);
    return { ...column, text: false, at, error: error && ((i) => this.columns.get(error).at(i)) };
  }

  // What distributions can be of, over legs as they are chosen: measures (of both legs their mean), and every column of
  // numbers.
  distributed(legs) {
    const numbers = [...this.columns.values()].filter(({ text }) => !text);
    const out = new Map();
    for (const [name, columns] of Gaitcal.grouped(numbers, (column) => column.measure ?? column.name)) {
      const own = columns.filter(({ measure, side }) => !measure || legs === "both" || side === legs);
      const at = (i) => Gaitcal.average(own.map((column) => column.at(i))).mean;
      if (own.length) out.set(name, { ...own[0], name, at, legged: Boolean(own[0].measure) });
    }
    return out;
  }

  word(column, i) { return this.columns.get(column)?.at(i) ?? ""; }

  // Name and session.
  name(i) { return [this.word("person", i), this.word("session", i)].filter(Boolean).join(" "); }

  // The person's name, which leads to the own page where there is one; a folder's name may hold what an address may not.
  linked(i, name = this.name(i)) {
    const link = this.link(i);
    return link ? html("a", { href: link }, Gaitcal.named(name)) : Gaitcal.named(name);
  }

  link(i) {
    const page = this.word("page", i);
    return page && `./${page.split("/").map(encodeURIComponent).join("/")}`;
  }

  // Whether the curves of a leg are drawn; where the leg has no verdict, that of the person counts.
  takesPart(i, side, doubtful) {
    const verdict = this.word(`verdict_${side}`, i) || this.word("verdict", i);
    return verdict !== "refused" && (doubtful || verdict !== "doubtful");
  }

  // The curve (NaN in gaps) of a session of a person, the mean of its legs; null where no leg that takes part has one.
  curve(i, variable, { legs, doubtful }) {
    this.integers ??= new Int16Array(Gaitcal.bytes(this.packed()));
    const sides = (legs === "both" ? ["r", "l"] : [legs]).filter((side) => this.takesPart(i, side, doubtful));
    const curves = sides.map((side) => {
      const begin = ((i * this.curves.length + variable) * 2 + (side === "r" ? 0 : 1)) * this.points;
      const whole = [...this.integers.subarray(begin, begin + this.points)];
      return whole.map((value) => (value === Gaitcal.GAP ? NaN : value * this.curves[variable].step));
    }).filter((curve) => curve.some(Number.isFinite));
    return curves.length ? Gaitcal.averages(curves).mean : null;
  }

  // Group -> {mean, sd, n: of each point, people} of a variable over those who pass the filters: each person counts the
  // same, with the mean of its sessions.
  means(choices, variable) {
    const out = new Map();
    for (const [group, own] of Gaitcal.grouped(choices.filtered(), (i) => this.groupOf[i])) {
      const sessions = own.map((i) => [this.word("person", i), this.curve(i, variable, choices)]);
      const known = Gaitcal.grouped(sessions.filter(([, curve]) => curve), ([name]) => name);
      const people = [...known.values()].map((one) => Gaitcal.averages(one.map(([, curve]) => curve)).mean);
      if (people.length) out.set(group, { ...Gaitcal.averages(people), people: people.length });
    }
    return out;
  }
};

// A column's title, with its leg.
Gaitcal.columnWords = ({ title, side }) => (side ? `${title}, ${Gaitcal.LEGS[side]}` : title);
