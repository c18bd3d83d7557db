// The Model page: parameters and effects under sliders, what the averaged model makes of them, a measured run beside it.
import { act, button, choice, element, field, say } from "./parts.js";
import { get, post } from "./talk.js";

let known = null, host, place, words, motor, flavour, control, run, chosenMotor = "", chosen = {}, effects = {}, drawn = [], last = null, turn = 0, waiting = 0;

const short = value => (Math.abs(value) >= 1e6 ? Number(value).toExponential(3).replace("e+", "e").replace(/\.?0+e/, "e") : String(+Number(value).toPrecision(4))).replaceAll("-", "−");

// What a slider may move: from a half to one and a half of what the motor has, inside the model's bounds.
function slider(name, unit, value, low, high, changed) {
  const shown = element("output", { textContent: `${short(value)} ${unit === "1" ? "" : unit}` });
  const input = element("input", { type: "range", min: 0, max: 1000, value: high > low ? 1000 * (value - low) / (high - low) : 0, ariaLabel: name });
  input.oninput = () => {
    const now = low + (high - low) * input.value / 1000;
    shown.textContent = `${short(now)} ${unit === "1" ? "" : unit}`;
    changed(now);
    later();
  };
  return element("label", {}, `${name} `, input, shown);
}

function build() {
  chosen = {};
  // What the motor file lists is there at first.
  effects = Object.fromEntries(Object.entries(known.own_effects).map(([name, values]) => [name, [...values]]));
  const rows = known.flavours[flavour.value].filter(it => it.value !== 0).map(it => {
    const reach = [0.5 * it.value, 1.5 * it.value].sort((a, b) => a - b);
    // A few per cent of these take the drive off the resonance.
    const narrow = ["f", "Ms", "Ks"].includes(it.name) ? [0.97 * it.value, 1.03 * it.value] : reach;
    return it.name === "n" ? null : slider(it.name, it.unit, it.value, Math.max(it.lower, narrow[0]), Math.min(it.upper, narrow[1]), value => { chosen[it.name] = value; });
  });
  const hidden = known.effects.map(effect => {
    const own = effects[effect.name], values = own ?? effect.parameters.map(p => p.typical), on = element("input", { type: "checkbox", checked: Boolean(own) });
    const sliders = element("div", { hidden: !own }, ...effect.parameters.map((p, i) => {
      const [low, high] = [Math.max(p.lower, Math.min(p.absent, 2 * p.typical, values[i])), Math.min(p.upper, Math.max(p.absent, 2 * p.typical, values[i]))];
      return slider(p.name, p.unit, values[i], low, high, value => { values[i] = value; });
    }));
    on.onchange = () => { sliders.hidden = !on.checked; if (on.checked) effects[effect.name] = values; else delete effects[effect.name]; later(); };
    return element("div", {}, element("label", { className: "tick" }, on, effect.name), sliders);
  });
  host.replaceChildren(element("div", { className: "sliders" }, ...rows.filter(Boolean)), element("h3", { textContent: "Effects" }), element("div", { className: "sliders" }, ...hidden));
  later();
}

const later = () => { clearTimeout(waiting); waiting = setTimeout(() => predict().catch(error => { words.textContent = error.message; }), 60); };

async function predict() {
  const mine = ++turn;
  const found = await post("/api/model", { motor: motor.value, flavour: flavour.value, set: chosen, effects, control: control.value, run: run.value || null });
  if (mine !== turn) return;
  words.textContent = `${short(found.full_drive_rpm)} rpm at full drive; the thesis's sine is followed with ${short(found.following.mse_deg2)} deg², ${short(found.following.mean_abs_deg)}° on average`;
  last = found.figure;
  redraw(last);
  place.dataset.turn = mine;
}

function redraw(figure) {
  for (const panel of drawn) panel.destroy();
  place.replaceChildren();
  drawn = plots.draw(place, figure);
}

async function choose() {
  known = await get("/api/model", motor.value ? { motor: motor.value } : {});
  motor.replaceChildren(...known.motors.map(name => element("option", { value: name, textContent: name })));
  motor.value = known.motors.includes(chosenMotor) ? chosenMotor : known.motors[0];
  build();
}

export const model = {
  build(section) {
    motor = element("select", { id: "motor" });
    motor.onchange = () => { chosenMotor = motor.value; choose().catch(error => say(error.message)); };
    flavour = choice([["physical", "physical"], ["measured", "measured"], ["thesis", "thesis"]]);
    control = choice([["thesis", "of the thesis"], ["default", "default"], ["board", "the board's"]]);
    run = element("select", { ariaLabel: "measured beside it" });
    flavour.onchange = build;
    control.onchange = later;
    run.onchange = later;
    host = element("div");
    place = element("div", { id: "predicted" });
    words = element("p", { className: "callout" });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (last) redraw(last); });
    section.append(element("h2", { textContent: "Model" }),
      element("p", { className: "soft", textContent: "The averaged model of a travelling-wave motor, a shipped one or that of a motor file in the folder of runs: speed against duty at 50 Hz PWM, and the thesis's closed loop (80.1°, 1.257 rad/s, 10 s). Nothing here moves the motor." }),
      element("div", { className: "row" }, field("motor", motor), field("flavour", flavour), field("controller", control), field("measured beside it", run), button("As the motor file has it", act(async () => build()))),
      words, place, element("h3", { textContent: "Parameters" }), host);
  },
  async shown() {
    try {
      const before = run.value, { runs } = await get("/api/runs");
      run.replaceChildren(element("option", { value: "", textContent: "none" }), ...runs.filter(it => it.kind !== "experiment").map(it => element("option", { value: it.name, textContent: it.name })));
      run.value = before;
      if (!known) await choose();
    } catch (error) { say(error.message); }
  },
};
