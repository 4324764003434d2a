// Foot events that a reader corrects on the timeline: dragged or moved by arrow keys, added at the clock, deleted; saved as
// `events.csv`, which calibrate and dynamics read. What depends on them is computed there (gaitcal/io/csv_recordings.py).
// The table: all events of the files of which a trial is corrected, now (`changed`) or before.
Gaitcal.eventTable = (trials, changed) => {
  const corrected = (trial) => changed.has(trial) || trial.events.some(({ source }) => source === Gaitcal.BY_HAND);
  const files = new Set(trials.filter(corrected).map(({ file }) => file));
  const cell = (text) => (/[",]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const rows = trials
    .filter(({ file }) => files.has(file))
    .flatMap(({ file, start, events }) => events.map(({ time, ...event }) => ({ ...event, file, time: start + time })))
    .sort((a, b) => a.file.localeCompare(b.file) || a.time - b.time)
    .map(({ file, time, side, kind }) => [cell(file), Number(time.toFixed(6)), Gaitcal.LEGS[side], kind].join(","));
  return `${["file,time,side,event", ...new Set(rows)].join("\n")}\n`;
};

Gaitcal.download = (name, text, type) => {
  const link = html("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
};

// {on(): whether events can be changed now, movable(mark, event): the mark of an event made so}
Gaitcal.events = (page) => {
  const { state, timeline } = page;
  const [bar, button] = [Gaitcal.get("events"), Gaitcal.get("correct")];
  const [changed, before] = [new Set(), new Map()];
  const told = html("output");
  const frame = (seconds) => page.curves.strides.trial.frame(seconds);
  const change = (edit) => {
    const { sheet } = page;
    if (!before.has(sheet)) before.set(sheet, structuredClone(sheet.events));
    edit(sheet.events);
    sheet.events.sort((a, b) => a.time - b.time);
    changed.add(sheet);
    told.textContent = "Not saved. Curves, strides and tables are still those of the events before.";
    timeline.open();
  };
  const move = (event, seconds) => change(() => Object.assign(event, { time: frame(seconds), source: Gaitcal.BY_HAND }));
  const remove = (event) => change((events) => events.splice(events.indexOf(event), 1));
  const add = (side, kind) =>
    change((events) => events.push({ side, kind, time: frame(state.seconds), source: Gaitcal.BY_HAND }));
  const undo = () => {
    const { sheet } = page;
    if (changed.delete(sheet)) sheet.events.splice(0, Number.POSITIVE_INFINITY, ...structuredClone(before.get(sheet)));
    told.textContent = "";
    timeline.open();
  };
  const save = () => {
    const { trials } = page.result.sheet;
    const [table, empty] = [Gaitcal.eventTable(trials, changed), trials.find((one) => changed.has(one) && !one.events.length)];
    if (empty || !table.includes("\n", 21)) {
      told.textContent = empty ? `No event is left in ${empty.name}: keep one at least.` : "Nothing is corrected.";
      return;
    }
    Gaitcal.download("events.csv", table, "text/csv");
    const { file } = page.sheet;
    told.textContent =
      `Put events.csv beside ${file} and compute again: gaitcal calibrate FOLDER --out RESULT; of a further trial: ` +
      `gaitcal dynamics RESULT ${file}`;
  };
  const adds = ["r", "l"].flatMap((side) =>
    ["foot strike", "foot off"].map((kind) => Gaitcal.button(`${Gaitcal.LEGS[side]} ${kind}`, () => add(side, kind))));
  Gaitcal.built(bar, "", [
    html("span", "Drag an event, or reach it by Tab: arrows move it, Delete removes it. Add at the clock:"), adds,
    Gaitcal.button("Undo", undo), Gaitcal.button("Save events", save), told,
  ]);
  const show = (on) => {
    bar.hidden = !on;
    button.setAttribute("aria-expanded", String(on));
    if (on) state.set({ playing: false });
    timeline.open();
  };
  button.addEventListener("click", () => show(bar.hidden));
  const movable = (mark, event) => {
    const number = page.sheet.events.indexOf(event);
    let from = null;
    const far = ({ clientX }) => from !== null && Math.abs(clientX - from) >= Gaitcal.DRAGGED;
    // After a change all marks are new: the focus stays with the event.
    const kept = (edit) => {
      edit();
      const there = page.sheet.events.indexOf(event);
      document.querySelector(`#tracks [data-event="${there}"]`)?.focus();
    };
    return Gaitcal.built(mark, "", [{
      class: "movable", tabindex: 0, role: "button", "data-event": number,
      "aria-label": `${Gaitcal.LEGS[event.side]} ${event.kind} at ${event.time.toFixed(3)} s`,
      focus: () => state.set({ playing: false, seconds: event.time }),
      pointerdown: (down) => {
        down.stopPropagation();
        from = down.clientX;
        mark.setPointerCapture(down.pointerId);
      },
      pointermove: (drag) => {
        drag.stopPropagation();
        const x = timeline.share(timeline.at(drag));
        if (far(drag)) Gaitcal.dress(mark, { x1: x, x2: x, cx: x });
      },
      pointerup: (up) => {
        up.stopPropagation();
        const moved = far(up);
        from = null;
        if (moved) kept(() => move(event, timeline.at(up)));
        else mark.focus();
      },
      keydown: (down) => {
        const step = { ArrowLeft: -1, ArrowRight: 1 }[down.key];
        if (step) {
          page.clock.step(step * (down.shiftKey ? 10 : 1));
          kept(() => move(event, state.seconds));
        } else if (["Delete", "Backspace"].includes(down.key)) remove(event);
        else return;
        down.preventDefault();
        down.stopPropagation();
      },
    }]);
  };
  return { on: () => !bar.hidden, movable };
};
