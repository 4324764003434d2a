"use strict";
// Panels of curves as they stand on paper: kinematics on one page, kinetics on the other.
Gaitcal.PAPERS = [
  ["kinematics", "Kinematics", ["angle"]],
  ["kinetics", "Kinetics", ["moment", "power", "force"]],
];

Gaitcal.curvePapers = (panels) => {
  const papers = Gaitcal.curvePart("div", "curve-papers");
  const whole = panels.filter(({ subject }) => !subject.detail && subject.joint !== "arm");
  for (const [name, title, kinds] of Gaitcal.PAPERS) {
    const section = Gaitcal.curvePart("section", `curve-paper ${name}`);
    const cells = Gaitcal.curvePart("div", "curve-cells");
    cells.append(...kinds.flatMap((kind) => whole.filter(({ subject }) => subject.kind === kind)).map(({ root }) => root));
    section.append(Gaitcal.curvePart("h2", "", title), cells);
    papers.append(section);
  }
  return papers;
};
