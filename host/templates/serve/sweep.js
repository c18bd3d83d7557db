// A stator's sweep: started here or in a terminal, and looked at while it is made.
import { act, button, element, field, number, say } from "./parts.js";
import { get, here, holds, listen, post } from "./talk.js";

// What `twum instruments sweep` is told, and the plots; `shunt` is the page's field, `swept` is called with the file's name.
export function sweeping(shunt, swept) {
  const words = element("p", { className: "callout" }), place = element("div", { id: "swept" });
  let turn = 0, drawn = [], mine = null;
  const close = () => { turn++; shown.hidden = true; };
  const shown = element("div", { hidden: true }, words, element("div", { className: "row" }, button("Close the sweep", close, { id: "close-sweep" })), place);
  const counted = () => here.now?.doing?.what.match(/(\d+) of (\d+) frequencies/);
  const isOn = () => Boolean(here.open && here.now?.doing?.what.startsWith("sweep"));

  // Its points so far, every second while this page is shown. There are none before the instruments are ready.
  async function follow(run) {
    const own = ++turn;
    let taken = -1;
    shown.dataset.taken = taken;
    words.textContent = `${run}: about to begin`;
    place.replaceChildren();
    shown.hidden = false;
    while (own === turn && mine === run && isOn() && !counted()) await new Promise(done => setTimeout(done, 100));
    while (own === turn) {
      if (!shown.closest("section").hidden) {
        const found = await get("/api/sweep", { run, shunt_ohm: shunt.valueAsNumber });
        if (own !== turn) return;
        const of = found.planned == null ? "" : ` of ${found.planned}`, bad = found.unreadable ? `; ${found.unreadable} show no sine` : "";
        words.textContent = `${run}: ${found.taken}${of} frequencies${bad}`;
        if (found.taken !== taken) {
          taken = found.taken;
          for (const panel of drawn) panel.destroy();
          place.replaceChildren();
          drawn = plots.draw(place, found.figure);
        }
        shown.dataset.taken = taken;
      }
      await new Promise(done => setTimeout(done, 1000));
    }
  }
  const watch = run => { follow(run).catch(error => { close(); say(error.message); }); };

  const text = (value, properties) => element("input", { value, ...properties });
  const name = text("", { size: 16 }), generator = text("", { size: 20, placeholder: "/dev/usbtmc0, host:port" }), scope = text("", { size: 20, placeholder: "/dev/usbtmc1, host:port" });
  const [from, to, step, vpp, settle] = [number("", 100), number("", 100), number("", 1), number("", 0.5, { min: 0, max: 6 }), number("", 1, { min: 0 })];
  const both = element("input", { type: "checkbox", checked: true });
  const begin = button("Sweep the stator", act(async () => {
    const run = name.value.trim();
    await post("/api/sweep/run", {
      page: here.page, name: run, generator: generator.value.trim(), scope: scope.value.trim(), from_hz: from.valueAsNumber, to_hz: to.valueAsNumber,
      step_hz: step.valueAsNumber, vpp: vpp.valueAsNumber, settle_ms: settle.valueAsNumber, single_phase: !both.checked,
    });
    mine = run;
    watch(run);
  }), { id: "sweep", className: "primary" });
  const end = button("Stop the sweep", act(() => post("/api/stop")), { id: "stop-sweep" });
  const progress = element("progress", { max: 1 }), state = element("p", { role: "status" });
  const needs = element("p", { className: "soft" });
  const plan = element("details", { id: "sweeping" }, element("summary", { textContent: "Sweep a stator with generator and oscilloscope" }),
    element("p", { className: "soft", textContent: "Channel 1 of the oscilloscope sits before the shunt, channel 2 between shunt and stator. This page holds the motor while it lasts; STOP, Escape, the space bar and a page that is gone switch the generator off. The same plan into the same file goes on with a sweep that was stopped." }),
    element("div", { className: "row" }, field("into the file", name), field("generator", generator), field("oscilloscope", scope)),
    element("div", { className: "row" }, field("from, Hz", from), field("to, Hz", to), field("step, Hz", step), field("drive, Vpp", vpp), field("ring in, ms", settle), element("label", { className: "tick" }, both, "both phases"), begin),
    needs);
  const form = element("div", {}, plan, element("div", { className: "row" }, progress, state, end));

  let wasOn = false;
  listen(() => {
    const on = isOn();
    begin.dataset.off = String(!(holds() && !here.now?.doing));
    begin.disabled = begin.dataset.off === "true";
    needs.textContent = holds() ? "" : "Take the motor to sweep: one page at a time drives anything.";
    for (const node of [progress, state, end]) node.hidden = !on;
    if (on) {
      const [, at, of] = counted() ?? [0, 0, 1];
      progress.value = at / of;
      state.textContent = here.now.doing.what;
    }
    if (wasOn && !on && here.open) {
      if (!here.now.last?.ok) {
        say(here.now.last?.words ?? "");
        if (shown.dataset.taken === "-1") close();
      }
      if (mine) swept(mine);
      mine = null;
    }
    if (here.open) wasOn = on;
  });
  // What is usual, where nothing stands yet.
  async function fill() {
    const it = await get("/api/sweep/setup");
    for (const [field, value] of [[name, it.name], [generator, it.generator], [scope, it.scope], [from, it.from_hz], [to, it.to_hz], [step, it.step_hz], [vpp, it.vpp], [settle, it.settle_ms]]) if (field.value === "") field.value = value ?? "";
  }
  return { form, shown, watch, fill };
}
