// Draws the charts of a page with uPlot: zoom, cursor with values, curves that can be switched
// off, by mouse and by keyboard. The drawing that stands in the page is kept for print.
"use strict";
(() => {
  const COLOURS = 8;
  const COLUMN_PIXELS = 1;
  // What a logarithmic ordinate shows below its highest point, as the drawings.
  const LEAST = 1e-12;
  // By how much a line is wider than each line that lies on it, px; at how many columns, and within
  // which part of the height, it does.
  const WIDER = 2, COMPARED = 100, NEAR = 0.006;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const colour = (index) => ink(`--curve-${index % COLOURS}`);

  const bytes = (text) => {
    const raw = atob(text);
    const out = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; k++) out[k] = raw.charCodeAt(k);
    return out.buffer;
  };
  // Every column is read when a chart needs it, and once.
  const packed = JSON.parse(document.getElementById("columns").textContent);
  const read = [];
  const column = (index) => {
    if (read[index]) return read[index];
    const c = packed[index];
    let out;
    if ("f64" in c) {
      out = new Float64Array(bytes(c.f64));
    } else {
      out = new Float64Array(c.n);
      if ("i32" in c) {
        const counts = new Int32Array(bytes(c.i32));
        for (let k = 0; k < c.n; k++) {
          out[k] = counts[k] === -2147483648 ? NaN : c.low + c.step * counts[k];
        }
      } else {
        for (let k = 0; k < c.n; k++) out[k] = c.start + c.step * k;
      }
    }
    packed[index] = null;
    return (read[index] = out);
  };

  const nearest = (xs, x) => {
    const at = curves.place(xs, x);
    if (at === 0) return 0;
    if (at === xs.length) return at - 1;
    return x - xs[at - 1] < xs[at] - x ? at - 1 : at;
  };

  // Digits with which values of this size are told apart at steps of that size: six, or more.
  const digitsFor = (size, step) => (size > 0 && step > 0
    ? Math.min(15, Math.max(6, Math.ceil(Math.log10(size / step)) + 1)) : 6);
  // A value as the cursor reads it, of an axis that shows this much.
  const short = (value, shown) => {
    if (value === 0) return "0";
    const size = Math.abs(value);
    const digits = digitsFor(size, 1e-3 * shown);
    if (size >= 1e-3 && size < 1e6) return String(Number(value.toPrecision(digits)));
    return value.toExponential(Math.max(4, digits - 2));
  };
  const axisNumber = (value, digits = 6) => {
    const text = String(+value.toPrecision(digits));
    return /^-?\d{6,}$/.test(text) || /^-?0\.0{3,}/.test(text) || /e/.test(text)
      ? Number(text).toExponential().replace("e+", "e") : text;
  };
  // Round numbers with even steps.
  const evenMarks = (low, high, room) => {
    const marks = [];
    const rough = (high - low) / Math.max(2, room / 2), power = Math.floor(Math.log10(rough));
    const factor = [1, 2, 5, 10].find((one) => one * Number(`1e${power}`) >= rough) || 10;
    const step = factor * Number(`1e${power}`);
    if (!(step > 0) || !Number.isFinite(step)) return marks;
    for (let k = Math.ceil(low / step); k * step <= high; k++) {
      marks.push({ at: Number((k * step).toPrecision(12)), named: true });
    }
    return marks;
  };
  // Marks of an axis that is even near zero and logarithmic beyond: zero and whole powers on both
  // sides, with 2 and 5 of each where these have room; even steps where few of them are seen. From
  // the largest down to zero each is left out that is too near to one that is there.
  const asinhMarks = (low, high, even, room) => {
    const largest = Math.max(Math.abs(low), Math.abs(high));
    if (largest < 5 * even) return evenMarks(low, high, room);
    const place = (v) => Math.asinh(v / even), apart = (place(high) - place(low)) / room;
    const every = Math.max(1, Math.ceil(apart / Math.LN10));
    const first = Math.floor(Math.log10(even)) - 1, last = Math.floor(Math.log10(largest));
    const marksOf = (factors) => {
      const sizes = [];
      for (let power = last; power >= first; power--) {
        if (power % every !== 0) continue;
        for (const factor of factors) {
          const size = Number(`${factor}e${power}`), larger = sizes[sizes.length - 1];
          if (size > largest || place(size) < apart) continue;
          if (larger === undefined || place(larger) - place(size) >= apart) sizes.push(size);
        }
      }
      const all = [...sizes.map((at) => -at), 0, ...sizes.reverse()];
      return all.filter((at) => at >= low && at <= high).map((at) => ({ at, named: true }));
    };
    // Two neighbours of 1, 2 and 5 are as far from each other as 2 from 1.
    const whole = marksOf([1]);
    const marks = apart <= Math.LN2 || whole.length < 5 ? marksOf([5, 2, 1]) : whole;
    // Of a view away from zero there are few.
    return marks.length >= 3 ? marks : evenMarks(low, high, room);
  };
  // Where a value is along an axis, and back.
  const spread = (axis) => {
    if (axis.even) return { to: (v) => Math.asinh(v / axis.even), from: (p) => axis.even * Math.sinh(p) };
    if (axis.log) return { to: Math.log, from: Math.exp };
    return { to: (v) => v, from: (p) => p };
  };
  // Marks of a logarithmic axis with room for so many numbers, and which of them have one: whole
  // powers; between them, on few decades, 2 to 9; on less than a decade, even steps. uPlot itself
  // counts up from the lower end, which on many decades never arrives.
  const logMarks = (low, high, room) => {
    const decades = Math.log10(high / low);
    if (!(decades > 0) || !Number.isFinite(decades)) return [];
    const marks = [];
    if (decades < 0.9) return evenMarks(low, high, room);
    const every = Math.max(1, Math.ceil(decades / room));
    const named = 3 * decades < room ? [1, 2, 5] : [1];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
      if (power % every !== 0) continue;
      for (const factor of decades < 5 ? [1, 2, 3, 4, 5, 6, 7, 8, 9] : [1]) {
        const at = Number(`${factor}e${power}`);
        if (at >= low && at <= high) marks.push({ at, named: named.includes(factor) });
      }
    }
    return marks;
  };
  // Numbers along the abscissa without those that would lie on another one: zero stays, then whole
  // powers, and of these the largest.
  const apart = (u, splits, texts) => {
    u.ctx.save();
    u.ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    const half = texts.map((text) => u.ctx.measureText(text).width / devicePixelRatio / 2 + 3);
    u.ctx.restore();
    const rank = (v) => {
      const power = Math.log10(Math.abs(v));
      return v === 0 ? 0 : Math.abs(power - Math.round(power)) < 1e-9 ? 1 : 2;
    };
    const order = splits.map((v, k) => k).filter((k) => texts[k] !== "").sort((a, b) =>
      rank(splits[a]) - rank(splits[b]) || Math.abs(splits[b]) - Math.abs(splits[a]));
    const at = splits.map((v) => u.valToPos(v, "x"));
    const kept = [];
    for (const k of order) {
      if (kept.every((o) => Math.abs(at[k] - at[o]) > half[k] + half[o])) kept.push(k);
    }
    return texts.map((text, k) => (kept.includes(k) ? text : ""));
  };
  // Whether a straight line goes through a rectangle: left, top, right, bottom.
  const crosses = ([x0, y0], [x1, y1], [left, top, right, bottom]) => {
    let from = 0, to = 1;
    for (const [at, by, low, high] of [[x0, x1 - x0, left, right], [y0, y1 - y0, top, bottom]]) {
      if (by === 0) {
        if (at < low || at > high) return false;
        continue;
      }
      const a = (low - at) / by, b = (high - at) / by;
      from = Math.max(from, Math.min(a, b));
      to = Math.min(to, Math.max(a, b));
    }
    return from <= to;
  };
  // Takes the first of some places for a word that is free, or the one that the fewest curves cross;
  // none where all of them lie on words or leave the frame. As `room.rs` for the drawings.
  const take = (places, frame, drawn, taken) => {
    let best = null, least = Infinity;
    for (const place of places) {
      const [left, top, right, bottom] = place;
      if (left < frame[0] || top < frame[1] || right > frame[2] || bottom > frame[3]) continue;
      if (taken.some((o) => left < o[2] && o[0] < right && top < o[3] && o[1] < bottom)) continue;
      let count = 0;
      for (const points of drawn) {
        for (let k = 1; k < points.length && count < least; k++) {
          if (points[k - 1] && points[k] && crosses(points[k - 1], points[k], place)) count++;
        }
      }
      if (count < least) { best = place; least = count; }
      if (count === 0) break;
    }
    if (best) taken.push(best);
    return best;
  };
  const element = (parent, tag, properties) => {
    const made = Object.assign(document.createElement(tag), properties);
    parent.append(made);
    return made;
  };

  // A line along the abscissa, which has its name where it is drawn.
  const level = (band) => band.axis === "y" && band.low === band.high;

  const charts = [];

  class Plot {
    constructor(figure, chart) {
      this.figure = figure;
      this.chart = chart;
      this.curves = chart.series.map((s) => ({ ...s, x: column(s.x), y: column(s.y), on: true }));
      const xlog = chart.x.log;
      let low = Infinity, high = -Infinity;
      // From the first point to the last that are seen: what has no value takes no room.
      const seen = ({ x, y }, k) => this.has(y[k]) && (!xlog || x[k] > 0);
      for (const curve of this.curves) {
        let first = 0, last = curve.x.length - 1;
        while (first <= last && !seen(curve, first)) first++;
        while (last >= first && !seen(curve, last)) last--;
        if (first > last) continue;
        low = Math.min(low, curve.x[first]);
        high = Math.max(high, curve.x[last]);
      }
      // Nothing is at zero on a logarithmic axis.
      chart.bands = chart.bands.filter((band) => !(chart[band.axis].log && band.high <= 0));
      for (const band of chart.bands) {
        if (band.axis === "x" && band.low === band.high) {
          low = Math.min(low, band.low);
          high = Math.max(high, band.high);
        }
      }
      if (chart.x.names.length > 0) { low = 0.5; high = chart.x.names.length + 0.5; }
      if (!(low < high)) { low = xlog ? low / 2 : low - 1; high = xlog ? high * 2 : high + 1; }
      const { to, from } = spread(chart.x), ends = [to(low), to(high)];
      const pad = 0.02 * (ends[1] - ends[0]);
      this.whole = [from(ends[0] - pad), from(ends[1] + pad)];
      this.shown = [...this.whole];
      const unit = (label) => (label.split(", ")[1] || "").trim();
      this.unit = unit(chart.x.label);
      this.unitOfCurves = unit(chart.y.label);

      figure.setAttribute("role", "group");
      const box = document.createElement("div");
      box.className = "plot";
      figure.insertBefore(box, figure.firstChild);
      element(box, "div", { className: "plot-title", textContent: chart.title });
      const bar = element(box, "div", { className: "plot-bar" });
      this.legend(element(bar, "div", { className: "plot-legend" }));
      this.buttons(element(bar, "div", { className: "plot-buttons" }));
      this.stage = element(box, "div", { className: "plot-stage", tabIndex: 0 });
      this.stage.setAttribute("role", "application");
      this.stage.setAttribute("aria-label", chart.title
        + ": left and right move the cursor, plus and minus zoom, page up and page down move the"
        + " view, 0 shows everything");
      this.said = element(box, "div", { className: "plot-said" });
      this.said.setAttribute("aria-live", "polite");
      this.stage.addEventListener("keydown", (event) => this.key(event));
      figure.classList.add("live");
      this.build();
      this.width = this.stage.clientWidth;
      new ResizeObserver(() => {
        if (this.stage.clientWidth !== this.width && this.stage.clientWidth > 0) {
          this.width = this.stage.clientWidth;
          this.build();
        }
      }).observe(this.stage);
    }

    legend(parent) {
      const named = new Map();
      this.curves.forEach((curve, index) => {
        // One without points stands for all dashed curves without a name.
        if (curve.x.length === 0 && curve.dashed && curve.name !== "") {
          const dashed = this.curves.map((other, k) => k)
            .filter((k) => this.curves[k].name === "" && this.curves[k].dashed);
          this.button(parent, curve, [index, ...dashed]);
          return;
        }
        // A curve without a name is toggled with the one of its colour.
        const partner = curve.name === ""
          ? this.curves.find((other) => other.name !== "" && other.colour === curve.colour) : null;
        if (partner && named.has(partner)) { named.get(partner).push(index); return; }
        const group = [index];
        named.set(curve, group);
        this.button(parent, curve, group);
      });
      this.chart.bands.forEach((band) => {
        if (band.name === "" || level(band)) return;
        const key = element(parent, "span", { className: "plot-band" });
        band.swatch = element(key, "i", { className: band.low === band.high ? "dotted" : "" });
        element(key, "span", { textContent: band.name });
      });
      // At the end: it comes and goes with the cursor, and moves nothing.
      this.at = element(parent, "span", { className: "plot-at", textContent: "" });
    }

    // Switches a curve, and what belongs to it, off and on.
    button(parent, curve, group) {
      const button = element(parent, "button", { type: "button", className: "plot-curve" });
      button.setAttribute("aria-pressed", "true");
      curve.swatch = element(button, "i", {});
      if (curve.dashed) curve.swatch.className = "dashed";
      if (!curve.line) curve.swatch.className = curve.open ? "ring" : "mark";
      element(button, "span", { textContent: curve.name });
      curve.out = element(button, "output", { className: "plot-value" });
      button.addEventListener("click", () => {
        const on = !curve.on;
        for (const one of group) {
          this.curves[one].on = on;
          this.u.setSeries(one + 1, { show: on });
        }
        button.setAttribute("aria-pressed", String(on));
        this.u.redraw(true);
      });
    }

    buttons(parent) {
      const add = (text, label, act) => {
        const button = element(parent, "button", { type: "button", textContent: text, title: label });
        button.setAttribute("aria-label", label);
        button.addEventListener("click", act);
      };
      add("+", "zoom in", () => this.zoom(0.5));
      add("\u2212", "zoom out", () => this.zoom(2));
      add("\u25c0", "move the view left", () => this.move(-0.5));
      add("\u25b6", "move the view right", () => this.move(0.5));
      add("all", "show everything", () => this.show(...this.whole, true));
    }

    build() {
      const chart = this.chart;
      if (this.u) this.u.destroy();
      const soft = ink("--soft"), line = ink("--line");
      const axis = { stroke: soft, grid: { stroke: line, width: 1 }, ticks: { stroke: line },
        font: "12px system-ui, sans-serif", labelFont: "13px system-ui, sans-serif" };
      const log = (scale) => (scale.even ? { distr: 4, asinh: scale.even }
        : scale.log ? { distr: 3, log: 10 } : {});
      const marksOf = (u, name, low, high) => (chart[name].even
        ? asinhMarks(low, high, chart[name].even, room(u, name)) : logMarks(low, high, room(u, name)));
      const power = (v, digits = 6) => Number(v.toPrecision(digits)).toExponential().replace("e+", "e");
      // One notation on an axis.
      const logAxis = (name) => ({
        splits: (u, index, low, high) => marksOf(u, name, low, high).map((m) => m.at),
        filter: (u, splits) => splits,
        values: (u, splits) => {
          const { min, max } = u.scales[name];
          const named = new Set(marksOf(u, name, min, max).filter((m) => m.named).map((m) => m.at));
          let texts = splits.map((v) => (named.has(v) ? axisNumber(v) : ""));
          if (/e/.test(texts.join(""))) {
            texts = texts.map((text, k) => (["", "0", "1"].includes(text) ? text : power(splits[k])));
          }
          return name === "x" ? apart(u, splits, texts) : texts;
        },
      });
      const room = (u, name) => (name === "x" ? u.width / 60 : u.height / 30);
      // One notation on an axis.
      const numbers = {
        values: (u, splits) => {
          const known = splits.filter((v) => v != null);
          const size = Math.max(0, ...known.map(Math.abs));
          const digits = digitsFor(size, known.length > 1 ? Math.abs(known[1] - known[0]) : 0);
          const texts = splits.map((v) => (v == null ? "" : axisNumber(v, digits)));
          const larger = (a, v, k) => (Math.abs(v) > Math.abs(splits[a]) ? k : a);
          const largest = texts[splits.reduce(larger, 0)];
          if (!/e/.test(texts.join(""))) return texts;
          return splits.map((v, k) => (v == null || v === 0 ? texts[k]
            : /e/.test(largest) ? power(v, digits)
              : String(+v.toFixed(12))));
        },
      };
      // Room for the longest number and the title next to it.
      const longest = (values) => Math.max(4, ...(values || []).map((v) => String(v).length));
      const width = (u, values) => 22 + 7 * longest(values);
      const names = chart.x.names;
      const named = {
        splits: () => names.map((name, k) => k + 1),
        values: (u, splits) => splits.map((v) => names[v - 1]),
      };
      const marks = (name, scale) => (scale.names.length > 0 ? named : scale.log || scale.even ? logAxis(name) : numbers);
      const options = {
        width: Math.max(this.stage.clientWidth, 120), height: 340,
        legend: { show: false }, padding: [10, 20, 0, 0],
        scales: {
          x: { time: false, ...log(chart.x), range: () => this.shown },
          y: { ...log(chart.y), range: (u, low, high) => this.height(low, high) },
        },
        axes: [
          { ...axis, label: chart.x.label, ...marks("x", chart.x), space: 60,
            size: 34, labelSize: 22 },
          { ...axis, label: chart.y.label, ...marks("y", chart.y), size: width },
        ],
        series: [{}, ...this.curves.map((curve) => ({
          label: curve.name, show: curve.on, stroke: colour(curve.colour), spanGaps: false,
          // Points are not moved to whole pixels, as those of the axes are.
          pxAlign: 0, width: this.lineWidth(curve),
          dash: curve.dashed ? [5, 4] : undefined,
          paths: curve.line ? curves.straight : () => null,
          points: { show: curve.marks > 0, size: curve.marks, width: curve.open ? 2 : 1,
            fill: curve.open ? "transparent" : colour(curve.colour) },
        }))],
        cursor: { drag: { x: true, y: false, setScale: false }, points: { show: false },
          bind: { dblclick: () => () => { this.show(...this.whole, true); } } },
        hooks: {
          drawClear: [() => this.widen()],
          drawAxes: [(u) => this.drawBands(u)],
          draw: [(u) => this.drawEdges(u), (u) => this.drawLabels(u)],
          setCursor: [(u) => this.tell(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null)],
          setSelect: [(u) => {
            const { left, width } = u.select;
            if (width < 3) return;
            const range = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            this.show(...range, true);
          }],
        },
      };
      this.u = new uPlot(options, this.data(), this.stage);
      for (const curve of this.curves) {
        if (curve.swatch) curve.swatch.style.borderColor = colour(curve.colour);
      }
      for (const band of chart.bands) {
        if (band.swatch) band.swatch.style.borderColor = colour(band.colour);
      }
    }

    data() {
      const columns = Math.max(200, this.stage.clientWidth) / COLUMN_PIXELS;
      this.drawn = this.curves.map((curve) =>
        curves.decimated(curve.x, curve.y, ...this.shown, columns, (y) => this.has(y)));
      return uPlot.join(this.drawn);
    }

    lineWidth(curve) {
      return (curve.dashed ? 1 : 1.6) + (curve.wider || 0);
    }

    // Which curves lie on which in what is seen: those below are drawn wider, and the caption says
    // so. As `chart.rs` for the drawings.
    widen() {
      const lower = this.curves.map(() => 0), told = [];
      // No line break parts a number from its unit.
      const quoted = (name) => `\u201c${name.replace(/(\d) /g, "$1\u00a0")}\u201d`;
      this.curves.forEach((upper, k) => {
        const below = this.curves.slice(0, k).filter((one, j) => this.liesOn(k, j) && this.liesOn(j, k));
        below.forEach((one) => { lower[this.curves.indexOf(one)] += 1; });
        const names = below.map((one) => one.name).filter((name) => name !== "")
          .map(quoted);
        if (names.length > 0 && upper.name !== "") {
          told.push(`${quoted(upper.name)} lies on ${names.join(" and on ")}`);
        }
      });
      this.curves.forEach((curve, k) => {
        curve.wider = WIDER * lower[k];
        const series = this.u.series[k + 1];
        series.width = this.lineWidth(curve);
        series.points.size = curve.marks + curve.wider;
        if (curve.swatch && curve.line && !curve.dashed) {
          curve.swatch.style.borderTopWidth = `${3 + curve.wider}px`;
        }
      });
      this.overlaps = told.length > 0
        ? ` Here ${told.join("; ")}; what lies below is drawn wider.` : "";
      const caption = this.figure.querySelector(".overlaps");
      if (caption && caption.textContent !== this.overlaps) caption.textContent = this.overlaps;
    }

    // Whether most of the length of a curve is where another one is.
    liesOn(k, j) {
      const [one, other] = [this.curves[k], this.curves[j]];
      if (!one.on || !other.on || one.dashed !== other.dashed || one.line !== other.line) return false;
      if (one.open || other.open || one.colour === other.colour) return false;
      const part = (name, v) => {
        const { to } = spread(this.chart[name]), { min, max } = this.u.scales[name];
        return (to(v) - to(min)) / (to(max) - to(min));
      };
      const [xs, ys] = this.drawn[j];
      const height = (x) => {
        const after = curves.place(xs, x);
        if (after === xs.length || (after === 0 && xs[0] !== x)) return null;
        const before = Math.max(after - 1, 0);
        if (ys[before] === null || ys[after] === null) return null;
        const share = xs[after] > xs[before] ? (x - xs[before]) / (xs[after] - xs[before]) : 0;
        return ys[before] + share * (ys[after] - ys[before]);
      };
      const [px, py] = curves.decimated(...this.drawn[k], ...this.shown, COMPARED, (y) => y !== null);
      const points = px.map((x, i) => [x, py[i]])
        .filter(([x, y]) => y !== null && x >= this.shown[0] && x <= this.shown[1])
        .map(([x, y]) => {
          const there = height(x), at = part("y", y);
          return [part("x", x), at, there !== null && Math.abs(part("y", there) - at) <= NEAR];
        });
      let near = 0, length = 0;
      for (let i = 1; i < points.length; i++) {
        const [a, b] = [points[i - 1], points[i]];
        const piece = Math.hypot(b[0] - a[0], b[1] - a[1]);
        length += piece;
        if (a[2] && b[2]) near += piece;
      }
      return near > 0.8 * length;
    }

    // Whether an ordinate has a place.
    has(y) {
      const { log, from } = this.chart.y;
      return Number.isFinite(y) && (!log || y > 0) && (from == null || y >= from);
    }

    // The range of y for what is seen of the curves; the lines belong to the whole view.
    height(low, high) {
      const log = this.chart.y.log;
      if (low == null || high == null) return log ? [1, 10] : [0, 1];
      if (this.shown[0] === this.whole[0] && this.shown[1] === this.whole[1]) {
        for (const band of this.chart.bands) {
          if (band.axis === "y" && band.low === band.high) {
            low = Math.min(low, band.low);
            high = Math.max(high, band.high);
          }
        }
      }
      if (this.chart.y.least != null) low = Math.min(low, this.chart.y.least);
      // Words at peaks have room above them.
      const above = this.chart.labels.length > 0 ? 2.5 : 1;
      if (log) {
        low = Math.max(low, high * LEAST, this.chart.y.from ?? 0);
        const pad = Math.max(Math.pow(high / low, 0.05), 1.1);
        return [low / pad, high * Math.pow(pad, above)];
      }
      const pad = high > low ? 0.06 * (high - low) : 1;
      return [low - pad, high + above * pad];
    }

    drawBands(u) {
      const { left, top, width, height } = u.bbox;
      const context = u.ctx;
      context.save();
      context.beginPath();
      context.rect(left, top, width, height);
      context.clip();
      this.chart.bands.forEach((band) => {
        const log = band.axis === "x" ? this.chart.x.log : this.chart.y.log;
        const scale = u.scales[band.axis];
        const within = (v) => Math.min(Math.max(v, scale.min), scale.max);
        const [a, b] = [band.low, band.high].map((v) => u.valToPos(log ? within(v) : v, band.axis, true));
        context.strokeStyle = context.fillStyle = colour(band.colour);
        if (band.low === band.high) {
          if (band.low < scale.min || band.low > scale.max) return;
          context.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
          context.lineWidth = 1.5 * devicePixelRatio;
          context.beginPath();
          if (band.axis === "x") { context.moveTo(a, top); context.lineTo(a, top + height); }
          else { context.moveTo(left, a); context.lineTo(left + width, a); }
          context.stroke();
        } else {
          context.globalAlpha = 0.18;
          if (band.axis === "x") context.fillRect(a, top, b - a, height);
          else context.fillRect(left, b, width, a - b);
          context.globalAlpha = 1;
        }
      });
      context.restore();
    }

    // The edges of what noise may be, above the curves: these may fill it.
    drawEdges(u) {
      const { left, top, width, height } = u.bbox;
      const context = u.ctx, scale = u.scales.y;
      context.save();
      context.strokeStyle = ink("--soft");
      context.lineWidth = devicePixelRatio;
      context.setLineDash([]);
      context.beginPath();
      for (const band of this.chart.bands.filter((band) => band.axis === "y" && band.low < band.high)) {
        for (const edge of [band.low, band.high].filter((v) => v > scale.min && v < scale.max)) {
          const at = Math.min(Math.max(u.valToPos(edge, "y", true), top), top + height);
          context.moveTo(left, at);
          context.lineTo(left + width, at);
        }
      }
      context.stroke();
      context.restore();
    }

    drawLabels(u) {
      const { left, top, width, height } = u.bbox;
      const context = u.ctx, size = devicePixelRatio;
      // On curves a word stays legible by a rim of the ground.
      const write = (text, x, y) => {
        context.save();
        context.strokeStyle = ink("--paper");
        context.lineWidth = 4 * size;
        context.lineJoin = "round";
        context.strokeText(text, x, y);
        context.restore();
        context.fillText(text, x, y);
      };
      context.save();
      // A curve before may have been dashed.
      context.setLineDash([]);
      context.font = `${12 * size}px system-ui, sans-serif`;
      context.fillStyle = ink("--soft");
      context.textBaseline = "top";
      context.textAlign = "center";
      const frame = [left, top, left + width, top + height], high = 14 * size, taken = [];
      const named = this.chart.bands.some(level) || this.chart.labels.length > 0;
      const drawn = named ? this.curves.map((curve, k) => (curve.on ? curves.points(u, k + 1) : [])) : [];
      const put = (text, [from, above, to]) => write(text, (from + to) / 2, above + size);
      for (const band of this.chart.bands.filter(level)) {
        if (band.low < u.scales.y.min || band.low > u.scales.y.max) continue;
        const y = u.valToPos(band.low, "y", true), wide = context.measureText(band.name).width;
        const free = width - wide - 8 * size;
        const place = take([0, 1, 0.5, 0.25, 0.75].flatMap((part) => {
          const end = frame[2] - 4 * size - part * free;
          return [y - high - size, y + 3 * size].map((from) => [end - wide, from, end, from + high]);
        }), frame, drawn, taken);
        if (place) put(band.name, place);
      }
      for (const label of this.chart.labels) {
        if (!this.has(label.y) || (this.chart.x.log && !(label.x > 0))) continue;
        if (label.x < this.shown[0] || label.x > this.shown[1]) continue;
        const x = u.valToPos(label.x, "x", true), y = u.valToPos(label.y, "y", true);
        if (y < top || y > top + height) continue;
        const wide = context.measureText(label.text).width + 4 * size, gap = 7 * size;
        const places = [];
        // Above its point, below it, and farther off along both axes; at an edge within the frame.
        for (let row = 0; row < 5; row++) {
          const off = gap + 1.2 * row * high;
          for (const aside of [0, -wide / 2 - gap, wide / 2 + gap]) {
            const from = Math.max(Math.min(x - wide / 2 + aside, frame[2] - wide), left);
            for (const above of [y - off - high, y + off]) {
              places.push([from, above, from + wide, above + high]);
            }
          }
        }
        const place = take(places, frame, drawn, taken);
        if (!place) continue;
        context.strokeStyle = ink("--soft");
        context.lineWidth = size;
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(Math.max(Math.min(x, place[2]), place[0]),
          Math.max(Math.min(y, place[3]), place[1]));
        context.stroke();
        context.fillStyle = ink("--ink");
        put(label.text, place);
      }
      context.restore();
    }

    // Values of all curves at x, from all points and not only from those that are drawn.
    tell(x) {
      this.cursor = x;
      const span = (name) => (this.chart[name].log || this.chart[name].even || !this.u ? 0
        : this.u.scales[name].max - this.u.scales[name].min);
      const across = span("x"), high = span("y");
      this.at.textContent = x == null ? "" : `${short(x, across)} ${this.unit}`.trim();
      const words = [];
      for (const curve of this.curves) {
        if (!curve.out) continue;
        let text = "";
        if (x != null && curve.x.length > 0) {
          const value = curve.y[nearest(curve.x, x)];
          const inside = x >= curve.x[0] && x <= curve.x[curve.x.length - 1];
          if (inside && Number.isFinite(value)) {
            text = `${short(value, high)} ${this.unitOfCurves}`.trim();
          }
        }
        curve.out.textContent = text;
        if (curve.on && text !== "") words.push(`${curve.name} ${text}`);
      }
      return words;
    }

    show(low, high, together) {
      const [a, b] = this.whole;
      low = Math.max(low, a);
      high = Math.min(high, b);
      // Not less than what a double can tell apart.
      if (!(high - low > 1e-12 * Math.max(Math.abs(low), Math.abs(high)))) return;
      this.shown = [low, high];
      this.u.batch(() => {
        this.u.setData(this.data(), false);
        this.u.setScale("x", { min: low, max: high });
      });
      if (together && this.chart.group) {
        for (const other of charts) {
          if (other !== this && other.chart.group === this.chart.group) other.show(low, high, false);
        }
      }
    }

    zoom(factor) {
      const { to, from } = spread(this.chart.x);
      const [a, b] = this.shown.map(to);
      const inside = this.cursor != null && this.cursor > this.shown[0] && this.cursor < this.shown[1];
      const middle = inside ? to(this.cursor) : (a + b) / 2;
      this.show(from(middle - (middle - a) * factor), from(middle + (b - middle) * factor), true);
    }

    move(part) {
      const { to, from } = spread(this.chart.x);
      const [a, b] = this.shown.map(to), [least, most] = this.whole.map(to);
      const step = Math.min(Math.max(part * (b - a), least - a), most - b);
      this.show(from(a + step), from(b + step), true);
    }

    key(event) {
      const act = {
        ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
        "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2),
        "0": () => this.show(...this.whole, true),
        PageUp: () => this.move(-0.5), PageDown: () => this.move(0.5),
      }[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    }

    // Moves the cursor by a hundredth of the view and says what is there.
    step(by) {
      const width = this.u.bbox.width / devicePixelRatio;
      const now = this.u.cursor.left >= 0 ? this.u.cursor.left : width / 2;
      const left = Math.min(Math.max(now + (by * width) / 100, 0), width);
      this.u.setCursor({ left, top: 0 });
      const words = this.tell(this.u.posToVal(left, "x"));
      this.said.textContent = `${this.at.textContent}: ${words.join(", ")}`;
    }
  }

  const captions = [...document.querySelectorAll(".overlaps")];
  const whole = captions.map((caption) => caption.textContent);
  for (const data of document.querySelectorAll("figure > script.chart")) {
    charts.push(new Plot(data.parentElement, JSON.parse(data.textContent)));
  }
  dark.addEventListener("change", () => charts.forEach((plot) => plot.build()));
  // What is printed are the drawings, which show everything.
  addEventListener("beforeprint", () => captions.forEach((one, k) => { one.textContent = whole[k]; }));
  addEventListener("afterprint", () => charts.forEach((plot) => plot.widen()));
})();
