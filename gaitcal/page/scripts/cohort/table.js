"use strict";
// The table of people: sorted by a press on a column's name, filtered below it, some rows at a time.
Gaitcal.PeopleTable = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices });
    document.querySelector("#people .bar").append(new Gaitcal.Chooser(people, choices).button);
    this.head = html("thead");
    this.body = html("tbody", { click: (event) => this.pressed(event) });
    this.table = html("table", { "aria-label": "People" }, this.head, this.body);
    this.pager = html("div.bar.pager");
    const place = Gaitcal.scroller(this.table, "People");
    place.classList.add("people-table");
    host.append(place, this.pager);
    choices.on(["columns"], () => this.draw());
    choices.on([...Gaitcal.NARROWING, "sort", "page", "rows"], () => this.fill());
    choices.on(["shown"], () => this.mark());
    window.addEventListener("beforeprint", () => this.fill(people.count));
    window.addEventListener("afterprint", () => this.fill());
    // The filters stay in view below the names, however many lines those take.
    this.tall = new ResizeObserver(([{ target }]) => this.table.style.setProperty("--head", `${target.offsetHeight}px`));
    this.draw();
  }

  // A press on a row does what its box does, unless it is on something else, or words were marked.
  pressed({ target }) {
    if (target.closest("a, input, label") || String(window.getSelection())) return;
    target.closest("tr").querySelector("input")?.click();
  }

  draw() {
    const columns = this.choices.columns.map((name) => this.people.columns.get(name));
    this.heads = columns.map((column) => this.headCell(column));
    this.tests = columns.map((column) => this.testCell(column));
    const names = html("tr", this.heads.map(({ cell }) => cell));
    this.head.replaceChildren(names, html("tr.tests", this.tests.map(({ input }) => html("td", input))));
    this.tall.disconnect();
    this.tall.observe(names);
    this.fill();
  }

  headCell(column) {
    const { name, title, meaning, side, unit, text } = column;
    const { choices } = this;
    const arrow = html("span.arrow", { "aria-hidden": "true" });
    const next = () => ({ [name]: `-${name}`, [`-${name}`]: "" })[choices.sort] ?? name;
    const words = [
      Gaitcal.visible(title), arrow,
      side && html("span.unit", ` ${Gaitcal.LEGS[side]}`), unit && html("span.unit", ` ${unit}`),
    ];
    const button = Gaitcal.button(words, () => choices.set({ sort: next() }), { title: meaning || null });
    const kind = [text && "text", side && `side-${side}`].filter(Boolean).join(" ");
    return { name, arrow, cell: html("th", { scope: "col", class: kind }, button) };
  }

  testCell(column) {
    const changed = ({ target }) => {
      const tests = new Map(this.choices.tests);
      if (target.value.trim()) tests.set(column.name, target.value);
      else tests.delete(column.name);
      this.choices.set({ tests });
    };
    const words = { "aria-label": `Filter ${Gaitcal.columnWords(column)}`, placeholder: column.text ? "words" : ">" };
    const input = html("input", { type: "text", autocomplete: "off", spellcheck: "false", input: changed, ...words });
    return { column, input };
  }

  // The rows of the page of the table that is chosen; `most`: so many rows whatever is chosen.
  fill(most = null) {
    const { choices } = this;
    const order = choices.sorted();
    const rows = most ?? (choices.rows || order.length);
    const pages = Math.max(1, Math.ceil(order.length / Math.max(1, rows)));
    const page = most ? 0 : Math.min(choices.page, pages - 1);
    const listed = order.slice(page * rows, (page + 1) * rows);
    const nobody = html("tr", html("td.text.nobody", { colspan: this.heads.length }, "Nobody passes all filters."));
    this.body.replaceChildren(...(listed.length ? listed.map((i) => this.row(i)) : [nobody]));
    for (const { name, cell, arrow } of this.heads) {
      const way = { [name]: "ascending", [`-${name}`]: "descending" }[choices.sort];
      if (way) cell.setAttribute("aria-sort", way);
      else cell.removeAttribute("aria-sort");
      arrow.textContent = { ascending: " ▲", descending: " ▼" }[way] ?? "";
    }
    for (const { column, input } of this.tests) {
      const text = choices.tests.get(column.name) ?? "";
      if (input.value.trim() !== text.trim()) input.value = text;
      input.toggleAttribute("aria-invalid", false);
      if (text.trim() && !Gaitcal.columnTest(column, text)) input.setAttribute("aria-invalid", "true");
    }
    this.turn(page, pages, order.length, rows);
    this.mark();
  }

  row(i) {
    return html("tr", { "data-person": i }, this.tests.map(({ column }, k) => this.cell(column, i, k === 0)));
  }

  cell(column, i, first) {
    const { name, text, digits, error } = column;
    const value = column.at(i);
    const number = () => {
      const half = error?.(i);
      const known = Number.isFinite(half) && html("span.soft", ` ± ${Gaitcal.numeral(half, digits)}`);
      return [Gaitcal.numeral(value, digits), known];
    };
    const words = () => {
      const shown = name === "first_cause" ? Gaitcal.capital(Gaitcal.visible(value)) : Gaitcal.visible(value);
      return shown.length > 90 ? html("span", { title: shown }, `${shown.slice(0, 89)}…`) : shown;
    };
    const told = { person: () => this.people.linked(i, value), verdict: () => Gaitcal.judgement(value) };
    const content = (told[name] ?? (text ? words : number))();
    if (first) return html("th.text", { scope: "row" }, this.tick(i), content);
    return html("td", { class: text && `text ${name}` }, content);
  }

  tick(i) {
    const { people, choices } = this;
    const words = { "aria-label": `Draw the curves of ${Gaitcal.visible(people.name(i))}` };
    const change = ({ target }) => choices.show(i, target.checked);
    return html("label.of-row", html("input", { type: "checkbox", change, ...words }));
  }

  mark() {
    for (const row of this.body.querySelectorAll("tr[data-person]")) {
      const on = this.choices.shown.includes(Number(row.dataset.person));
      row.classList.toggle("shown", on);
      row.querySelector("input").checked = on;
    }
  }

  turn(page, pages, count, rows) {
    const { choices } = this;
    const button = (words, to, on) => pages > 1 && Gaitcal.button(words, () => choices.set({ page: to }), { disabled: !on });
    const numbers = [25, 50, 100, 0].map((number) => [number, number || "all"]);
    const choice = Gaitcal.select(numbers, (number) => choices.set({ rows: Number(number), page: 0 }));
    choice.value = String(choices.rows);
    const words = count ? `${page * rows + 1} to ${Math.min(count, (page + 1) * rows)} of ${count}` : "none";
    const [before, after] = [page > 0, page < pages - 1];
    this.pager.replaceChildren();
    Gaitcal.built(this.pager, "", [
      button("First", 0, before), button("Previous", page - 1, before), html("span", words),
      button("Next", page + 1, after), button("Last", pages - 1, after), Gaitcal.pick("Rows", choice),
    ]);
  }
};

// Which columns the table has: a list of all of them with their units and meanings, found by words.
Gaitcal.Chooser = class {
  constructor(people, choices) {
    Object.assign(this, { people, choices });
    this.dialog = Gaitcal.get("chooser");
    this.button = Gaitcal.button("Columns …", () => this.open(), { "aria-haspopup": "dialog" });
  }

  open() {
    if (!this.entries) this.build();
    this.mark();
    this.dialog.showModal();
  }

  build() {
    const { choices } = this;
    this.entries = [...this.people.columns.values()].map((column) => this.entry(column));
    const list = { tabindex: "0", "aria-label": "Columns" };
    const narrow = ({ target }) => {
      const words = target.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const { item, text } of this.entries) item.hidden = !words.every((word) => text.includes(word));
    };
    const usual = () => {
      choices.set({ columns: choices.usual.columns });
      this.mark();
    };
    const find = html("input", { type: "search", autocomplete: "off", spellcheck: "false", input: narrow });
    this.dialog.append(
      html("h2", { id: "chooser-title" }, "Columns of the table"),
      Gaitcal.pick("Find", find),
      html("ul.column-list", list, this.entries.map(({ item }) => item)),
      html("p.bar", Gaitcal.button("The usual ones", usual),
        Gaitcal.button("Close", () => this.dialog.close(), { class: "main" })),
    );
  }

  entry(column) {
    const { name, unit, meaning } = column;
    const title = Gaitcal.columnWords(column);
    const words = [Gaitcal.visible(title), unit && html("span.unit", ` ${unit}`), html("span.soft", ` ${meaning}`)];
    const label = Gaitcal.tick(html("span", words), (on) => this.chosen(name, on));
    const text = `${title} ${name} ${unit} ${meaning}`.toLowerCase();
    return { name, box: label.control, item: html("li", label), text };
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
    for (const { name, box } of this.entries) box.checked = this.choices.columns.includes(name);
  }
};
