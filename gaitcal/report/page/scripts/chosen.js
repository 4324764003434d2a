// What is chosen. Whoever draws listens to the fields that it shows; whoever is clicked sets them. It stands in the
// address, so that a link opens what was seen: read at the start, written after a while of rest, and only what differs
// from the page as it opens. Whatever else stands there is passed over.
Gaitcal.Chosen = class {
  // `addressed`: for each field that the address holds, {name, read(text, now), write(value, now)}: `read` gives what a
  // text stands for, undefined where for nothing; `now`: everything that is chosen.
  constructor(usual, addressed) {
    Object.assign(this, { usual, addressed, listeners: [] }, usual);
    this.on(Object.keys(addressed), () => this.soon());
    window.addEventListener("hashchange", () => this.set(this.said()));
  }

  // `listener(changed)` is called after any of the fields has changed; `changed`: the Set of all that did.
  on(fields, listener) { this.listeners.push([fields, listener]); }

  set(values) {
    const next = this.following(values);
    const changed = new Set(Object.keys(next).filter((field) => !Object.is(this[field], next[field])));
    if (changed.size === 0) return;
    Object.assign(this, next);
    for (const [fields, listener] of this.listeners) if (fields.some((field) => changed.has(field))) listener(changed);
  }

  // With what follows from a choice.
  following(values) { return values; }

  // What the address says.
  said() {
    const said = new URLSearchParams(window.location.hash.slice(1));
    const values = {};
    for (const [field, { name = field, read }] of Object.entries(this.addressed)) {
      const value = said.has(name) ? read(said.get(name), { ...this, ...values }) : undefined;
      if (value !== undefined) values[field] = value;
    }
    return values;
  }

  soon() {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.write(), 250);
  }

  write() {
    const said = new URLSearchParams();
    const normal = this.normal();
    for (const [field, { name = field, write = String }] of Object.entries(this.addressed)) {
      const text = write(this[field], this);
      if (text !== write(normal[field], this)) said.set(name, text);
    }
    const text = said.toString();
    try {
      history.replaceState(null, "", text ? `#${text}` : window.location.pathname + window.location.search);
    } catch {
      // A browser that keeps the address of a file as it is: nothing else depends on it.
    }
  }

  // What the address does not say.
  normal() { return this.usual; }
};

// How fields of some kinds stand in the address.
Gaitcal.among = (...values) => ({ read: (text) => values.find((value) => String(value) === text) });
Gaitcal.onOff = {
  read: (text) => (["0", "1"].includes(text) ? text === "1" : undefined),
  write: (on) => String(Number(on)),
};

// Controls of the page that stand for a field of what is chosen: `data-field` says which.
Gaitcal.bind = (chosen) => {
  for (const control of document.querySelectorAll("[data-field]")) {
    const { field } = control.dataset;
    const tick = control.type === "checkbox";
    const number = typeof chosen[field] === "number";
    const write = () => {
      if (tick) control.checked = chosen[field];
      else if (control.value !== String(chosen[field])) control.value = String(chosen[field]);
    };
    control.addEventListener(control.type === "search" ? "input" : "change", () => {
      chosen.set({ [field]: tick ? control.checked : number ? Number(control.value) : control.value });
    });
    chosen.on([field], write);
    write();
  }
};
