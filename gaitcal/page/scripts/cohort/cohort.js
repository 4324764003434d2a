"use strict";
// The page of a cohort, all together.
Gaitcal.FILES = [
  ["people.csv", "the table of people"],
  ["people.parquet", "the same, for programs"],
  ["columns.csv", "what its columns mean"],
  ["cycles.parquet", "every stride of everyone"],
  ["failures.csv", "who has no result"],
  ["manifest.json", "settings and hashes"],
];

// A part of the page comes into view; the address keeps what is chosen.
Gaitcal.go = (id) => {
  document.getElementById(id).scrollIntoView({ block: "start" });
  document.getElementById(`${id}-title`).focus({ preventScroll: true });
};

Gaitcal.count = (number, one, many) => `${number} ${number === 1 ? one : many}`;

Gaitcal.Cohort = class {
  constructor() {
    const part = (id) => document.getElementById(id);
    this.people = new Gaitcal.People(JSON.parse(part("content").textContent), () => part("curves-packed").textContent);
    this.choices = new Gaitcal.Choices(this.people);
    this.top();
    Gaitcal.failures(part("failures"), this.people);
    new Gaitcal.Triage(part("triage"), this.people, this.choices);
    this.filters = new Gaitcal.Filters(part("people"), this.people, this.choices);
    if (this.people.count) {
      this.table = new Gaitcal.PeopleTable(part("people"), this.people, this.choices);
      this.distributions = new Gaitcal.Distributions(part("distributions"), this.people, this.choices);
      this.means = new Gaitcal.MeanCurves(part("means"), this.people, this.choices);
    } else for (const id of ["people", "distributions", "means"]) part(id).hidden = true;
    this.bottom();
  }

  top() {
    const { about, failures, groups, grouped } = this.people;
    const made = new Date(document.lastModified);
    const when = Number.isNaN(made.getTime())
      ? ""
      : `, written ${made.toLocaleDateString("en-GB", { day: "numeric", month: "long", year: "numeric" })}`;
    const inGroups = grouped ? ` in ${Gaitcal.count(groups.length, "group", "groups")}` : "";
    const settings = Object.keys(about.settings).length ? "the settings that stand below" : "default settings";
    const people = Gaitcal.count(about.people, "person", "people");
    const sessions = Gaitcal.count(about.sessions, "session", "sessions");
    const results = Gaitcal.count(about.results, "result", "results");
    document.getElementById("sentence").textContent =
      `${people}, ${sessions}${inGroups}: ${results}, ${failures.length} without${when} by gaitcal ${about.version} ` +
      `with ${settings}.`;
    const nav = document.getElementById("parts");
    for (const id of ["triage", "people", "distributions", "means", "failures"]) {
      if (!about.results && !["triage", "failures"].includes(id)) continue;
      const button = Gaitcal.make("button", { type: "button" }, document.getElementById(`${id}-title`).textContent);
      button.addEventListener("click", () => Gaitcal.go(id));
      nav.append(button);
    }
  }

  bottom() {
    const { about, curves } = this.people;
    const files = Gaitcal.FILES.map(([name, words]) =>
      Gaitcal.make("li", {}, Gaitcal.make("a", { href: `./${name}` }, name), ` ${words}`),
    );
    const settings = Object.entries(about.settings).map(([name, value]) => [
      { t: name, align: "text" },
      { t: JSON.stringify(value), align: "text" },
    ]);
    const sources = [...new Set(curves.flatMap(({ normal }) => (normal ? [normal.source] : [])))];
    document.getElementById("about").append(
      Gaitcal.make("h2", {}, "Files beside this page"),
      Gaitcal.make("ul", { class: "plain" }, ...files),
      settings.length
        ? Gaitcal.fold(
            "Settings that were said for everyone",
            Gaitcal.table(
              {
                head: [
                  { t: "Setting", align: "text" },
                  { t: "Value", align: "text" },
                ],
                rows: settings,
              },
              "Settings",
            ),
          )
        : "",
      ...sources.map((source) => Gaitcal.make("p", { class: "hint" }, `Normal band: ${Gaitcal.visible(source)}`)),
      Gaitcal.make(
        "p",
        { class: "hint" },
        "Everything is in this file; it asks nothing of the network. Curves are drawn with uPlot (MIT).",
      ),
    );
  }
};

window.gaitcal = new Gaitcal.Cohort();
requestAnimationFrame(() => {
  window.gaitcal.ready = performance.now();
});
