// The table of people: sorted by a press on a column's name, filtered below it, some rows at a time.
Gaitcal.peopleTable = (people, choices) => {
  const part = (selector) => document.querySelector(`#people ${selector}`);
  const [table, head, body, pager] = [".people-table table", "thead", "tbody", ".pager"].map(part);
  let columns = []; // {column, cell, arrow, input}
  Gaitcal.widths.observe(part(".people-table"));

  const headOf = (column) => {
    const { name, title, meaning, side, unit, text } = column;
    const arrow = html("span.arrow", { "aria-hidden": "true" });
    const next = () => ({ [name]: `-${name}`, [`-${name}`]: "" })[choices.sort] ?? name;
    const about = [side && Gaitcal.LEGS[side], unit].filter(Boolean).map((words) => html("span.unit", ` ${words}`));
    const sort = () => choices.set({ sort: next() });
    const button = Gaitcal.button([Gaitcal.visible(title), arrow, about], sort, { title: meaning || null });
    const kind = [text && "text", side && `side-${side}`].filter(Boolean).join(" ");
    const input = html("input", {
      type: "text",
      autocomplete: "off",
      spellcheck: "false",
      "aria-label": `Filter ${Gaitcal.columnWords(column)}`,
      placeholder: text ? "words" : ">",
      input: () => {
        const tests = new Map(choices.tests);
        if (input.value.trim()) tests.set(name, input.value);
        else tests.delete(name);
        choices.set({ tests });
      },
    });
    return { column, cell: html("th", { scope: "col", class: kind }, button), arrow, input };
  };

  const cell = ({ column: { name, text, digits, error, at } }, i, first) => {
    const value = at(i);
    const number = () => {
      const half = error?.(i);
      const known = Number.isFinite(half) && html("span.soft", ` ± ${Gaitcal.numeral(half, digits)}`);
      return [Gaitcal.numeral(value, digits), known];
    };
    const words = () => {
      const shown = name === "first_cause" ? Gaitcal.capital(Gaitcal.visible(value)) : Gaitcal.visible(value);
      return shown.length > 90 ? html("span", { title: shown }, `${shown.slice(0, 89)}…`) : shown;
    };
    const own = { person: () => people.linked(i, value), verdict: () => Gaitcal.judgement(value) };
    const content = (own[name] ?? (text ? words : number))();
    if (!first) return html("td", { class: text && `text ${name}` }, content);
    const label = { "aria-label": `Draw the curves of ${Gaitcal.visible(people.name(i))}` };
    const change = ({ target }) => choices.show(i, target.checked);
    return html("th.text", { scope: "row" }, html("label.of-row", html("input", { type: "checkbox", change, ...label })), content);
  };

  const mark = () => {
    for (const row of body.querySelectorAll("tr[data-person]")) {
      const on = choices.shown.includes(Number(row.dataset.person));
      row.classList.toggle("shown", on);
      row.querySelector("input").checked = on;
    }
  };

  // The rows of the page of the table that is chosen; `most`: so many rows whatever is chosen.
  const fill = (most = null) => {
    const order = choices.sorted();
    const rows = most ?? (choices.rows || order.length);
    const last = Math.max(1, Math.ceil(order.length / Math.max(1, rows))) - 1;
    const page = most ? 0 : Math.min(choices.page, last);
    const listed = order.slice(page * rows, (page + 1) * rows);
    const row = (i) => html("tr", { "data-person": i }, columns.map((column, k) => cell(column, i, k === 0)));
    const nobody = html("tr", html("td.text.nobody", { colspan: columns.length }, "No person passes all filters."));
    body.replaceChildren(...(listed.length ? listed.map(row) : [nobody]));
    for (const { column, cell: top, arrow, input } of columns) {
      const way = { [column.name]: "ascending", [`-${column.name}`]: "descending" }[choices.sort];
      if (way) top.setAttribute("aria-sort", way);
      else top.removeAttribute("aria-sort");
      arrow.textContent = { ascending: " ▲", descending: " ▼" }[way] ?? "";
      const text = choices.tests.get(column.name) ?? "";
      if (input.value.trim() !== text.trim()) input.value = text;
      if (text.trim() && !Gaitcal.columnTest(column, text)) input.setAttribute("aria-invalid", "true");
      else input.removeAttribute("aria-invalid");
    }
    const from = page * rows;
    const words = order.length ? `${from + 1} to ${Math.min(order.length, from + rows)} of ${order.length}` : "none";
    pager.querySelector("span").textContent = words;
    const pages = [0, page - 1, page + 1, last];
    for (const [k, button] of pager.querySelectorAll("button").entries()) {
      button.hidden = last === 0;
      button.disabled = k < 2 ? page === 0 : page === last;
      button.onclick = () => choices.set({ page: pages[k] });
    }
    mark();
  };

  // The filters stay in view below the names, however many lines those take.
  const tall = new ResizeObserver(([{ target }]) => table.style.setProperty("--head", `${target.offsetHeight}px`));
  const draw = () => {
    columns = choices.columns.map((name) => headOf(people.columns.get(name)));
    const names = html("tr", columns.map((one) => one.cell));
    head.replaceChildren(names, html("tr.tests", columns.map(({ input }) => html("td", input))));
    tall.disconnect();
    tall.observe(names);
    fill();
  };

  // A press on a row does what its box does, unless it is on something else, or words were marked.
  body.addEventListener("click", ({ target }) => {
    if (target.closest("a, input, label") || String(window.getSelection())) return;
    target.closest("tr").querySelector("input")?.click();
  });
  choices.on(["columns"], draw);
  choices.on([...Gaitcal.NARROWING, "sort", "page", "rows"], () => fill());
  choices.on(["shown"], mark);
  window.addEventListener("beforeprint", () => fill(people.count));
  window.addEventListener("afterprint", () => fill());
  draw();
};

// Which columns the table has: a list of all of them with their units and meanings, found by words.
Gaitcal.chooser = (people, choices) => {
  const dialog = Gaitcal.get("chooser");
  // A new column comes last; one whose filter is on is filtered no more when it goes.
  const chosen = (name, on) => {
    const columns = choices.columns.filter((other) => other !== name);
    const tests = new Map(choices.tests);
    if (on) columns.push(name);
    else tests.delete(name);
    if (columns.length) choices.set(tests.size === choices.tests.size ? { columns } : { columns, tests });
    mark();
  };
  const entries = [...people.columns.values()].map((column) => {
    const { name, unit, meaning } = column;
    const title = Gaitcal.columnWords(column);
    const words = [Gaitcal.visible(title), unit && html("span.unit", ` ${unit}`), html("span.soft", ` ${meaning}`)];
    const label = Gaitcal.tick(html("span", words), (on) => chosen(name, on));
    return { name, box: label.control, item: html("li", label), text: `${title} ${name} ${unit} ${meaning}`.toLowerCase() };
  });
  const mark = () => { for (const { name, box } of entries) box.checked = choices.columns.includes(name); };
  dialog.querySelector("ul").append(...entries.map(({ item }) => item));
  dialog.querySelector("input").addEventListener("input", ({ target }) => {
    const words = target.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const { item, text } of entries) item.hidden = !words.every((word) => text.includes(word));
  });
  choices.on(["columns"], mark);
  mark();
  Gaitcal.get("columns").addEventListener("click", () => dialog.showModal());
  Gaitcal.get("columns-close").addEventListener("click", () => dialog.close());
  Gaitcal.get("columns-usual").addEventListener("click", () => choices.set({ columns: choices.usual.columns }));
};
