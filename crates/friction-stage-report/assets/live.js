// Shows a running stage: the last seconds of position, error and force, and what may be set.
"use strict";
(() => {
  const SECONDS = 10;
  const get = (id) => document.getElementById(id);
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const dark = matchMedia("(prefers-color-scheme: dark)");
  // Without a loop of its own the stage has no error.
  const signals = ["position", "error", "force"].filter((name) => get(name));
  // In SI units; what the position is to be is its sum with the error.
  const data = { t: [], position: [], error: [], force: [] };
  // What a number of a message is in them.
  const SENT = { position: 1e-3, error: 1e-6, force: 1 };
  const { length: metre, force: newton, position: place, torque } = get("plots").dataset;
  const LENGTHS = [["m", 1e-3], ["µ", 1e-6], ["n", 1e-9]].map(([prefix, size]) =>
    ({ name: prefix + metre, size }));
  if (metre === "rad") LENGTHS.unshift({ name: metre, size: 1 });
  const FORCE = { name: newton, size: 1 };
  const words = { position: place, error: "error", force: torque };
  // The unit of each plot, what is taken from its values, and the unit of each number.
  const plotted = { position: LENGTHS[0], error: LENGTHS[0], force: FORCE };
  const offset = { position: 0, error: 0, force: 0 };
  const told = { position: LENGTHS[0], error: LENGTHS[0], force: FORCE };
  // The unit in which a size is read; the one in use is kept as long as it will do.
  const unitFor = (size, now) => (size >= 0.5 * now.size && size < 2e3 * now.size ? now
    : LENGTHS.find((unit) => size >= unit.size) || LENGTHS[LENGTHS.length - 1]);
  let plots = [];

  // What a screen shows of the curves of a signal.
  const shownData = (name) => {
    const wide = Math.max(200, get("plots").clientWidth);
    const of = (ys) => curves.decimated(data.t, ys, -Infinity, Infinity, wide, (y) => y != null);
    const { size } = plotted[name], less = offset[name];
    const scaled = (v) => (v == null ? null : (v - less) / size);
    if (name !== "position" || !signals.includes("error")) return uPlot.join([of(data[name].map(scaled))]);
    return uPlot.join([of(data.position.map(scaled)), of(setpoint().map(scaled))]);
  };
  const setpoint = () => data.position.map((v, k) => (data.error[k] == null ? null : v + data.error[k]));
  const number = (v) => String(Number(v.toPrecision(9)));
  const label = (name) => {
    const less = offset[name];
    const from = less === 0 ? ""
      : ` ${less < 0 ? "+" : "\u2212"} ${number(Math.abs(less) / LENGTHS[0].size)} ${LENGTHS[0].name}`;
    return `${words[name]}${from}, ${plotted[name].name}`;
  };
  const build = () => {
    plots.forEach((plot) => plot.destroy());
    const parent = get("plots");
    parent.replaceChildren();
    const [own, grey] = [ink("--curve-0"), ink("--curve-4")];
    const curve = { stroke: own, width: 1.5, pxAlign: 0, points: { show: false },
      paths: curves.straight };
    const reference = { ...curve, stroke: grey, width: 1, dash: [5, 4] };
    plots = signals.map((name, index) => {
      const is_followed = name === "position" && signals.includes("error");
      if (is_followed) {
        const title = document.createElement("div");
        title.className = "live-title";
        for (const [name, colour, style] of [[words.position, own, ""], ["setpoint", grey, "dashed"]]) {
          const line = Object.assign(document.createElement("i"), { className: style });
          line.style.borderColor = colour;
          title.append(line, name);
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
          { ...axis, label: label(name), size: 96,
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

  const fixed = (v, decimals) => (v == null ? "\u2013"
    : v.toFixed(decimals).replace(/^-(0\.?0*)$/, "$1"));
  const length = (metres) => {
    const unit = LENGTHS.find((one) => metres >= 0.9999 * one.size) || LENGTHS[LENGTHS.length - 1];
    return `${(metres / unit.size).toPrecision(3)} ${unit.name}`;
  };
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
    let changed = false;
    for (const name of signals) {
      const values = name === "position" && signals.includes("error")
        ? data.position.concat(setpoint()) : data[name];
      let low = Infinity, high = -Infinity;
      for (const v of values) {
        if (v == null) continue;
        low = Math.min(low, v);
        high = Math.max(high, v);
      }
      if (!(low <= high)) continue;
      const [largest, span, middle] = [Math.max(-low, high), high - low, (low + high) / 2];
      let unit = FORCE, less = offset[name];
      if (name !== "force") {
        // A small motion far from zero is seen as what it is more than a round number.
        const is_far = span < 1e-3 * largest;
        const step = Math.pow(10, Math.floor(Math.log10(span > 0 ? span : 1e-9)) + 1);
        if (!is_far) less = 0;
        else if (less === 0 || Math.abs(middle - less) > 10 * step) less = Math.round(middle / step) * step;
        unit = unitFor(is_far ? Math.max(span, Math.abs(middle - less)) : largest, plotted[name]);
        told[name] = unitFor(largest, told[name]);
      }
      changed = changed || unit !== plotted[name] || less !== offset[name];
      [plotted[name], offset[name]] = [unit, less];
      get(`${name}-unit`).textContent = told[name].name;
    }
    if (changed) build();
    signals.forEach((name, index) => {
      if (!changed) plots[index].setData(shownData(name));
      const last = data[name][data[name].length - 1];
      const decimals = offset[name] !== 0 ? 6 : told[name].size <= 1e-9 ? 1 : 3;
      get(name).textContent = fixed(last == null ? null : last / told[name].size, decimals);
      get(name).dataset.value = last == null ? "" : String(last);
    });
  };
  socket.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.said !== undefined) get("said").textContent = message.said;
    // A bandwidth may be refused; what comes after it in the meantime is not to be undone.
    if (message.bandwidth !== undefined && --asked === 0) {
      get("bandwidth").value = message.bandwidth;
      shown();
    }
    if (message.recording !== undefined) {
      get("record").setAttribute("aria-pressed", String(message.recording));
      get("record").textContent = message.recording ? "stop recording" : "record";
    }
    if (!message.t) return;
    data.t.push(...message.t);
    for (const name of signals) {
      data[name].push(...message[name].map((v) => (v == null ? null : v * SENT[name])));
    }
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
