// The Experiment and Diagnosis pages: plans that the board carries out, and what the command line computes of runs.
import { act, button, choice, element, field, number, say, table } from "./parts.js";
import { command, get, here, holds, listen, post } from "./talk.js";
import { sweeping } from "./sweep.js";

let planned = [], planPlace, name, begin, resume;

function showPlan(runs) {
  planned = runs;
  const total = runs.reduce((sum, run) => sum + run.seconds + run.pause_s, 0);
  planPlace.replaceChildren(
    element("p", { textContent: runs.length ? `${runs.length} runs, ${total.toFixed(0)} s of drive and pauses` : "nothing is open that another run would decide" }),
    table(["run", "duty", "direction", "PWM, Hz", "drive, s", "pause, s", "why"], runs.map(run => element("tr", {},
      ...[run.id, run.duty, run.direction, run.pwm_hz, run.seconds, run.pause_s, run.why].map(cell => element("td", { textContent: cell }))))));
  enable();
}

function enable() {
  const ready = holds() && here.now?.connected && !here.now.doing && !here.now.fault;
  begin.disabled = !(ready && planned.length);
  resume.disabled = !(ready && experiment.kept.value);
}

// A run of `twum experiment plan --json`, as a series keeps it.
const inSeries = (run, number) => ({
  id: `${String(number).padStart(3, "0")}-d${String(Math.round(100 * run.duty)).padStart(3, "0")}-${run.direction}-${Math.round(run.pwm_hz)}hz`,
  duty: run.duty, direction: run.direction, pwm_hz: run.pwm_hz, seconds: run.seconds, pause_s: run.pause_s, why: run.why,
});

export const experiment = {
  build(place) {
    const duties = element("input", { value: "0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1", size: 44 });
    const directions = choice([["both", "both"], ["cw", "cw"], ["ccw", "ccw"]]), trials = number(3, 1, { min: 1 }), seconds = number(5, 0.1);
    planPlace = element("div");
    name = element("input", { value: "experiment-1", ariaLabel: "name of the experiment's folder" });
    const kept = element("select", { ariaLabel: "experiments" }), progress = element("progress", { max: 1, hidden: true }), doing = element("p");
    begin = button("Make these runs", act(() => command2("/api/experiment/run", { name: name.value.trim(), runs: planned })), { id: "make", className: "primary" });
    resume = button("Go on with it", act(() => command2("/api/experiment/run", { name: kept.value, runs: null })));
    place.append(element("h2", { textContent: "Experiment" }),
      element("p", { className: "soft", textContent: "A series of open-loop runs, each recorded, then made into a measurement. This page holds the motor while it lasts: leave it open. \u201ctwum experiment run\u201d makes the same without a page." }),
      element("div", { className: "row" }, field("duties", duties), field("directions", directions), field("trials", trials), field("length of each, s", seconds),
        button("Plan", act(async () => {
          const table = { duties: duties.value.split(/[\s,;]+/).filter(Boolean).map(Number), directions: directions.value === "both" ? ["cw", "ccw"] : [directions.value], trials: trials.valueAsNumber, seconds: seconds.valueAsNumber };
          showPlan((await post("/api/experiment/plan", table)).runs);
        }), { id: "plan" })),
      planPlace, element("div", { className: "row" }, field("folder", name), begin), progress, doing,
      element("h3", { textContent: "Go on with one that was interrupted" }), element("div", { className: "row" }, field("experiment", kept), resume));
    this.kept = kept;
    listen(() => {
      enable();
      const now = here.now?.doing;
      progress.hidden = !now?.what.startsWith("experiment");
      if (!progress.hidden) {
        const [, at, of] = now.what.match(/run (\d+) of (\d+)/) ?? [0, 0, 1];
        progress.value = (at - 1 + Math.min(1, now.elapsed_s / (now.seconds || 1))) / of;
      }
      doing.textContent = progress.hidden ? "" : now.what;
    });
  },
  async shown() {
    try {
      const { runs } = await get("/api/runs");
      this.kept.replaceChildren(...runs.filter(run => run.kind === "experiment").map(run => element("option", { value: run.name, textContent: run.name })));
    } catch (error) { say(error.message); }
  },
};

const command2 = (path, what) => post(path, { page: here.page, ...what });

let chosen, studies, frame, watching = 0, shownStudy = null, sweep;

async function look() {
  clearTimeout(watching);
  const { studies: all } = await get("/api/studies");
  studies.replaceChildren(all.length === 0 ? "" : table(["study", "state", "", ""], all.map(it => {
    const shown = it.stage === "running" ? `${it.doing}${it.share == null ? "" : `, ${(100 * it.share).toFixed(0)} %`}, ${it.seconds.toFixed(0)} s` : it.stage === "failed" ? `failed: ${it.doing}` : `${it.stage} after ${it.seconds.toFixed(0)} s`;
    const bar = it.stage === "running" ? element("progress", { max: 1, ...(it.share == null ? {} : { value: it.share }) }) : null;
    const open = it.has_page && it.stage === "done" ? button("Read", () => show(it.study), { className: "read" }) : null;
    const plan = it.title.startsWith("the runs that decide") && it.stage === "done" ? button("Take the plan", act(() => take(it.study))) : null;
    const end = it.stage === "running" ? button("End it", act(() => post("/api/study/cancel", { study: it.study }).then(look))) : null;
    return element("tr", {}, element("td", { className: "name", textContent: it.title }), element("td", { className: "name", textContent: shown }), element("td", {}, bar), element("td", {}, open, plan, end));
  })));
  const [latest] = all;
  if (latest?.stage === "done" && latest.has_page && shownStudy === "next") show(latest.study);
  if (all.some(it => it.stage === "running")) watching = setTimeout(() => look().catch(error => say(error.message)), 500);
}

function show(study) {
  shownStudy = study;
  const printed = element("pre");
  get("/api/study/text", { study }).then(it => { printed.textContent = it.text; }).catch(error => say(error.message));
  frame.replaceChildren(element("details", {}, element("summary", { textContent: "as the command line prints it" }), printed), element("iframe", { src: `/api/study/page?study=${study}`, title: "the answer", sandbox: "allow-scripts" }));
  frame.scrollIntoView();
}

async function take(study) {
  const { json } = await get("/api/study/text", { study });
  showPlan((json ?? []).map(inSeries));
  location.hash = "#experiment";
}

export const diagnosis = {
  build(place) {
    chosen = element("select", { multiple: true, size: 8, ariaLabel: "runs and folders, diagnosed together" });
    studies = element("div");
    frame = element("div", { id: "answer" });
    const quick = element("input", { type: "checkbox", checked: true });
    const names = () => [...chosen.selectedOptions].map(option => option.value);
    const start = question => act(async () => { shownStudy = "next"; await post("/api/study", question()); await look(); });
    const shunt = number(2000), exercise = choice([["rotation", "rotation"], ["flexion-extension", "flexion and extension"], ["lateral-flexion", "lateral flexion"], ["all", "all"]]);
    sweep = sweeping(shunt, name => this.shown(name));
    const only = () => { if (names().length !== 1) throw new Error("choose one"); return names()[0]; };
    place.append(element("h2", { textContent: "Diagnosis" }),
      element("p", { className: "soft", textContent: "What the simulation gets wrong of the runs chosen, and why. The command line computes it beside the server; the motor's runs go before." }),
      element("div", { className: "row" }, field("runs and folders", chosen),
        element("label", { className: "tick" }, quick, "a first look"),
        button("Diagnose", start(() => ({ kind: "diagnose", runs: names(), quick: quick.checked })), { id: "diagnose", className: "primary" }),
        button("Plan the deciding runs", start(() => ({ kind: "next-runs", runs: names() })), { id: "decide" })),
      element("details", {}, element("summary", { textContent: "Identification and the neck" }),
        element("div", { className: "row" }, field("shunt, \u03a9", shunt), button("Stator's circuit", start(() => ({ kind: "stator", run: only(), shunt_ohm: shunt.valueAsNumber })), { title: "of the sweep chosen above", id: "circuit" }),
          button("Watch it being swept", act(() => sweep.watch(only())), { id: "watch-sweep", title: "of the sweep chosen above, while \u201ctwum instruments sweep\u201d writes it into the folder" }),
          button("Friction", start(() => ({ kind: "friction", run: only() })), { title: "of the folder of trials chosen above" }),
          field("exercise", exercise), button("Neck", start(() => ({ kind: "neck", exercise: exercise.value })), { id: "neck" }))),
      sweep.form, sweep.shown, studies, frame);
  },
  async shown(choose) {
    try {
      const before = choose ? new Set([choose]) : new Set([...chosen.selectedOptions].map(option => option.value)), { runs } = await get("/api/runs");
      chosen.replaceChildren(...runs.map(run => element("option", { value: run.name, textContent: `${run.name} (${run.kind})`, selected: before.has(run.name) })));
      await sweep.fill();
      await look();
    } catch (error) { say(error.message); }
  },
};
