"use strict";
// Mean curves of groups. Each person counts the same: the curve of a person is the mean of its legs and sessions, that
// of a group the mean of its people, with the standard deviation between them. Legs that are refused take no part.
Gaitcal.GROUP_COLOURS = 6;
// People of a group from whom a distance to it can be told.
Gaitcal.LEAST_OF_GROUP = 3;

// Curve (with NaN in gaps) of one session of a person; null where no leg that takes part has one.
Gaitcal.personCurve = (people, choices, i, variable) => {
  const { step } = people.curves[variable];
  const legs = (choices.legs === "both" ? ["r", "l"] : [choices.legs])
    .filter((side) => Gaitcal.takesPart(people, choices, i, side))
    .map((side) => people.whole(i, variable, side))
    .filter(Boolean);
  if (!legs.length) return null;
  const out = new Float64Array(people.points);
  for (let k = 0; k < out.length; k++) {
    let sum = 0;
    let count = 0;
    for (const leg of legs) {
      if (leg[k] === Gaitcal.GAP) continue;
      sum += leg[k];
      count++;
    }
    out[k] = count ? (step * sum) / count : NaN;
  }
  return out;
};

Gaitcal.takesPart = (people, choices, i, side) => {
  const verdict = people.legVerdict(i, side);
  return verdict !== "refused" && (choices.doubtful || verdict !== "doubtful");
};

// Group -> {mean, sd, count: (points,), people} of a variable over those who pass the filters.
Gaitcal.groupMeans = (people, choices, variable) => {
  const out = new Map();
  for (const group of people.groups) {
    const curves = Gaitcal.curvesOf(
      people,
      choices,
      variable,
      choices.filtered().filter((i) => people.groupOf[i] === group),
    );
    if (curves.length) out.set(group, { ...Gaitcal.meanCurve(curves, people.points), people: curves.length });
  }
  return out;
};

// One curve for each person, the mean of sessions.
Gaitcal.curvesOf = (people, choices, variable, indices) => {
  const named = new Map();
  for (const i of indices) {
    const curve = Gaitcal.personCurve(people, choices, i, variable);
    if (!curve) continue;
    const name = people.word("person", i);
    if (!named.has(name)) named.set(name, []);
    named.get(name).push(curve);
  }
  return [...named.values()].map((curves) =>
    curves.length === 1 ? curves[0] : Gaitcal.meanCurve(curves, people.points).mean,
  );
};

Gaitcal.meanCurve = (curves, points) => {
  const [mean, sd, count] = [new Float64Array(points), new Float64Array(points), new Uint32Array(points)];
  for (let k = 0; k < points; k++) {
    let [sum, n] = [0, 0];
    for (const curve of curves) {
      if (Number.isNaN(curve[k])) continue;
      sum += curve[k];
      n++;
    }
    mean[k] = n ? sum / n : NaN;
    let squares = 0;
    for (const curve of curves) if (!Number.isNaN(curve[k])) squares += (curve[k] - mean[k]) ** 2;
    sd[k] = n > 1 ? Math.sqrt(squares / (n - 1)) : NaN;
    count[k] = n;
  }
  return { mean, sd, count };
};

// Who lies farthest from the mean of the own group: root mean square over all curves, in standard deviations.
Gaitcal.farthest = (people, choices, most = 5) => {
  const sums = new Map();
  people.curves.forEach((_, variable) => {
    const means = Gaitcal.groupMeans(people, choices, variable);
    for (const i of choices.filtered()) {
      const group = means.get(people.groupOf[i]);
      if (!group || group.people < Gaitcal.LEAST_OF_GROUP) continue;
      const curve = Gaitcal.personCurve(people, choices, i, variable);
      if (!curve) continue;
      const entry = sums.get(i) ?? { sum: 0, n: 0 };
      for (let k = 0; k < curve.length; k++) {
        if (Number.isNaN(curve[k]) || !(group.sd[k] > 0) || group.count[k] < Gaitcal.LEAST_OF_GROUP) continue;
        entry.sum += ((curve[k] - group.mean[k]) / group.sd[k]) ** 2;
        entry.n++;
      }
      sums.set(i, entry);
    }
  });
  return [...sums]
    .filter(([, { n }]) => n > 0)
    .map(([i, { sum, n }]) => ({ i, distance: Math.sqrt(sum / n) }))
    .sort((a, b) => b.distance - a.distance)
    .slice(0, most);
};
