"use strict";
// The curves of one joint, and how they stand: powers in the last column, whatever else there is.

// Three angles stand above their moments; fewer beside them; what has angles or forces alone is a row.
Gaitcal.jointGroup = ({ joint, title, power, rows }, curves) => {
  const has = (base, kind) => curves.has({ base, kind });
  const subjects = rows.flatMap(({ base }, i) => {
    const own = ["angle", "moment"].filter((kind) => has(base, kind)).map((kind) => ({ base, kind, joint }));
    const alone = own.length === 1 && own[0].kind === "moment";
    const total = i === 0 && power && has(power, "power") ? [{ base: power, kind: "power", joint }] : [];
    const detail = has(base, "power") && power !== base ? [{ base, kind: "power", joint, detail: true }] : [];
    return [...own.map((subject) => ({ ...subject, alone })), ...total, ...detail];
  });
  const count = (kind) => subjects.filter((subject) => subject.kind === kind).length;
  const layout = count("moment") + count("power") === 0 ? "flow" : count("angle") > 2 ? "planes" : "columns";
  return Gaitcal.curveGroup({ joint, title, subjects, layout }, curves);
};

Gaitcal.groundGroup = (curves) => {
  const forces = Object.keys(Gaitcal.GROUND).map((base) => ({ base, kind: "force", joint: null }));
  const subjects = forces.filter((subject) => curves.has(subject));
  return Gaitcal.curveGroup({ joint: "ground", title: "Ground reactions", subjects, layout: "flow" }, curves);
};

Gaitcal.curveGroup = ({ joint, title, subjects, layout }, curves) => {
  const element = Gaitcal.curvePart;
  const folded = joint === "arm";
  const root = element(folded ? "details" : "section", `curve-group ${layout}`);
  root.dataset.joint = joint;
  const heading = element("h3", "", title);
  if (folded) {
    const summary = element("summary");
    summary.append(heading);
    root.append(summary);
  } else root.append(heading);
  const cells = element("div", "curve-cells");
  const panels = subjects.map((subject) => new Gaitcal.Panel(subject, curves));
  for (const { root: panel, subject } of panels) {
    panel.classList.toggle("detail", Boolean(subject.detail));
    panel.classList.toggle("alone", Boolean(subject.alone));
    cells.append(panel);
  }
  root.append(cells);
  return { joint, root, cells, panels };
};
