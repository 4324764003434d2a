"use strict";
// The page of a cohort, all together.
Gaitcal.FILES = {
  "people.csv": "the table of people",
  "people.parquet": "the same, for programs",
  "columns.csv": "what its columns mean",
  "cycles.parquet": "every stride of everyone",
  "failures.csv": "who has no result",
  "manifest.json": "settings and hashes",
};

// A part of the page comes into view; the address keeps what is chosen.
Gaitcal.go = (id) => {
  Gaitcal.get(id).scrollIntoView({ block: "start" });
  Gaitcal.get(`${id}-title`).focus({ preventScroll: true });
};

// A table of words.
Gaitcal.wordTable = (head, rows, label) => {
  const texts = (row) => row.map((t) => ({ t, align: "text" }));
  return Gaitcal.table({ head: texts(head), rows: rows.map(texts) }, label);
};

Gaitcal.Cohort = class {
  constructor() {
    const { get } = Gaitcal;
    this.people = new Gaitcal.People(JSON.parse(get("content").textContent), () => get("curves-packed").textContent);
    const { people } = this;
    this.choices = new Gaitcal.Choices(people);
    this.top();
    this.failures(get("failures"));
    new Gaitcal.Triage(get("triage"), people, this.choices);
    Gaitcal.filters(get("people"), people, this.choices);
    if (people.count) {
      this.table = new Gaitcal.PeopleTable(get("people"), people, this.choices);
      this.distributions = new Gaitcal.Distributions(get("distributions"), people, this.choices);
      this.means = new Gaitcal.MeanCurves(get("means"), people, this.choices);
    } else for (const id of ["people", "distributions", "means"]) get(id).hidden = true;
    this.bottom();
  }

  top() {
    const { about, failures, groups, grouped } = this.people;
    const { count, get } = Gaitcal;
    const made = new Date(document.lastModified);
    const day = { day: "numeric", month: "long", year: "numeric" };
    const when = Number.isNaN(made.getTime()) ? "" : `, written ${made.toLocaleDateString("en-GB", day)}`;
    const inGroups = grouped ? ` in ${count(groups.length, "group")}` : "";
    const settings = Object.keys(about.settings).length ? "the settings that stand below" : "default settings";
    get("sentence").textContent =
      `${count(about.people, "person", "people")}, ${count(about.sessions, "session")}${inGroups}: ` +
      `${count(about.results, "result")}, ${failures.length} without${when} by gaitcal ${about.version} with ${settings}.`;
    const parts = about.results ? ["triage", "people", "distributions", "means", "failures"] : ["triage", "failures"];
    get("parts").append(...parts.map((id) => Gaitcal.button(get(`${id}-title`).textContent, () => Gaitcal.go(id))));
  }

  // Who has no result, why in one line, and what to do.
  failures(host) {
    const { failures } = this.people;
    const words = { person: "Person", session: "Session", group: "Group", cause: "Cause", what_to_do: "What to do" };
    const optional = ["session", "group"];
    const names = Object.keys(words).filter((name) => !optional.includes(name) || failures.some((line) => line[name]));
    const rows = failures.map((line) => names.map((name) => line[name]));
    const table = () => Gaitcal.wordTable(names.map((name) => words[name]), rows, "Without a result");
    host.append(failures.length ? Gaitcal.scroller(table(), "Without a result") : html("p", "Everyone has a result."));
  }

  bottom() {
    const { about, curves } = this.people;
    const settings = Object.entries(about.settings).map(([name, value]) => [name, JSON.stringify(value)]);
    const sources = new Set(curves.flatMap(({ normal }) => (normal ? [normal.source] : [])));
    const table = () => Gaitcal.wordTable(["Setting", "Value"], settings, "Settings");
    const files = Object.entries(Gaitcal.FILES).map(([name, words]) =>
      html("li", html("a", { href: `./${name}` }, name), ` ${words}`));
    Gaitcal.built(Gaitcal.get("about"), "", [
      html("h2", "Files beside this page"),
      html("ul.plain", files),
      settings.length > 0 && Gaitcal.fold("Settings that were said for everyone", table()),
      [...sources].map((source) => html("p.hint", `Normal band: ${Gaitcal.visible(source)}`)),
      html("p.hint", "Everything is in this file; it asks nothing of the network. Curves are drawn with uPlot (MIT)."),
    ]);
  }
};

window.gaitcal = new Gaitcal.Cohort();
requestAnimationFrame(() => {
  window.gaitcal.ready = performance.now();
});
