// Shows a running stage: the last seconds of position, error and force, and what may be set.
"use strict";
(() => {
  const SECONDS = 10;
  const get = (id) => document.getElementById(id);
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const dark = matchMedia("(prefers-color-scheme: dark)");
  // Without a loop of its own the stage has no error.
  const signals = ["position", "error", "force"].filter((name) => get(name));
  // In mm, µm and N; what the position is to be is its sum with the error.
  const data = { t: [], position: [], error: [], force: [] };
  // Units that are larger than those, with what they are of them.
  const LARGER = { error: ["mm", 1e-3] };
  const unit = { position: ["mm", 1], error: ["µm", 1], force: ["N", 1] };
  const SMALL = { ...unit };
  const COLOURS = { light: ["#0072b2", "#5a5a5a"], dark: ["#4aa8e0", "#b9c0c9"] };
  let plots = [];

  // What a screen shows of the curves of a signal.
  const shownData = (name) => {
    const wide = Math.max(200, get("plots").clientWidth);
    const of = (ys) => curves.decimated(data.t, ys, -Infinity, Infinity, wide, (y) => y != null);
    const scaled = data[name].map((v) => (v == null ? null : v * unit[name][1]));
    if (name !== "position" || !signals.includes("error")) return uPlot.join([of(scaled)]);
    const setpoint = scaled.map((v, k) => (data.error[k] == null ? null : v + 1e-3 * data.error[k]));
    return uPlot.join([of(scaled), of(setpoint)]);
  };
  const build = () => {
    plots.forEach((plot) => plot.destroy());
    const parent = get("plots");
    parent.replaceChildren();
    const [own, grey] = dark.matches ? COLOURS.dark : COLOURS.light;
    const curve = { stroke: own, width: 1.5, pxAlign: 0, points: { show: false },
      paths: curves.straight };
    const reference = { ...curve, stroke: grey, width: 1, dash: [5, 4] };
    plots = signals.map((name, index) => {
      const is_followed = name === "position" && signals.includes("error");
      if (is_followed) {
        const title = document.createElement("div");
        title.className = "live-title";
        for (const [words, colour, style] of [["position", own, ""], ["setpoint", grey, "dashed"]]) {
          const line = Object.assign(document.createElement("i"), { className: style });
          line.style.borderColor = colour;
          title.append(line, words);
        }
        parent.append(title);
      }
      const axis = { stroke: ink("--soft"), grid: { stroke: ink("--line"), width: 1 },
        ticks: { stroke: ink("--line") }, font: "12px system-ui, sans-serif" };
      return new uPlot({
        width: parent.clientWidth, height: 190, legend: { show: false }, padding: [8, 14, 0, 0],
        cursor: { show: false },
        scales: { x: { time: false } },
        axes: [{ ...axis, label: index === signals.length - 1 ? "time, s" : "", size: 30, labelSize: 20 },
          { ...axis, label: `${name}, ${unit[name][0]}`, size: 96,
            values: (u, splits) => splits.map((v) => String(Number(v.toPrecision(6)))) }],
        series: is_followed ? [{}, curve, reference] : [{}, curve],
      }, shownData(name), parent);
    });
  };
  build();
  dark.addEventListener("change", build);
  let width = get("plots").clientWidth;
  addEventListener("resize", () => {
    if (get("plots").clientWidth !== width) { width = get("plots").clientWidth; build(); }
  });

  const short = (v) => (v == null ? "\u2013"
    : Number(v.toPrecision(5)).toFixed(3).replace(/^-(0\.0*)$/, "$1"));
  const length = (metres) => (metres >= 1e-3 ? `${(metres * 1e3).toPrecision(3)} mm`
    : `${(metres * 1e6).toPrecision(3)} µm`);
  const socket = new WebSocket(`ws://${location.host}/data`);
  socket.onopen = () => { get("state").textContent = "running"; };
  socket.onclose = () => {
    get("state").textContent = "the stage has ended";
    document.querySelector("main").classList.add("ended");
    document.querySelectorAll(".controls input, .controls button")
      .forEach((control) => { control.disabled = true; });
  };
  let waiting = false;
  let asked = 0;
  const draw = () => {
    waiting = false;
    // Thousands of a small unit are some of the next one.
    let changed = false;
    for (const name of Object.keys(LARGER).filter((name) => get(name))) {
      const largest = data[name].reduce((most, v) => Math.max(most, Math.abs(v ?? 0)), 0);
      const wanted = largest >= 1e3 ? LARGER[name] : SMALL[name];
      changed = changed || wanted !== unit[name];
      unit[name] = wanted;
      get(`${name}-unit`).textContent = wanted[0];
    }
    if (changed) build();
    signals.forEach((name, index) => {
      if (!changed) plots[index].setData(shownData(name));
      const last = data[name][data[name].length - 1];
      get(name).textContent = short(last == null ? null : last * unit[name][1]);
    });
  };
  socket.onmessage = (event) => {
    const told = JSON.parse(event.data);
    if (told.said !== undefined) get("said").textContent = told.said;
    // A bandwidth may be refused; what comes after it in the meantime is not to be undone.
    if (told.bandwidth !== undefined && --asked === 0) {
      get("bandwidth").value = told.bandwidth;
      shown();
    }
    if (told.recording !== undefined) {
      get("record").setAttribute("aria-pressed", String(told.recording));
      get("record").textContent = told.recording ? "stop recording" : "record";
    }
    if (!told.t) return;
    data.t.push(...told.t);
    for (const name of signals) data[name].push(...told[name]);
    const least = data.t[data.t.length - 1] - SECONDS;
    const old = data.t.findIndex((t) => t >= least);
    if (old > 0) {
      data.t.splice(0, old);
      for (const name of signals) data[name].splice(0, old);
    }
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  };

  const send = (what) => { if (socket.readyState === 1) socket.send(JSON.stringify(what)); };
  const size = () => Math.pow(10, Number(get("size").value));
  const shown = () => {
    get("bandwidth-value").textContent = `${get("bandwidth").value} Hz`;
    get("size-value").textContent = length(size());
  };
  shown();
  get("bandwidth").addEventListener("input", shown);
  get("size").addEventListener("input", shown);
  get("bandwidth").addEventListener("change", () => {
    asked += 1;
    send({ bandwidth: Number(get("bandwidth").value) });
  });
  get("forth").addEventListener("click", () => send({ step: size() }));
  get("back").addEventListener("click", () => send({ step: -size() }));
  get("record").addEventListener("click",
    () => send({ record: get("record").getAttribute("aria-pressed") !== "true" }));
})();
