// Shows a running stage: the last seconds of position, error and force, and what may be set.
"use strict";
(() => {
  const SECONDS = 10;
  const get = (id) => document.getElementById(id);
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const all = [["position", "position, mm"], ["error", "error, µm"], ["force", "force, N"]];
  // Without a loop of its own the stage has no error.
  const signals = all.filter(([name]) => get(name));
  const data = { t: [], position: [], error: [], force: [] };
  let plots = [];

  const build = () => {
    plots.forEach((plot) => plot.destroy());
    const parent = get("plots");
    plots = signals.map(([name, label], index) => {
      const axis = { stroke: ink("--soft"), grid: { stroke: ink("--line"), width: 1 },
        ticks: { stroke: ink("--line") }, font: "12px system-ui, sans-serif" };
      return new uPlot({
        width: parent.clientWidth, height: 190, legend: { show: false }, padding: [8, 14, 0, 0],
        cursor: { show: false },
        scales: { x: { time: false } },
        axes: [{ ...axis, label: index === signals.length - 1 ? "time, s" : "", size: 30, labelSize: 20 },
          { ...axis, label, size: 96,
            values: (u, splits) => splits.map((v) => String(Number(v.toPrecision(6)))) }],
        series: [{}, { stroke: dark.matches ? "#4aa8e0" : "#0072b2", width: 1.5,
          pxAlign: 0, points: { show: false } }],
      }, [data.t, data[name]], parent);
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
    signals.forEach(([name], index) => {
      plots[index].setData([data.t, data[name]]);
      get(name).textContent = short(data[name][data[name].length - 1]);
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
    for (const [name] of signals) data[name].push(...told[name]);
    const least = data.t[data.t.length - 1] - SECONDS;
    const old = data.t.findIndex((t) => t >= least);
    if (old > 0) {
      data.t.splice(0, old);
      for (const [name] of signals) data[name].splice(0, old);
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
