// The page of a cohort, all together.

// A part of the page comes into view; the address keeps what is chosen.
Gaitcal.go = (id) => {
  Gaitcal.get(id).scrollIntoView({ block: "start" });
  Gaitcal.get(`${id}-title`).focus({ preventScroll: true });
};

// A table of words.
Gaitcal.wordTable = (head, rows, label) => {
  const texts = (row) => row.map((t) => ({ t, align: "text" }));
  return Gaitcal.scroller(Gaitcal.table({ head: texts(head), rows: rows.map(texts) }, label), label);
};

Gaitcal.sentence = ({ about, failures, groups, grouped }) => {
  const { count } = Gaitcal;
  const inGroups = grouped ? ` in ${count(groups.length, "group")}` : "";
  const settings = Object.keys(about.settings).length ? "the settings that stand below" : "default settings";
  return `${count(about.people, "person", "people")}, ${count(about.sessions, "session")}${inGroups}: ` +
    `${count(about.results, "result")}, ${failures.length} without, by gaitcal ${about.version} with ${settings}.`;
};

// Who has no result, why in one line, and what to do.
Gaitcal.failures = ({ failures }) => {
  if (!failures.length) return html("p", "Everyone has a result.");
  const words = { person: "Person", session: "Session", group: "Group", cause: "Cause", what_to_do: "What to do" };
  const optional = ["session", "group"];
  const names = Object.keys(words).filter((name) => !optional.includes(name) || failures.some((line) => line[name]));
  const rows = failures.map((line) => names.map((name) => line[name]));
  return Gaitcal.wordTable(names.map((name) => words[name]), rows, "Without a result");
};

Gaitcal.Cohort = class {
  constructor() {
    const { get } = Gaitcal;
    this.people = new Gaitcal.People(JSON.parse(get("content").textContent), () => get("curves-packed").textContent);
    this.choices = new Gaitcal.Choices(this.people);
    const { people, choices } = this;
    const shown = people.count > 0;
    const optional = ["people", "distributions", "means"];
    get("sentence").textContent = Gaitcal.sentence(people);
    const parts = ["triage", ...(shown ? optional : []), "failures"];
    get("parts").append(...parts.map((id) => Gaitcal.button(get(`${id}-title`).textContent, () => Gaitcal.go(id))));
    get("failures").append(Gaitcal.failures(people));
    Gaitcal.triage(get("triage"), people, choices);
    Gaitcal.filters(people, choices);
    for (const id of optional) get(id).hidden = !shown;
    if (shown) {
      Gaitcal.chooser(people, choices);
      Gaitcal.peopleTable(people, choices);
      Gaitcal.distributions(get("distributions"), people, choices);
      Gaitcal.meanCurves(get("means"), people, choices);
    }
    Gaitcal.bind(choices);
    this.settings();
  }

  settings() {
    const { about, curves } = this.people;
    const settings = Object.entries(about.settings).map(([name, value]) => [name, JSON.stringify(value)]);
    const sources = new Set(curves.flatMap(({ normal }) => (normal ? [normal.source] : [])));
    Gaitcal.built(Gaitcal.get("settings"), "", [
      settings.length > 0 &&
        Gaitcal.fold("Settings that were said for everyone", Gaitcal.wordTable(["Setting", "Value"], settings, "Settings")),
      [...sources].map((source) => html("p.hint", `Normal band: ${Gaitcal.visible(source)}`)),
    ]);
  }
};

window.gaitcal = new Gaitcal.Cohort();
requestAnimationFrame(() => { window.gaitcal.ready = performance.now(); });
