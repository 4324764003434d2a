// Signs, units and whose moment: as gaitcal/gait/conventions.py has them.
Gaitcal.GROUND = {
  ground_reaction_vertical: ["Ground reaction, vertical", "up"],
  ground_reaction_forward: ["Ground reaction, forward", "forward"],
  ground_reaction_sideways: ["Ground reaction, sideways", "to the right"],
};
Gaitcal.MOMENT_UNITS = { Nm: "N·m", "Nm/kg": "N·m/kg", "%BWH": "%BW·H" };

Gaitcal.Convention = class {
  // `sheet`: whose person and rows; `chosen`: signs, acting, unit.
  constructor(sheet, { signs, acting, unit }) {
    this.sheet = sheet;
    this.clinical = signs === "clinical";
    this.external = acting === "external";
    this.moments = unit in Gaitcal.MOMENT_UNITS ? unit : "Nm";
  }

  // By what a value of the files is multiplied. `side`: of the stride, which matters to the pelvis; "" over time.
  factor(base, kind, side) {
    const { mass, bwh } = this.sheet.person;
    const scale = { Nm: 1, "Nm/kg": 1 / mass, "%BWH": 100 / bwh }[this.moments];
    const power = this.moments === "Nm" ? 1 : 1 / mass;
    return { angle: this.ofPelvis(base, side)?.sign ?? 1, moment: scale * this.sign(base), power }[kind] ?? 1;
  }

  unit(kind) {
    const power = this.moments === "Nm" ? "W" : "W/kg";
    return { angle: "°", moment: Gaitcal.MOMENT_UNITS[this.moments], power, force: "N" }[kind];
  }

  digits(kind) {
    const small = this.moments !== "Nm";
    return { angle: 1, moment: small ? 2 : 1, power: small ? 2 : 0, force: 0 }[kind];
  }

  // What a positive value means.
  positive(base, kind, side) {
    if (kind === "power") return "generated";
    if (kind === "force") return Gaitcal.GROUND[base]?.[1] ?? "";
    const { angle, moment } = this.sheet.rows.get(base);
    if (kind === "angle") return this.ofPelvis(base, side)?.words ?? angle[0];
    return moment[this.flipped(base) ? 1 : 0];
  }

  title(base, kind) {
    if (kind === "force") return Gaitcal.GROUND[base]?.[0] ?? base;
    const joint = this.total(base);
    if (kind === "power" && joint) return `${joint.title} power`;
    const title = this.sheet.rows.get(base)?.title ?? base;
    return kind === "angle" ? title : `${title} ${kind}`;
  }

  // The joint of which a power is the sum over all axes.
  total(base) {
    return this.sheet.joints.find(({ power }) => power === base);
  }

  // "N·m/kg, + extension".
  brief(base, kind, side) {
    const whole = kind === "power" && this.total(base) ? ["all axes"] : [];
    return [this.unit(kind), `+ ${this.positive(base, kind, side)}`, ...whole].join(", ");
  }

  // "N·m/kg, + extension, internal".
  words(base, kind, side) {
    const whose = kind === "moment" ? [this.external ? "external" : "internal"] : [];
    return [this.brief(base, kind, side), ...whose].join(", ");
  }

  flipped(base) {
    return this.clinical && this.sheet.rows.get(base)?.flips;
  }

  sign(base) {
    return (this.flipped(base) ? -1 : 1) * (this.external ? -1 : 1);
  }

  // Sign and sense of a clinical pelvis angle. Over time, where no stride says the side, only what is the same of both.
  ofPelvis(base, side) {
    const senses = this.clinical ? this.sheet.rows.get(base)?.pelvis : null;
    if (!senses) return null;
    if (side) return senses[side] ?? null;
    return senses.r && senses.r.sign === senses.l?.sign ? senses.r : null;
  }
};
