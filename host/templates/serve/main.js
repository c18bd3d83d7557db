// The frame of every page: the stop button and its keys, the board's own state, who holds the motor, and which page is shown.
import { act, button, element, say } from "./parts.js";
import { begin, command, here, holds, listen, post } from "./talk.js";
import { bench } from "./bench.js";
import { model } from "./model.js";
import { settings } from "./settings.js";
import { runs } from "./runs.js";
import { diagnosis, experiment } from "./studies.js";

const pages = { bench, settings, runs, experiment, diagnosis, model };
const byId = id => document.getElementById(id);

async function stop() {
  try {
    const { sweep } = await post("/api/stop");
    say(sweep ?? "stopped: the board says that the drive is off", Boolean(sweep));
  } catch (error) {
    say(`STOP: ${error.message}`);
  }
}
byId("stop").onpointerdown = event => { if (event.button === 0) stop(); };
// With the keyboard, and from programs that click.
byId("stop").onclick = event => { if (event.detail === 0) stop(); };

// The keys stop from everywhere. Where a person writes, a space is a space; Escape stops there too.
window.addEventListener("keydown", event => {
  // Space is taken: Enter ticks a box.
  if (event.key === "Enter" && event.target.matches?.("input[type=checkbox]")) event.target.click();
  const writes = event.target.matches?.("textarea, input:not([type=checkbox]):not([type=radio]):not([type=range]):not([type=number])");
  if (event.key === "Escape" || (event.key === " " && !writes)) {
    event.preventDefault();
    event.stopPropagation();
    if (!event.repeat) stop();
  }
}, true);
// The same keys in the frame of a report. A stop is anybody's.
window.addEventListener("message", event => { if (event.data === "stop" && event.source === document.querySelector("iframe")?.contentWindow) stop(); });
// A button is clicked by the space bar's release: that click is none.
window.addEventListener("keyup", event => { if (event.key === " " && event.target.matches?.("button, summary, select")) event.preventDefault(); }, true);

byId("take").onclick = act(() => holds() ? command("/api/release") : command("/api/take"));

const WORDS = { Idle: "off", Aligning: "aligning", Passthrough: "driver command", Armed: "armed", Running: "running", Stopping: "stopping", Fault: "FAULT" };

function showState() {
  const mode = byId("mode"), now = here.now, take = byId("take");
  let words, kind;
  const silent = (performance.now() - here.heard) / 1000;
  if (!here.open) [words, kind] = ["no connection to the server", "unknown"];
  else if (silent > 1) [words, kind] = [`nothing heard of the server since ${silent.toFixed(0)} s`, "unknown"];
  // With a board or without one, the generator drives the stator.
  else if (now.doing?.what.startsWith("sweep") && !now.fault) [words, kind] = ["sweeping", "on"];
  else if (!now.connected) [words, kind] = [now.trouble ?? "the board does not answer", "unknown"];
  else if (now.heard_ms_ago == null || now.heard_ms_ago > 1000) [words, kind] = [`the board says nothing${now.heard_ms_ago == null ? "" : ` since ${(now.heard_ms_ago / 1000).toFixed(0)} s`}`, "unknown"];
  else if (now.fault) [words, kind] = [`FAULT ${now.fault.name}`, "fault"];
  else [words, kind] = [WORDS[now.mode] ?? now.mode, now.is_off ? "off" : "on"];
  if (mode.textContent !== words) mode.textContent = words;
  mode.className = kind;
  document.body.dataset.mode = here.open ? now.mode : "";
  document.body.dataset.off = here.open && now.connected && kind !== "unknown" ? now.is_off : "";
  document.body.dataset.holder = here.holder;
  const doing = here.open ? now.doing : null;
  byId("doing").textContent = doing
    ? `${doing.what}${doing.recording ? `, recorded as ${doing.recording}` : ""}: ${doing.elapsed_s.toFixed(1)} s${doing.seconds ? ` of ${doing.seconds.toFixed(1)} s` : ""}`
    : (now?.last?.words ?? "");
  const text = holds() ? "Give the motor back" : here.holder === "another" ? "Take the motor from another page" : "Take the motor";
  if (take.textContent !== text) take.textContent = text;
  take.disabled = !here.open;
}

function showPage() {
  const asked = location.hash.slice(1).split("/")[0];
  const name = asked in pages ? asked : "bench";
  for (const id of Object.keys(pages)) byId(`page-${id}`).hidden = id !== name;
  for (const link of document.querySelectorAll("nav a")) {
    if (link.hash === `#${name}`) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  }
  pages[name].shown?.(decodeURIComponent(location.hash.slice(2 + name.length)));
}

listen(showState);
// Ages are told even when nothing comes.
setInterval(showState, 500);
for (const [id, page] of Object.entries(pages)) page.build(byId(`page-${id}`));
window.addEventListener("hashchange", showPage);
begin().catch(error => say(error.message)).finally(showPage);
