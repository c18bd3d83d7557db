// The Bench page: the board's state, runs, live plots.
import { act, button, choice, element, field, number, say } from "./parts.js";
import { command, get, here, holds, listen } from "./talk.js";
import { live } from "./live.js";

const FIELDS = {
  speed: () => ({ duty: number(0.5, 0.01, { min: 0, max: 1 }), direction: choice([["cw", "cw"], ["ccw", "ccw"]]), seconds: number(5, 0.1) }),
  sine: () => ({ amplitude_deg: number(80.1), omega_rad_s: number(1.257), seconds: number(20, 0.1) }),
  step: () => ({ angle_deg: number(90), seconds: number(5, 0.1) }),
  ramp: () => ({ speed_deg_s: number(90), limit_deg: number(360), seconds: number(6, 0.1) }),
  path: () => ({ seconds: number(10, 0.1) }),
};
const NAMES = {
  duty: "duty, 0 to 1", direction: "direction", seconds: "length, s", amplitude_deg: "amplitude, °", omega_rad_s: "angular frequency, rad/s",
  angle_deg: "height, °", speed_deg_s: "speed, °/s", limit_deg: "up to, °",
};

// Way points drawn by hand: a click adds one, a drag moves it, the list below takes the keyboard.
function drawnPath() {
  const points = [[90, 3], [90, 2], [0, 3]];
  const canvas = element("canvas", { className: "drawn", tabIndex: 0, ariaLabel: "way points: click to add one, drag to move it" });
  const list = element("textarea", { ariaLabel: "way points, one a line: angle in degrees, seconds to get there", spellcheck: false });
  const span = () => Math.max(10, points.reduce((sum, point) => sum + point[1], 0) * 1.2);
  const reach = () => Math.max(100, ...points.map(point => Math.abs(point[0]) * 1.2));
  let dragged = null;
  const place = (seconds, degrees) => [seconds / span() * canvas.clientWidth, canvas.clientHeight * (0.5 - degrees / (2 * reach()))];
  function times() {
    let at = 0;
    return points.map(point => at += point[1]);
  }
  function draw() {
    const ratio = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return;
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    const ink = canvas.getContext("2d"), look = name => getComputedStyle(document.documentElement).getPropertyValue(name);
    ink.scale(ratio, ratio);
    ink.strokeStyle = look("--line");
    ink.fillStyle = look("--soft");
    ink.font = "12px DejaVu Sans, Verdana, sans-serif";
    for (const degrees of [-reach() / 1.25, 0, reach() / 1.25]) {
      const y = place(0, degrees)[1];
      ink.beginPath(); ink.moveTo(0, y); ink.lineTo(width, y); ink.stroke();
      ink.fillText(`${degrees.toFixed(0)}°`, 4, y - 4);
    }
    ink.fillText(`${span().toFixed(0)} s`, width - 40, height - 6);
    ink.strokeStyle = ink.fillStyle = look("--accent");
    ink.lineWidth = 2;
    ink.beginPath();
    let [from, start] = [0, 0];
    times().forEach((end, i) => {
      // The quintic with rest at both ends, as the board moves.
      for (let k = 0; k <= 40; k++) {
        const s = k / 40, share = s * s * s * (10 + s * (6 * s - 15));
        const [x, y] = place(start + s * (end - start), from + share * (points[i][0] - from));
        i || k ? ink.lineTo(x, y) : ink.moveTo(x, y);
      }
      [from, start] = [points[i][0], end];
    });
    ink.stroke();
    times().forEach((at, i) => { const [x, y] = place(at, points[i][0]); ink.beginPath(); ink.arc(x, y, 6, 0, 7); ink.fill(); });
  }
  const write = () => { list.value = points.map(([degrees, seconds]) => `${degrees} ${seconds}`).join("\n"); };
  const where = event => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width * span(), (0.5 - (event.clientY - box.top) / box.height) * 2 * reach()];
  };
  function move(i, seconds, degrees) {
    const before = i ? times()[i - 1] : 0, after = times()[i];
    const at = Math.max(before + 0.1, seconds);
    if (points[i + 1]) points[i + 1][1] = Math.max(0.1, +(points[i + 1][1] + after - at).toFixed(2));
    points[i] = [Math.round(degrees), +(at - before).toFixed(2)];
  }
  canvas.onpointerdown = event => {
    const [seconds, degrees] = where(event), near = times().findIndex((at, i) => {
      const [x, y] = place(at, points[i][0]), [a, b] = place(seconds, degrees);
      return Math.hypot(x - a, y - b) < 14;
    });
    dragged = near;
    if (near < 0 && points.length < 16) {
      dragged = times().filter(at => at < seconds).length;
      const before = dragged ? times()[dragged - 1] : 0;
      points.splice(dragged, 0, [Math.round(degrees), +Math.max(0.1, seconds - before).toFixed(2)]);
      if (points[dragged + 1]) points[dragged + 1][1] = Math.max(0.1, +(points[dragged + 1][1] - points[dragged][1]).toFixed(2));
    }
    canvas.setPointerCapture(event.pointerId);
    write(); draw();
  };
  canvas.onpointermove = event => { if (dragged != null && dragged >= 0) { move(dragged, ...where(event)); write(); draw(); } };
  canvas.onpointerup = () => { dragged = null; };
  canvas.ondblclick = event => {
    const [seconds, degrees] = where(event);
    const near = times().findIndex((at, i) => { const [x, y] = place(at, points[i][0]), [a, b] = place(seconds, degrees); return Math.hypot(x - a, y - b) < 14; });
    if (near >= 0 && points.length > 1) points.splice(near, 1);
    write(); draw();
  };
  list.oninput = () => {
    const read = list.value.trim().split("\n").map(line => line.trim().split(/[\s,:]+/).map(Number));
    if (read.every(point => point.length === 2 && point.every(isFinite))) { points.splice(0, points.length, ...read); draw(); list.classList.remove("wrong"); }
    else list.classList.add("wrong");
  };
  write();
  new ResizeObserver(draw).observe(canvas);
  return {
    node: element("div", {}, canvas, element("p", { className: "soft", textContent: "Click to add a way point, drag to move one, double-click to take one away; or write angle (°) and seconds, a line each. At most 16." }), list),
    points: () => {
      if (list.classList.contains("wrong")) throw new Error("way points: write an angle in degrees and seconds, a line each");
      return points;
    },
  };
}

function runForm() {
  const kind = choice([["sine", "sine"], ["step", "step"], ["ramp", "ramp"], ["path", "way points"], ["speed", "constant duty (open loop)"]], "sine");
  const place = element("span", { className: "row" }), path = drawnPath();
  let fields = {};
  const show = () => {
    fields = FIELDS[kind.value]();
    place.replaceChildren(...Object.entries(fields).map(([key, input]) => field(NAMES[key], input)));
    path.node.hidden = kind.value !== "path";
  };
  kind.onchange = show;
  show();
  const run = button("Run", act(async () => {
    const what = { kind: kind.value };
    for (const [key, input] of Object.entries(fields)) what[key] = input.type === "number" ? input.valueAsNumber : input.value;
    if (what.kind === "path") what.points = path.points();
    const taken = await command("/api/run", what);
    say(`recording ${taken.recording}`, false);
  }), { id: "run", className: "primary" });
  const align = button("Align", act(() => command("/api/align")), { id: "align", title: "Find the beginning of an encoder pulse: the motor turns" });
  const arm = button("Arm", act(() => command("/api/arm")), { id: "arm", title: "Allow runs; a run arms by itself" });
  const clear = button("Clear the fault", act(() => command("/api/clear")), { id: "clear" });
  const needed = element("p", { className: "soft", textContent: "To move the motor, take it first: one page holds it, the others watch. Anybody may stop it." });
  listen(() => {
    const now = here.now, busy = Boolean(now?.doing), ready = holds() && now?.connected && !busy;
    const off = (what, isOff) => { what.dataset.off = isOff; what.disabled = isOff; };
    off(run, !ready || Boolean(now?.fault));
    off(align, !ready || Boolean(now?.fault));
    off(arm, !ready || now?.mode !== "Idle");
    off(clear, !ready || !now?.fault);
    needed.hidden = holds();
  });
  return element("div", {}, needed, element("div", { className: "row" }, align, arm, clear),
    element("div", { className: "row" }, field("run", kind), place, run), path.node);
}

function facts() {
  const list = element("dl", { className: "facts" }), fault = element("p", { id: "fault", className: "callout", hidden: true });
  let shown = "", version = null, force = "";
  // What a run begun now would use; every key is on the Settings page.
  async function configuration() {
    const { configured, rows } = await get("/api/configuration"), of = key => rows.find(row => row.key === key);
    const gains = ["kp", "ki_tick", "kd_tick", "feed_forward"].map(name => `${name} ${of(`control.${name}`).value}`).join(", ");
    force = `${gains}; ${of("control.law").value}, ${of("control.period_us").value} µs, PWM ${of("pwm_hz").value} Hz${configured ? "" : "; the default, the board has been given none"}`;
  }
  listen(() => {
    const now = here.now;
    if (!here.open || !now) return;
    if (now.connected && now.configuration_version !== version) {
      version = now.configuration_version;
      configuration().catch(error => say(error.message));
    }
    const rows = [
      ["port", now.port], ["board", `${now.chip ?? "unknown"}, firmware ${now.firmware ?? "unknown"}, last start: ${now.reset ?? "unknown"}`],
      ["in force", force],
      ["position", `${now.position_deg.toFixed(1).replace("-", "−")}°`],
      ["ticks", `${now.late_ticks} late, latest by ${now.worst_late_us} µs, longest ${now.worst_duration_us} µs; ${now.lost_items} items lost on the board`],
    ];
    const text = JSON.stringify([rows, now.fault]);
    if (text === shown) return;
    shown = text;
    list.replaceChildren(...rows.flatMap(([name, value]) => [element("dt", { textContent: name }), element("dd", { textContent: value, id: name === "in force" ? "force" : "" })]));
    fault.hidden = !now.fault;
    fault.textContent = now.fault ? `${now.fault.name}: ${now.fault.words}. ${now.fault.what_to_do}` : "";
  });
  return element("div", {}, fault, list);
}

function lines() {
  const shown = element("pre", { id: "lines", tabIndex: 0, ariaLabel: "what happened" });
  listen((message, first) => {
    if (!message || (!first && !message.lines.length)) return;
    if (first) shown.textContent = "";
    const kept = (shown.textContent + message.lines.map(line => `${line}\n`).join("")).split("\n").slice(-201);
    shown.textContent = kept.join("\n");
    shown.scrollTop = shown.scrollHeight;
  });
  return shown;
}

export const bench = {
  build(host) {
    host.append(facts(), element("h2", { textContent: "Run" }), runForm(), element("h2", { textContent: "Live" }), live(), element("h2", { textContent: "What happened" }), lines());
  },
};
