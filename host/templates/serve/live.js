// The live plots: ten minutes of points, drawn once a frame of the screen at most.
import { button, element, field, choice } from "./parts.js";
import { listen } from "./talk.js";

const KEPT_S = 600;
const PANELS = [
  { title: "position and target, °", lines: [["target", 1, "#0072b2"], ["position", 2, "#e69f00"]] },
  { title: "error, °", lines: [["error", point => point[1] == null ? null : point[1] - point[2], "#d55e00"]] },
  { title: "speed, rpm", lines: [["speed", 3, "#009e73"]] },
  { title: "duty, signed", lines: [["duty", 4, "#cc79a7"]], range: [-1, 1] },
];

export function live() {
  let points = [], paused = null, view = { span: 30, end: null }, cursor = null, waiting = false, drag = null;
  const value = (point, which) => typeof which === "function" ? which(point) : point[which];
  const shown = () => paused ?? points;
  const last = () => shown().at(-1)?.[0] ?? 0;
  const range = () => { const end = view.end ?? Math.max(last(), (shown()[0]?.[0] ?? 0) + view.span); return [end - view.span, end]; };

  const canvases = PANELS.map(panel => {
    const canvas = element("canvas", { tabIndex: 0, ariaLabel: `live plot of ${panel.title}` });
    const values = element("span");
    return { panel, canvas, values, node: element("figure", {}, element("figcaption", {}, element("strong", { textContent: panel.title }), values), canvas) };
  });

  function find(time) {
    const all = shown();
    let [low, high] = [0, all.length];
    while (low < high) { const middle = (low + high) >> 1; if (all[middle][0] < time) low = middle + 1; else high = middle; }
    return low;
  }

  function draw() {
    waiting = false;
    const [from, to] = range(), all = shown(), first = Math.max(0, find(from) - 1), end = Math.min(all.length, find(to) + 1);
    const look = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const [inkColour, line, soft] = [look("--ink"), look("--line"), look("--soft")];
    for (const { panel, canvas, values } of canvases) {
      const width = canvas.clientWidth, height = 130, ratio = devicePixelRatio || 1;
      if (!width) continue;
      if (canvas.width !== Math.round(width * ratio)) Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
      canvas.style.height = `${height}px`;
      const ink = canvas.getContext("2d");
      ink.setTransform(ratio, 0, 0, ratio, 0, 0);
      ink.clearRect(0, 0, width, height);
      let [low, high] = panel.range ?? [Infinity, -Infinity];
      if (!panel.range) {
        for (let i = first; i < end; i++) for (const [, which] of panel.lines) {
          const v = value(all[i], which);
          if (v == null) continue;
          if (v < low) low = v;
          if (v > high) high = v;
        }
        if (low > high) [low, high] = [-1, 1];
        const margin = Math.max(0.5, 0.06 * (high - low));
        [low, high] = [low - margin, high + margin];
      }
      const left = 52, across = time => left + (time - from) / (to - from) * (width - left), up = v => height - 18 - (v - low) / (high - low) * (height - 24);
      ink.font = "12px DejaVu Sans, Verdana, sans-serif";
      ink.lineWidth = 1;
      ink.strokeStyle = line;
      ink.fillStyle = soft;
      const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough)), step = [1, 2, 5, 10].map(k => k * power).find(k => k >= rough);
      ink.textAlign = "right";
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
        ink.beginPath(); ink.moveTo(left, up(v)); ink.lineTo(width, up(v)); ink.stroke();
        ink.fillText(String(+v.toPrecision(6)).replace("-", "−"), left - 6, up(v) + 4);
      }
      ink.textAlign = "center";
      const slice = [0.5, 1, 2, 5, 10, 20, 60, 120].find(k => k >= (to - from) / 7) ?? 120;
      for (let t = Math.ceil(from / slice) * slice; t <= to; t += slice) {
        ink.beginPath(); ink.moveTo(across(t), 6); ink.lineTo(across(t), height - 18); ink.stroke();
        if (across(t) > left + 14 && across(t) < width - 16) ink.fillText(`${+t.toFixed(1)} s`, across(t), height - 4);
      }
      ink.save();
      ink.beginPath(); ink.rect(left, 0, width - left, height - 17); ink.clip();
      ink.lineWidth = 1.5;
      for (const [, which, colour] of panel.lines) {
        ink.strokeStyle = colour;
        ink.beginPath();
        let down = false, before = -Infinity;
        for (let i = first; i < end; i++) {
          const v = value(all[i], which), t = all[i][0];
          // Points come ten times a second at least; where they did not, nothing is known.
          if (v == null || t - before > 1) down = false;
          if (v != null) { down ? ink.lineTo(across(t), up(v)) : ink.moveTo(across(t), up(v)); down = true; }
          before = t;
        }
        ink.stroke();
      }
      if (cursor != null) { ink.fillStyle = inkColour; ink.fillRect(across(cursor), 0, 1, height - 18); }
      if (drag) { ink.fillStyle = "#0072b233"; ink.fillRect(across(Math.min(drag.from, drag.to)), 0, Math.abs(across(drag.to) - across(drag.from)), height - 18); }
      ink.restore();
      const at = cursor == null ? all.at(-1) : all[Math.min(all.length - 1, find(cursor))];
      values.textContent = at ? panel.lines.map(([name, which]) => `${name} ${value(at, which)?.toFixed(2).replace("-", "−") ?? "none"}`).join(", ") + (cursor == null ? "" : ` at ${at[0].toFixed(2)} s`) : "";
    }
    const host = canvases[0].canvas.closest(".live");
    host.dataset.points = points.length;
    host.dataset.last = points.at(-1)?.[2] ?? "";
  }
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

  for (const { canvas } of canvases) {
    const time = event => { const box = canvas.getBoundingClientRect(), [from, to] = range(); return from + Math.max(0, event.clientX - box.left - 52) / (box.width - 52) * (to - from); };
    canvas.onpointermove = event => { cursor = time(event); if (drag) drag.to = cursor; redraw(); };
    canvas.onpointerleave = () => { cursor = null; redraw(); };
    canvas.onpointerdown = event => { if (event.pointerType === "mouse") { drag = { from: time(event), to: time(event) }; canvas.setPointerCapture(event.pointerId); } };
    canvas.onpointerup = () => {
      if (drag && Math.abs(drag.to - drag.from) > 0.02 * view.span) {
        pause(true);
        view = { span: Math.abs(drag.to - drag.from), end: Math.max(drag.from, drag.to) };
      }
      drag = null;
      redraw();
    };
    canvas.ondblclick = () => follow();
  }
  const span = choice([["10", "10 s"], ["30", "30 s"], ["120", "2 min"], ["600", "10 min"]], "30");
  span.onchange = () => { view = { span: Number(span.value), end: null }; redraw(); };
  const hold = button("Pause", () => pause(paused == null));
  function pause(yes) { paused = yes ? paused ?? [...points] : null; hold.textContent = yes ? "Go on" : "Pause"; if (!yes) view.end = null; redraw(); }
  function follow() { pause(false); view = { span: Number(span.value), end: null }; redraw(); }
  const moved = (factor, shift) => () => { const [from, to] = range(), middle = (from + to) / 2; view = { span: Math.min(KEPT_S, Math.max(0.2, view.span * factor)), end: null }; view.end = shift || paused ? middle + view.span / 2 + shift * view.span : null; if (shift) pause(true); redraw(); };

  listen((message, first) => {
    if (!message) return;
    if (first) points = [];
    points.push(...message.points);
    const oldest = (points.at(-1)?.[0] ?? 0) - KEPT_S;
    let old = 0;
    while (old < points.length && points[old][0] < oldest) old++;
    if (old > 200) points.splice(0, old);
    if (message.points.length && !paused) redraw();
  });
  const node = element("div", { className: "live" },
    element("div", { className: "row" }, field("shown", span), hold, button("+", moved(0.5, 0), { title: "zoom in" }), button("−", moved(2, 0), { title: "zoom out" }),
      button("◂", moved(1, -0.5), { title: "earlier" }), button("▸", moved(1, 0.5), { title: "later" }), button("now", follow, { title: "follow what comes" })),
    ...canvases.map(it => it.node),
    element("p", { className: "soft", textContent: "Drag over a plot to zoom, double-click to follow again. Ten minutes are kept; a run's recording holds every tick." }));
  for (const { canvas } of canvases) new ResizeObserver(redraw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  return node;
}
