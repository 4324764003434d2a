"use strict";
// Which columns the table has: a list of all of them with their units and meanings, found by words.
Gaitcal.Chooser = class {
  constructor(people, choices) {
    Object.assign(this, { people, choices });
    this.dialog = document.getElementById("chooser");
    this.button = Gaitcal.make("button", { type: "button", "aria-haspopup": "dialog" }, "Columns …");
    this.button.addEventListener("click", () => this.open());
  }

  open() {
    if (!this.list) this.build();
    this.mark();
    this.dialog.showModal();
  }

  build() {
    const find = Gaitcal.make("input", { type: "search", autocomplete: "off", spellcheck: "false" });
    this.entries = [...this.people.columns.values()].map((column) => this.entry(column));
    this.list = Gaitcal.make(
      "ul",
      { class: "column-list", tabindex: "0", "aria-label": "Columns" },
      ...this.entries.map(({ item }) => item),
    );
    find.addEventListener("input", () => {
      const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const { item, text } of this.entries) item.hidden = !words.every((word) => text.includes(word));
    });
    const usual = Gaitcal.make("button", { type: "button" }, "The usual ones");
    usual.addEventListener("click", () => {
      this.choices.set({ columns: this.choices.usual.columns });
      this.mark();
    });
    const close = Gaitcal.make("button", { type: "button", class: "main" }, "Close");
    close.addEventListener("click", () => this.dialog.close());
    this.dialog.append(
      Gaitcal.make("h2", { id: "chooser-title" }, "Columns of the table"),
      Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Find"), find),
      this.list,
      Gaitcal.make("p", { class: "bar" }, usual, close),
    );
  }

  entry(column) {
    const { name, unit, meaning } = column;
    const title = Gaitcal.columnWords(column);
    const tick = Gaitcal.make("input", { type: "checkbox" });
    tick.addEventListener("change", () => this.chosen(name, tick.checked));
    const words = Gaitcal.make(
      "span",
      {},
      Gaitcal.visible(title),
      unit ? Gaitcal.make("span", { class: "unit" }, ` ${unit}`) : null,
      Gaitcal.make("span", { class: "soft" }, ` ${meaning}`),
    );
    const item = Gaitcal.make("li", {}, Gaitcal.make("label", { class: "tick" }, tick, words));
    return { name, tick, item, text: `${title} ${name} ${unit} ${meaning}`.toLowerCase() };
  }

  // A new column comes last; one whose filter is on is filtered no more when it goes.
  chosen(name, on) {
    const columns = this.choices.columns.filter((other) => other !== name);
    const tests = new Map(this.choices.tests);
    if (on) columns.push(name);
    else tests.delete(name);
    if (columns.length) this.choices.set(tests.size === this.choices.tests.size ? { columns } : { columns, tests });
    this.mark();
  }

  mark() {
    for (const { name, tick } of this.entries) tick.checked = this.choices.columns.includes(name);
  }
};
