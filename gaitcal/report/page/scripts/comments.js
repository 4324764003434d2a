// Comments of a reader, a box for each section of the report: kept in the page that is saved, and in `comments.toml`, which
// `gaitcal report --comments` reads.
Gaitcal.COMMENTS = {
  summary: "Summary", spatiotemporal: "Steps and phases", kinematics: "Kinematics", kinetics: "Kinetics", joints: "Joints",
};

// The page as its file has it, before anything is drawn into it: with its scripts, what a saved page is made of.
Gaitcal.unmade = [...document.body.children].filter(({ tagName }) => tagName !== "SCRIPT").map((part) => part.outerHTML);
Gaitcal.unmadeHead = [...document.head.children].filter((part) => part.matches("meta, title, title + style")).map((part) => part.outerHTML);

// {of(section): a paragraph for paper, or null}
Gaitcal.comments = (host, { state }) => {
  const kept = JSON.parse(Gaitcal.get("commented").textContent);
  const boxes = Object.entries(Gaitcal.COMMENTS).map(([section, title]) => {
    const box = html("textarea", { id: `comment-${section}`, rows: 2 });
    box.value = kept[section] ?? "";
    return { section, title, box };
  });
  const texts = () => boxes.map(({ section, box }) => [section, box.value.trim()]).filter(([, text]) => text);
  const page = () => {
    const json = JSON.stringify(Object.fromEntries(texts())).replaceAll("<", "\\u003c");
    const scripts = [...document.body.querySelectorAll(":scope > script")].map((script) =>
      script.id === "commented" ? `<script type="application/json" id="commented">${json}</script>` : script.outerHTML);
    const body = [...Gaitcal.unmade, ...scripts].join("\n");
    return `<!DOCTYPE html>\n<html lang="en">\n<head>\n${Gaitcal.unmadeHead.join("\n")}\n</head>\n<body>\n${body}\n</body>\n</html>\n`;
  };
  // A text of JSON is one of TOML but for the character that JSON leaves as it is.
  const toml = () => texts().map(([section, text]) => `${section} = ${JSON.stringify(text).replaceAll("\x7f", "")}\n`).join("");
  const name = decodeURIComponent(window.location.pathname.split("/").at(-1)) || "result.html";
  Gaitcal.built(host, "", [
    html("h2", "Comments"),
    html("div.boxes", boxes.map(({ title, box }) => html("label", html("span", title), box))),
    html("p.row",
      Gaitcal.button("Save page with comments", () => Gaitcal.download(name, page(), "text/html")),
      Gaitcal.button("Save comments.toml", () => Gaitcal.download("comments.toml", toml(), "text/plain")),
      Gaitcal.button("Print this page", () => window.print())),
    html("p.soft", "Report on paper, with these comments: gaitcal report RESULT --comments comments.toml"),
  ]);
  const show = () => { host.hidden = state.preset !== "clinician"; };
  state.on(["preset"], show);
  show();
  return { of: (section) => {
    const text = Object.fromEntries(texts())[section];
    return text ? html("p.comment", html("strong", "Comment: "), text) : null;
  } };
};
