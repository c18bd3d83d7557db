// The Settings page: the board's configuration beside the one a person is editing, with units and bounds. The same TOML as
// `twum config`; it is given to the board between runs.
import { act, button, element, field, say, table } from "./parts.js";
import { command, get, here, holds, listen, post } from "./talk.js";

let board = [], wanted = {}, version = null, host, rows, summary, send, unstable;

const text = value => typeof value === "string" ? value : String(value);

// The edited values as TOML; the server reads it as it reads a file.
function toml() {
  const tables = { "": [], control: [], limits: [] };
  for (const { key, value } of board) {
    const [table, name] = key.includes(".") ? key.split(".") : ["", key];
    const now = wanted[key] ?? text(value);
    const plain = /^[+-]?[0-9][0-9_]*(\.[0-9]+)?([eE][+-]?[0-9]+)?$/.test(now.trim()) || now === "true" || now === "false";
    tables[table].push(`${name} = ${plain ? now.trim() : JSON.stringify(now)}`);
  }
  return [tables[""].join("\n"), "[control]", ...tables.control, "[limits]", ...tables.limits].join("\n") + "\n";
}

function show() {
  rows = new Map();
  const made = board.map(({ key, value, unit, bounds }) => {
    const input = element("input", { value: wanted[key] ?? text(value), size: 18, ariaLabel: key, spellcheck: false });
    const row = element("tr", {}, element("th", { textContent: key, scope: "row" }), element("td", { textContent: text(value) }),
      element("td", {}, input), element("td", { textContent: unit }), element("td", { textContent: bounds }));
    const mark = () => row.classList.toggle("changed", input.value !== text(value));
    input.oninput = () => { wanted[key] = input.value; mark(); check(); };
    mark();
    rows.set(key, input);
    return row;
  });
  host.replaceChildren(table(["key", "board", "wanted", "unit", "bounds"], made));
}

let asked = 0;
async function check() {
  const turn = ++asked;
  for (const input of rows.values()) input.classList.remove("wrong");
  try {
    const found = await post("/api/configuration/check", { toml: toml() });
    if (turn !== asked) return;
    summary.className = "";
    summary.textContent = found.differs.length
      ? `differs from the board's in ${found.differs.map(it => `${it.key}: ${text(it.board)} → ${text(it.wanted)}`).join("; ")}`
      : "as the board has it";
    send.dataset.differs = found.differs.length > 0;
  } catch (error) {
    if (turn !== asked) return;
    summary.className = "wrong-words";
    summary.textContent = error.message;
    send.dataset.differs = false;
    const key = [...rows.keys()].find(key => error.message.includes(`\`${key}\``) || error.message.includes(`${key.split(".").pop()} `));
    if (key) rows.get(key).classList.add("wrong");
  }
  enable();
}

const enable = () => { send.disabled = !(holds() && here.now?.connected && !here.now.doing && send.dataset.differs === "true"); };

async function load() {
  const found = await get("/api/configuration");
  board = found.rows;
  show();
  await check();
}

// What a TOML text changes, over what the board has.
async function read(words) {
  const found = await post("/api/configuration/check", { toml: words });
  wanted = Object.fromEntries(found.rows.map(({ key, value }) => [key, text(value)]));
  show();
  await check();
}

export const settings = {
  build(place) {
    host = element("div");
    summary = element("p");
    send = button("Give it to the board", act(async () => {
      const found = await command("/api/configuration", { toml: toml(), allow_unstable: unstable.checked });
      wanted = {};
      say(found.changed.length ? `the board is configured: ${found.changed.join(", ")}` : "the board had it already", false);
      await load();
    }), { id: "send", className: "primary" });
    unstable = element("input", { type: "checkbox", id: "unstable" });
    const file = element("input", { type: "file", accept: ".toml" });
    file.onchange = act(async () => { if (file.files[0]) await read(await file.files[0].text()); file.value = ""; });
    const save = button("Save as a file", act(async () => {
      const { toml: words } = await post("/api/configuration/check", { toml: toml() });
      const link = element("a", { href: URL.createObjectURL(new Blob([words], { type: "application/toml" })), download: "configuration.toml" });
      link.click();
      URL.revokeObjectURL(link.href);
    }));
    place.append(
      element("h2", { textContent: "Configuration" }),
      element("p", { className: "soft", textContent: "What the board runs with: it is changed between runs, by the page that holds the motor. What is left as the board has it stays. Every recording holds the configuration it was made with." }),
      element("div", { className: "row" }, send, field("allow unstable", unstable), button("As the board has it", act(async () => { wanted = {}; await load(); })),
        button("Controller of the thesis", act(() => read("control = \"thesis\""))), button("Default controller", act(() => read("control = \"default\""))), button("Gated controller", act(() => read("control = \"gated\""))),
        button("Planned controller", act(() => read("control = \"planned\""))),
        save, field("load a TOML file", file)),
      summary, host);
    listen(() => {
      enable();
      const now = here.now?.configuration_version;
      if (here.open && now !== version) { version = now; load().catch(error => say(error.message)); }
    });
  },
};
