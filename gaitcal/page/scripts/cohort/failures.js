"use strict";
// Who has no result, why in one line, and what to do.
Gaitcal.failures = (host, people) => {
  if (!people.failures.length) {
    host.append(Gaitcal.make("p", {}, "Everyone has a result."));
    return;
  }
  const several = people.failures.some(({ session }) => session);
  const grouped = people.failures.some(({ group }) => group);
  const names = ["person", several ? "session" : null, grouped ? "group" : null, "cause", "what_to_do"].filter(Boolean);
  const words = { person: "Person", session: "Session", group: "Group", cause: "Cause", what_to_do: "What to do" };
  const head = names.map((name) => ({ t: words[name], align: "text" }));
  const rows = people.failures.map((line) => names.map((name) => ({ t: line[name], align: "text" })));
  host.append(Gaitcal.scroller(Gaitcal.table({ head, rows }, "Without a result"), "Without a result"));
};
