"use strict";
// The table of people: sorted by a press on a column's name, filtered below it, some rows at a time.
Gaitcal.MOST_SHOWN = 4;

Gaitcal.PeopleTable = class {
  constructor(host, people, choices) {
    Object.assign(this, { people, choices });
    this.chooser = new Gaitcal.Chooser(people, choices);
    document.querySelector("#people .bar").append(this.chooser.button);
    this.head = Gaitcal.make("thead");
    this.body = Gaitcal.make("tbody");
    this.table = Gaitcal.make("table", { "aria-label": "People" }, this.head, this.body);
    this.pager = Gaitcal.make("div", { class: "bar pager" });
    host.append(
      Gaitcal.scroller(this.table, "People"),
      this.pager,
    );
    this.table.parentElement.classList.add("people-table");
    this.body.addEventListener("click", (event) => this.pressed(event));
    choices.on(["columns"], () => this.draw());
    choices.on([...Gaitcal.NARROWING, "sort", "page", "rows"], () => this.fill());
    choices.on(["shown"], () => this.mark());
    window.addEventListener("beforeprint", () => this.fill(this.people.count));
    window.addEventListener("afterprint", () => this.fill());
    this.draw();
  }

  // A press on a row does what its box does, unless it is on something else, or words were marked.
  pressed({ target }) {
    if (target.closest("a, input, label") || String(window.getSelection())) return;
    target.closest("tr").querySelector("input")?.click();
  }

  get columns() {
    return this.choices.columns.map((name) => this.people.columns.get(name));
  }

  draw() {
    this.heads = this.columns.map((column) => this.headCell(column));
    this.tests = this.columns.map((column) => this.testCell(column));
    const names = Gaitcal.make("tr", {}, ...this.heads.map(({ cell }) => cell));
    const tests = Gaitcal.make("tr", { class: "tests" }, ...this.tests.map(({ cell }) => cell));
    this.head.replaceChildren(names, tests);
    // The filters stay in view below the names, however many lines those take.
    this.tall ??= new ResizeObserver(([{ target }]) =>
      this.table.style.setProperty("--head", `${target.offsetHeight}px`),
    );
    this.tall.disconnect();
    this.tall.observe(names);
    this.fill();
  }

  headCell(column) {
    const arrow = Gaitcal.make("span", { class: "arrow", "aria-hidden": "true" });
    const button = Gaitcal.make(
      "button",
      { type: "button", title: column.meaning || null },
      Gaitcal.visible(column.title),
      arrow,
    );
    const cell = Gaitcal.make(
      "th",
      {
        scope: "col",
        class: [column.text ? "text" : "", column.side ? `side-${column.side}` : ""].join(" ").trim() || null,
      },
      button,
    );
    if (column.side) button.append(Gaitcal.make("span", { class: "unit" }, ` ${Gaitcal.SIDE_WORDS[column.side]}`));
    if (column.unit) button.append(Gaitcal.make("span", { class: "unit" }, ` ${column.unit}`));
    button.addEventListener("click", () => {
      const { sort } = this.choices;
      this.choices.set({
        sort: sort === column.name ? `-${column.name}` : sort === `-${column.name}` ? "" : column.name,
      });
    });
    return { column, cell, arrow };
  }

  testCell(column) {
    const words = Gaitcal.columnWords(column);
    const input = Gaitcal.make("input", {
      type: "text",
      "aria-label": `Filter ${words}`,
      placeholder: column.text ? "words" : ">",
      autocomplete: "off",
      spellcheck: "false",
    });
    input.addEventListener("input", () => {
      const tests = new Map(this.choices.tests);
      if (input.value.trim()) tests.set(column.name, input.value);
      else tests.delete(column.name);
      this.choices.set({ tests });
    });
    return { column, input, cell: Gaitcal.make("td", {}, input) };
  }

  // The rows of the page of the table that is chosen; `most`: so many rows whatever is chosen.
  fill(most = null) {
    const { choices } = this;
    const order = choices.sorted();
    const rows = most ?? (choices.rows || order.length);
    const pages = Math.max(1, Math.ceil(order.length / Math.max(1, rows)));
    const page = most ? 0 : Math.min(choices.page, pages - 1);
    this.listed = order.slice(page * rows, (page + 1) * rows);
    this.body.replaceChildren(...this.listed.map((i) => this.row(i)));
    if (!this.listed.length)
      this.body.append(
        Gaitcal.make(
          "tr",
          {},
          Gaitcal.make("td", { class: "text nobody", colspan: this.heads.length }, "Nobody passes all filters."),
        ),
      );
    for (const { column, cell, arrow } of this.heads) {
      const way = { [column.name]: "ascending", [`-${column.name}`]: "descending" }[choices.sort];
      way ? cell.setAttribute("aria-sort", way) : cell.removeAttribute("aria-sort");
      arrow.textContent = { ascending: " ▲", descending: " ▼" }[way] ?? "";
    }
    for (const { column, input } of this.tests) {
      const text = choices.tests.get(column.name) ?? "";
      if (input.value.trim() !== text.trim()) input.value = text;
      const wrong = text.trim() && !column.text && !Gaitcal.numberTest(text, column.digits);
      wrong ? input.setAttribute("aria-invalid", "true") : input.removeAttribute("aria-invalid");
    }
    this.turn(page, pages, order.length, rows);
    this.mark();
  }

  row(i) {
    return Gaitcal.make("tr", { "data-person": i }, ...this.columns.map((column, k) => this.cell(column, i, k === 0)));
  }

  cell(column, i, first) {
    const cell = first
      ? Gaitcal.make("th", { scope: "row", class: "text" })
      : Gaitcal.make("td", { class: column.text ? `text ${column.name}` : null });
    if (first) cell.append(this.tick(i));
    if (column.name === "person") cell.append(this.person(i));
    else if (column.name === "verdict") cell.append(Gaitcal.judgement(column.at(i)));
    else if (column.text) {
      const text =
        column.name === "first_cause" ? Gaitcal.capital(Gaitcal.visible(column.at(i))) : Gaitcal.visible(column.at(i));
      cell.append(text.length > 90 ? Gaitcal.make("span", { title: text }, `${text.slice(0, 89)}…`) : text);
    } else {
      cell.append(Gaitcal.numeral(column.at(i), column.digits));
      const error = column.error?.(i);
      if (Number.isFinite(error))
        cell.append(Gaitcal.make("span", { class: "soft" }, ` ± ${Gaitcal.numeral(error, column.digits)}`));
    }
    return cell;
  }

  // The person's name, which leads to the page.
  person(i) {
    const [name, link] = [this.people.word("person", i), this.people.link(i)];
    return link ? Gaitcal.make("a", { href: link }, Gaitcal.named(name)) : Gaitcal.named(name);
  }

  tick(i) {
    const box = Gaitcal.make("input", {
      type: "checkbox",
      "aria-label": `Draw the curves of ${Gaitcal.visible(this.people.name(i))}`,
    });
    box.addEventListener("change", () => {
      const others = this.choices.shown.filter((other) => other !== i);
      this.choices.set({ shown: box.checked ? [...others, i].slice(-Gaitcal.MOST_SHOWN) : others });
    });
    return Gaitcal.make("label", { class: "of-row" }, box);
  }

  mark() {
    for (const row of this.body.querySelectorAll("tr[data-person]")) {
      const on = this.choices.shown.includes(Number(row.dataset.person));
      row.classList.toggle("shown", on);
      row.querySelector("input").checked = on;
    }
  }

  turn(page, pages, count, rows) {
    const button = (words, to) => {
      const out = Gaitcal.make("button", { type: "button", disabled: to < 0 || to >= pages }, words);
      out.addEventListener("click", () => this.choices.set({ page: to }));
      return out;
    };
    const choice = Gaitcal.make(
      "select",
      {},
      ...[25, 50, 100, 0].map((number) =>
        Gaitcal.make("option", { value: number, selected: number === this.choices.rows }, number || "all"),
      ),
    );
    choice.addEventListener("change", () => this.choices.set({ rows: Number(choice.value), page: 0 }));
    const words = count ? `${page * rows + 1} to ${Math.min(count, (page + 1) * rows)} of ${count}` : "none";
    this.pager.replaceChildren(
      ...(pages > 1 ? [button("First", page ? 0 : -1), button("Previous", page - 1)] : []),
      Gaitcal.make("span", {}, words),
      ...(pages > 1 ? [button("Next", page + 1), button("Last", page < pages - 1 ? pages - 1 : -1)] : []),
      Gaitcal.make("label", { class: "pick" }, Gaitcal.make("span", {}, "Rows"), choice),
    );
  }
};
