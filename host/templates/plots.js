"use strict";
window.addEventListener("error", event => {
  const p = document.getElementById("broken");
  p.hidden = false;
  p.textContent = "This page failed: " + event.message;
  document.body.dataset.failed = event.message;
});

// Draws figures with uPlot: `plots.draw(host, figure)`, where a figure is what `report::page::plot` makes of one. Every series
// has an x of its own, sorted or not (uPlot's mode 2), so paths, ranges and the nearest sample are found here.
const plots = (() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const look = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const shade = colour => dark.matches
    ? "#" + [1, 3, 5].map(i => Math.round(0.65 * parseInt(colour.slice(i, i + 2), 16) + 89).toString(16).padStart(2, "0")).join("")
    : colour;
  const number = (value, digits = 5) => {
    if (value == null) return "";
    const size = Math.abs(value), plain = !size || (size >= 1e-4 && size < 1e7);
    const text = plain ? String(+value.toPrecision(digits)) : value.toExponential(4).replace(/\.?0+e/, "e");
    return text.replaceAll("-", "\u2212").replace("+", "");
  };
  const element = (tag, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };

  function path(u, series) {
    const { x, y, high, shape } = series, ratio = devicePixelRatio || 1;
    const across = value => u.valToPos(value, "x", true), up = value => u.valToPos(value, "y", true);
    const drawn = new Path2D();
    if (shape === "marks") {
      for (const value of x) {
        drawn.moveTo(across(value), u.bbox.top);
        drawn.lineTo(across(value), u.bbox.top + u.bbox.height);
      }
      return { stroke: drawn };
    }
    if (shape === "points") {
      x.forEach((value, i) => {
        const [a, b] = [across(value), up(y[i])];
        if (y[i] == null || !isFinite(a + b)) return;
        drawn.moveTo(a + 2.5 * ratio, b);
        drawn.arc(a, b, 2.5 * ratio, 0, 7);
      });
      return { fill: drawn };
    }
    if (shape === "band") {
      for (let from = 0; from < x.length; from++) {
        if (y[from] == null) continue;
        let to = from;
        while (to + 1 < x.length && y[to + 1] != null) to++;
        for (let i = from; i <= to; i++) drawn.lineTo(across(x[i]), up(y[i]));
        for (let i = to; i >= from; i--) drawn.lineTo(across(x[i]), up(high[i]));
        drawn.closePath();
        from = to;
      }
      return { fill: drawn };
    }
    let down = false;
    x.forEach((value, i) => {
      const [a, b] = [across(value), up(y[i])];
      if (y[i] == null || !isFinite(a + b)) { down = false; return; }
      down ? drawn.lineTo(a, b) : drawn.moveTo(a, b);
      down = true;
    });
    return { stroke: drawn };
  }

  // The sample under the cursor: at its x where x runs one way, else the one nearest on the screen.
  function nearest(u, { x, y, shape, sorted }) {
    if (shape === "band" || shape === "marks" || !x.length) return null;
    const { left, top } = u.cursor;
    let best = 0;
    if (sorted) {
      const at = u.posToVal(left, "x");
      let high = x.length - 1;
      while (high - best > 1) {
        const middle = (best + high) >> 1;
        if (x[middle] <= at) best = middle; else high = middle;
      }
      if (Math.abs(x[high] - at) < Math.abs(x[best] - at)) best = high;
    } else {
      let least = Infinity;
      x.forEach((value, i) => {
        if (y[i] == null) return;
        const away = Math.hypot(u.valToPos(value, "x") - left, u.valToPos(y[i], "y") - top);
        if (away < least) [least, best] = [away, i];
      });
    }
    return y[best] == null ? null : best;
  }

  // Least and greatest of what is shown.
  function extent(panel, axis, shown) {
    const log = panel[axis + "_log"], fixed = panel[axis + "_range"];
    if (fixed) return fixed;
    let [low, high] = [Infinity, -Infinity];
    const take = value => {
      if (value == null || (log && value <= 0)) return;
      if (value < low) low = value;
      if (value > high) high = value;
    };
    const within = axis === "y" ? panel.view.x ?? panel.x_range : null;
    panel.series.forEach((series, i) => {
      if (!shown(i)) return;
      if (axis === "x") return series.x.forEach((value, k) => { if (series.shape === "marks" || series.y[k] != null) take(value); });
      series.y.forEach((value, k) => {
        if (within && (series.x[k] < within[0] || series.x[k] > within[1])) return;
        take(value);
        if (series.high) take(series.high[k]);
      });
    });
    if (low > high) return log ? [1, 10] : [0, 1];
    if (low === high) return log ? [low / 2, high * 2] : [low - (Math.abs(low) / 2 || 0.5), high + (Math.abs(low) / 2 || 0.5)];
    if (axis === "x" && !panel.series.some(series => series.shape === "points")) return [low, high];
    const margin = log ? (high / low) ** 0.04 : 0.04 * (high - low);
    return log ? [low / margin, high * margin] : [low - margin, high + margin];
  }

  function chart(host, panel, siblings) {
    panel.view = { x: null, y: null };
    for (const series of panel.series) series.sorted = series.x.every((value, i) => !i || value >= series.x[i - 1]);
    let u = null;
    const shown = i => !u || u.series[i + 1].show;
    const range = axis => panel.view[axis] ?? extent(panel, axis, shown);
    const readout = element("output");
    const show = () => u.batch(() => {
      for (const axis of ["x", "y"]) {
        const [min, max] = range(axis);
        u.setScale(axis, { min, max });
      }
    });
    const zoom = (x, y) => {
      const valid = pair => pair && isFinite(pair[0]) && isFinite(pair[1]) && pair[0] < pair[1];
      if ((x && !valid(x)) || (y && !valid(y))) return;
      panel.view.y = y;
      for (const other of siblings) {
        other.view.x = x;
        other.show();
      }
    };
    // Shows what lies between two places of the screen now; beyond the whole there is nothing to see.
    const between = (from, to) => {
      const whole = extent(panel, "x", () => true), x = [u.posToVal(from, "x"), u.posToVal(to, "x")];
      zoom(x[0] <= whole[0] && x[1] >= whole[1] ? null : x, panel.view.y);
    };
    const width = () => u.over.clientWidth;
    const around = (place, factor) => between(place * (1 - factor), place + (width() - place) * factor);
    Object.assign(panel, { show, zoom });

    const button = (label, title, act) => element("button", { type: "button", textContent: label, title, ariaLabel: title, onclick: act });
    host.append(
      element("header", {}, element("strong", { textContent: panel.title }), element("span", {},
        button("+", "zoom in", () => around(width() / 2, 0.5)),
        button("\u2212", "zoom out", () => around(width() / 2, 2)),
        button("\u25c2", "earlier", () => between(-0.4 * width(), 0.6 * width())),
        button("\u25b8", "later", () => between(0.4 * width(), 1.4 * width())),
        button("all", "show all", () => zoom(null, null)))),
    );

    const place = element("div");
    host.append(place, readout);
    // The lower end of a logarithmic axis is a tick of uPlot's, round or not.
    const isRound = value => value != null && Math.abs(value / 10 ** Math.floor(Math.log10(value)) % 1) < 1e-6;
    const decades = (_, ticks) => ticks.map(value => Math.abs(Math.log10(value) % 1) < 1e-9 ? value : null);
    const axis = (label, log) => ({
      label, labelSize: 22, labelFont: "13px DejaVu Sans, Verdana, sans-serif", font: "12px DejaVu Sans, Verdana, sans-serif",
      stroke: () => look("--ink"), grid: { stroke: () => look("--line"), width: 1, ...(log ? { filter: decades } : {}) }, ticks: { stroke: () => look("--line"), width: 1, size: 5 },
      values: (_, ticks) => ticks.map(value => log && !isRound(value) ? "" : number(value, 8)),
    });
    const options = {
      mode: 2, width: place.clientWidth || 600, height: innerWidth < 600 ? 250 : 300, pxAlign: false,
      scales: {
        x: { time: false, distr: panel.x_log ? 3 : 1, range: () => range("x") },
        y: { distr: panel.y_log ? 3 : 1, range: () => range("y") },
      },
      axes: [{ ...axis(panel.x_label, panel.x_log), size: 32, space: 64 }, { ...axis(panel.y_label, panel.y_log), size: (_, values) => 14 + 7.5 * Math.max(4, ...(values ?? []).map(v => v?.length ?? 0)) }],
      series: [null, ...panel.series.map(series => {
        const colour = () => shade(series.colour) + (series.shape === "band" ? "40" : "");
        const filled = series.shape === "band" || series.shape === "points";
        return {
          label: series.label || "series", class: series.label ? "named" : "unnamed", facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }],
          stroke: colour, fill: filled ? colour : undefined, width: filled ? 0 : 1.5, dash: series.shape === "dashed" ? [7, 5] : undefined,
          points: { show: false }, paths: u => path(u, series), value: (_, __, ___, i) => i == null ? "" : number(series.y[i]),
        };
      })],
      legend: { markers: { width: 2, dash: (_, i) => panel.series[i - 1]?.shape === "dashed" ? "dashed" : "solid" } },
      cursor: {
        dataIdx: (u, i) => nearest(u, panel.series[i - 1]),
        drag: { x: true, y: true, uni: 30, dist: 5, setScale: false },
        points: { size: 7 },
        bind: {
          mousedown: (_, __, usual) => event => event.shiftKey || touches.size ? null : usual(event),
          dblclick: () => () => zoom(null, null),
        },
      },
      hooks: {
        setCursor: [u => {
          const inside = u.cursor.left >= 0;
          readout.textContent = inside ? `${panel.x_label}: ${number(u.posToVal(u.cursor.left, "x"))}` : "";
        }],
        setSelect: [u => {
          const { left, top, width: wide, height: tall } = u.select;
          if (!wide || !tall) return;
          const x = wide < u.over.clientWidth ? [u.posToVal(left, "x"), u.posToVal(left + wide, "x")] : panel.view.x;
          const y = tall < u.over.clientHeight ? [u.posToVal(top + tall, "y"), u.posToVal(top, "y")] : panel.view.y;
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          zoom(x, y);
        }],
        draw: [u => {
          if (panel.mark == null) return;
          const at = u.valToPos(panel.mark, "x", true);
          u.ctx.fillStyle = look("--ink");
          u.ctx.fillRect(at, u.bbox.top, devicePixelRatio || 1, u.bbox.height);
        }],
      },
    };
    const touches = new Map();
    u = new uPlot(options, [null, ...panel.series.map(({ x, y }) => [x, y])], place);
    place.querySelectorAll(".u-series th").forEach(th => {
      Object.assign(th, { tabIndex: 0, title: "hide or show", onkeydown: e => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); th.click(); } } });
    });

    // Two fingers zoom, one moves; the mouse moves with Shift, and its wheel zooms with Ctrl: the page still scrolls.
    u.over.addEventListener("pointerdown", event => {
      if (event.pointerType !== "touch" && !event.shiftKey) return;
      touches.set(event.pointerId, event);
      u.over.setPointerCapture(event.pointerId);
    });
    u.over.addEventListener("pointermove", event => {
      const before = touches.get(event.pointerId);
      if (!before) return;
      const left = u.over.getBoundingClientRect().left;
      const other = [...touches.values()].find(touch => touch.pointerId !== event.pointerId);
      touches.set(event.pointerId, event);
      if (other) {
        const factor = Math.abs(before.clientX - other.clientX) / Math.max(1, Math.abs(event.clientX - other.clientX));
        around(other.clientX - left, Math.min(2, Math.max(0.5, factor)));
      } else if (panel.view.x) {
        const moved = event.clientX - before.clientX;
        between(-moved, width() - moved);
      }
    });
    for (const end of ["pointerup", "pointercancel"]) u.over.addEventListener(end, event => touches.delete(event.pointerId));
    u.over.addEventListener("wheel", event => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      around(event.clientX - u.over.getBoundingClientRect().left, Math.exp(0.002 * event.deltaY));
    }, { passive: false });

    const fit = () => { if (place.clientWidth) u.setSize({ width: place.clientWidth, height: u.height }); };
    const watch = new ResizeObserver(fit);
    watch.observe(place);
    return Object.assign(panel, { u, destroy: () => { watch.disconnect(); u.destroy(); } });
  }

  // Draws a figure into a place; its panels are given back. Panels over the same x are zoomed together.
  function draw(host, figure) {
    const grid = element("div", { className: "panels" });
    grid.style.setProperty("--columns", figure.columns);
    host.append(grid);
    const over = panel => JSON.stringify([panel.x_label, panel.x_log, panel.x_range]);
    for (const panel of figure.panels) {
      const cell = element("div", { className: "panel" });
      grid.append(cell);
      chart(cell, panel, figure.panels.filter(other => over(other) === over(panel)));
    }
    return figure.panels;
  }

  // The colours of a legend are fixed when it is made: another theme draws anew.
  // Draws every figure of the page; gives back the panels of each.
  function all() {
    const drawn = [];
    for (const script of document.querySelectorAll("figure script[type='application/json']")) {
      const figure = JSON.parse(script.textContent), host = element("div");
      script.before(host);
      let panels = draw(host, figure);
      drawn.push(panels);
      dark.addEventListener("change", () => {
        panels.forEach(panel => panel.destroy());
        host.replaceChildren();
        panels = draw(host, figure);
      });
    }
    document.body.dataset.plots = document.querySelectorAll(".uplot").length;
    return drawn;
  }
  return { draw, all };
})();
