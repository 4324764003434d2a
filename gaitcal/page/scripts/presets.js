"use strict";
// The presets as tabs.
Gaitcal.Presets = class {
  constructor(host, page) {
    this.page = page;
    this.state = page.state;
    this.tabs = Gaitcal.PRESETS.map(({ name, title }) => {
      const tab = document.createElement("button");
      tab.type = "button";
      tab.role = "tab";
      tab.id = `preset-${name}`;
      tab.setAttribute("aria-controls", "panel");
      tab.textContent = title;
      tab.addEventListener("click", () => this.state.set({ preset: name }));
      host.append(tab);
      return tab;
    });
    host.addEventListener("keydown", (event) => this.moved(event));
    this.state.on(["preset"], () => this.write());
    this.write();
  }

  // Arrow keys go from tab to tab, and around.
  moved(event) {
    const here = this.tabs.indexOf(event.target);
    const last = this.tabs.length - 1;
    const there = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: last }[event.key];
    if (there === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    const tab = this.tabs[there < 0 ? last : there > last ? 0 : there];
    tab.focus();
    tab.click();
  }

  write() {
    const { preset } = this.state;
    for (const tab of this.tabs) {
      const chosen = tab.id === `preset-${preset}`;
      tab.setAttribute("aria-selected", String(chosen));
      tab.tabIndex = chosen ? 0 : -1;
    }
    document.getElementById("panel").setAttribute("aria-labelledby", `preset-${preset}`);
    document.getElementById("main").dataset.preset = preset;
    for (const id of ["switches", "curves", "steps"]) document.getElementById(id).hidden = preset !== "clinician";
  }
};
