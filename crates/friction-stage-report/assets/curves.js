// How curves are drawn on a page of a report and on the live page: which points a screen shows, and
// straight lines between them.
"use strict";
const curves = (() => {
  // Radius of a sample that no line joins, px.
  const DOT = 1.2;
  // First place in a growing column whose value is not below x.
  const place = (xs, x) => {
    let low = 0, high = xs.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (xs[middle] < x) low = middle + 1; else high = middle;
    }
    return low;
  };
  // What a range of x shows of a curve: of each column of the screen the first, the last and the
  // extremes. A gap is null.
  const decimated = (xs, ys, from, to, columns, shown) => {
    const first = Math.max(0, place(xs, from) - 1);
    const last = Math.min(xs.length, place(xs, to) + 1);
    const px = [], py = [];
    const put = (k) => { px.push(xs[k]); py.push(shown(ys[k]) ? ys[k] : null); };
    const width = Math.ceil((last - first) / columns);
    if (width < 5) {
      for (let k = first; k < last; k++) put(k);
      return [px, py];
    }
    for (let start = first; start < last; start += width) {
      const end = Math.min(start + width, last);
      let low = -1, high = -1, gap = -1;
      for (let k = start; k < end; k++) {
        const y = ys[k];
        if (!shown(y)) { gap = k; continue; }
        if (low < 0 || y < ys[low]) low = k;
        if (high < 0 || y > ys[high]) high = k;
      }
      const kept = [start, low, high, gap, end - 1].filter((k) => k >= 0).sort((a, b) => a - b);
      kept.forEach((k, i) => { if (i === 0 || k !== kept[i - 1]) put(k); });
    }
    return [px, py];
  };
  // The points of a drawn curve, px of the canvas; null for a gap. What is undefined is the abscissa
  // of another curve.
  const points = (u, series) => {
    const [xs, ys] = [u.data[0], u.data[series]], out = [];
    for (let k = 0; k < xs.length; k++) {
      if (ys[k] === undefined) continue;
      out.push(ys[k] === null ? null : [u.valToPos(xs[k], "x", true), u.valToPos(ys[k], "y", true)]);
    }
    return out;
  };
  // Straight lines from point to point. Those of uPlot put the many points of a column of pixels on
  // one abscissa, which makes stairs of a slope.
  const straight = (u, series) => {
    const path = new Path2D(), all = points(u, series);
    all.forEach((point, k) => {
      if (point === null) return;
      const [before, after] = [all[k - 1] ?? null, all[k + 1] ?? null];
      path[before ? "lineTo" : "moveTo"](...point);
      // A sample between two gaps is a dot.
      if (!before && !after) {
        const radius = DOT * devicePixelRatio;
        path.moveTo(point[0] + radius, point[1]);
        path.arc(...point, radius, 0, 2 * Math.PI);
      }
    });
    return { stroke: path, fill: null, clip: null, band: null, gaps: null, flags: 1 };
  };
  return { place, decimated, points, straight };
})();
