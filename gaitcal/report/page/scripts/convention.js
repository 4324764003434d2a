// Titles, signs and units in one convention, as gaitcal/gait/conventions.py has them.
Gaitcal.conventions = () => {
  Gaitcal.known ??= JSON.parse(Gaitcal.get("conventions").textContent);
  return Gaitcal.known;
};

Gaitcal.Convention = class {
  // `chosen`: signs, acting, unit.
  constructor({ person }, { signs, acting, unit }) {
    const known = Gaitcal.conventions();
    Object.assign(this, { person, acting, told: known.signs[signs][acting], units: known.units[unit] });
  }

  title(base, kind) { return this.told[`${base}/${kind}`].title; }

  // By what a value of the files is multiplied, and what a positive one means. `side`: of the stride or the leg; "" of
  // what has none.
  of(base, kind, side) {
    const [sign, positive] = this.told[`${base}/${kind}`][side];
    const { times, per } = this.units[kind];
    return { factor: (sign * times) / (per ? this.person[per] : 1), positive };
  }

  factor(base, kind, side) { return this.of(base, kind, side).factor; }

  positive(base, kind, side) { return this.of(base, kind, side).positive; }

  unit(kind) { return this.units[kind].words; }

  digits(kind) { return this.units[kind].digits; }

  // "N·m/kg, + extension".
  brief(base, kind, side) { return `${this.unit(kind)}, + ${this.positive(base, kind, side)}`; }

  // "N·m/kg, + extension, internal".
  words(base, kind, side) { return this.brief(base, kind, side) + (kind === "moment" ? `, ${this.acting}` : ""); }
};
