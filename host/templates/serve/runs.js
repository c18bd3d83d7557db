// The Runs page: what is in the folder, one run in full, two over each other, notes.
import { act, button, clock, element, field, say, table } from "./parts.js";
import { get, here, listen, post } from "./talk.js";

let list, one, drawn = [], last = null, seen = "";
const size = bytes => bytes ? `${(bytes / 1e6).toFixed(bytes < 1e7 ? 2 : 0)} MB` : "";

async function load() {
  const { runs, folder } = await get("/api/runs");
  const rows = runs.map(run => {
    const figures = element("td", { className: "figures" });
    const row = element("tr", {}, element("td", { className: "name" }, element("a", { href: `#runs/${encodeURIComponent(run.name)}`, textContent: run.name })),
      element("td", { textContent: run.kind }), element("td", { textContent: clock(run.changed_s) }), element("td", { className: "number", textContent: size(run.bytes) }),
      figures, element("td", { className: "name", textContent: run.note ?? "" }));
    return { row, run, figures };
  });
  list.replaceChildren(element("p", { className: "soft", textContent: `${folder}: ${runs.length} entries, newest first` }),
    table(["run", "kind", "when", "size", "figures", "note"], rows.map(it => it.row)));
  // One after the other, and only those a person sees first.
  for (const { run, figures } of rows.filter(it => it.run.kind === "recording").slice(0, 20)) {
    try {
      const found = await get("/api/run/figures", { run: run.name });
      figures.textContent = (found.words ?? "no run in it").split("\n")[0];
    } catch (error) { figures.textContent = error.message; }
  }
}

function draw(place, figure) {
  last = [place, figure];
  for (const panel of drawn) panel.destroy();
  place.replaceChildren();
  drawn = plots.draw(place, figure);
}

async function open(name) {
  if (!name) { one.replaceChildren(); list.hidden = false; return load(); }
  list.hidden = true;
  const { runs } = await get("/api/runs"), run = runs.find(it => it.name === name);
  if (!run) throw new Error(`there is no ${name} in the folder any more`);
  const place = element("div", { id: "plots" }), words = element("pre", { textContent: "reading…" }), found = element("div");
  const notes = element("textarea", { ariaLabel: "notes", placeholder: "notes, kept beside the file" });
  const others = element("select", { ariaLabel: "another run" }, element("option", { value: "", textContent: "none" }),
    ...runs.filter(it => it.kind === "recording" && it.name !== name).map(it => element("option", { value: it.name, textContent: it.name })));
  others.onchange = act(async () => draw(place, (await get("/api/run/plots", others.value ? { run: name, with: others.value } : { run: name })).figure));
  const replay = button("Check bit for bit", act(async () => {
    const { exact, found: it } = await get("/api/run/replay", { run: name });
    found.textContent = it.checked
      ? `${it.checked} control ticks recomputed in ${it.runs} runs: ${exact ? "every one is as recorded" : `${it.mismatched} DIFFER`}; ${it.missing} missing`
      : "no control ticks to recompute: only a closed loop records them";
  }), { id: "replay" });
  const compare = button("Compare with the simulation", act(async () => { await post("/api/study", { kind: "compare", run: name }); location.hash = "#diagnosis"; }));
  const diagnose = button("Diagnose", act(async () => { await post("/api/study", { kind: "diagnose", runs: [name], quick: true }); location.hash = "#diagnosis"; }));
  one.replaceChildren(element("p", {}, element("a", { href: "#runs", textContent: "all runs" })), element("h2", { textContent: name }), words,
    element("div", { className: "row" }, run.kind === "recording" ? replay : null, compare, diagnose, field("over it", others)), found, place,
    element("h3", { textContent: "Notes" }), notes,
    element("div", { className: "row" }, button("Keep the notes", act(async () => { await post("/api/run/notes", { run: name, text: notes.value }); say("kept", false); }), { id: "keep" })));
  notes.value = (await get("/api/run/notes", { run: name })).text;
  get("/api/run/figures", { run: name }).then(it => {
    words.textContent = [it.words ?? "no run in it", ...(it.warnings ?? []), ...(it.losses ?? []),
      it.about ? `${it.about.chip}, firmware ${it.about.firmware}, ${new Date(Number(BigInt(it.about.start_unix_ns) / 1000000n)).toLocaleString()}` : ""].filter(Boolean).join("\n");
  }).catch(error => { words.textContent = error.message; });
  draw(place, (await get("/api/run/plots", { run: name })).figure);
}

export const runs = {
  build(place) {
    list = element("div");
    one = element("div");
    place.append(element("h2", { textContent: "Runs" }), list, one);
    listen(() => {
      const words = here.now?.last?.words ?? "";
      if (words !== seen && !place.hidden && !list.hidden) load().catch(error => say(error.message));
      seen = words;
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (last?.[0].isConnected) draw(...last); });
  },
  shown: name => open(name).catch(error => say(error.message)),
};
