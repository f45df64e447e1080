"use strict";
// Draws a moment of a run on a canvas: what stands behind, the way, the truth, the particles, mean and ellipse; and what else the page of a
// run at work and that of one that is over have in common.
const motesCloud = (function () {
  const LEVELS = 6, LARGEST = 65535, REACH = 3.5, ROOM = 0.08, SHRINK = 0.06, SMALL = 0.12, INSET = 0.34;

  function colors(element) {
    const style = getComputedStyle(element);
    const found = {};
    ["back", "text", "grid", "cloud", "mean", "truth", "halo", "mark"].forEach(function (name) {
      found[name] = style.getPropertyValue("--" + name).trim();
    });
    return found;
  }

  // The arrays of a moment, from where they begin in a buffer; uint16 may not begin at an odd place, so that they are copied.
  function frame(header, buffer, begin) {
    const count = header.count;
    const of = function (place) {
      const low = header.low[place], reach = (header.high[place] - low) / LARGEST;
      const whole = new Uint16Array(buffer.slice(begin + 2 * count * place, begin + 2 * count * (place + 1)));
      const found = new Float32Array(count);
      for (let i = 0; i < count; i++) { found[i] = low + reach * whole[i]; }
      return found;
    };
    const end = begin + 5 * count;
    return Object.assign({}, header, { x: of(0), y: of(1), weights: new Uint8Array(buffer.slice(begin + 4 * count, end)), end: end });
  }

  function nice(span, count) {
    const raw = span / Math.max(1, count), power = Math.pow(10, Math.floor(Math.log10(raw)));
    const lead = raw / power;
    return power * (lead <= 1 ? 1 : lead <= 2 ? 2 : lead <= 5 ? 5 : 10);
  }

  function ticks(low, high, count) {
    const step = nice(high - low, count), found = [];
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step && found.length < 50; k++) { found.push(k * step); }
    return found;
  }

  function written(value, span) {
    if (value === 0) { return "0"; }
    const size = Math.max(Math.abs(value), span);
    if (size >= 1e6 || size < 1e-3) { return value.toExponential(Math.abs(value) > 20 * span ? 4 : 1); }
    const digits = Math.max(0, 1 - Math.floor(Math.log10(span)));
    return value.toFixed(Math.min(digits, 8)).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
  }

  // What one coordinate should show: the particles as far as they weigh something, the truth, and the way.
  function wanted(one, place, way, whole) {
    const spread = REACH * Math.sqrt(Math.max(0, one.cov[2 * place] || 0)), mean = one.mean[place];
    let low = Infinity, high = -Infinity;
    const add = function (value) {
      if (value !== null && Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    };
    if (mean !== null) {
      add(Math.max(mean - spread, whole ? one.low[place] : -Infinity));
      add(Math.min(mean + spread, whole ? one.high[place] : Infinity));
      add(mean);
    }
    add(one.truth[place]);
    const from = whole ? 0 : Math.max(0, way.length - 20);
    for (let i = from; i < way.length; i++) { add(way[i]); }
    if (!(high >= low)) { return [-1, 1]; }
    const least = 1e-6 * Math.max(1, Math.abs(low), Math.abs(high));
    const room = ROOM * Math.max(high - low, least) + least;
    return [low - room, high + room];
  }

  // Grows at once and shrinks slowly, so that the picture does not tremble.
  function settled(before, now) {
    if (!before) { return now; }
    const low = now[0] < before[0] ? now[0] : before[0] + SHRINK * (now[0] - before[0]);
    const high = now[1] > before[1] ? now[1] : before[1] + SHRINK * (now[1] - before[1]);
    const moved = now[0] > before[1] || now[1] < before[0];
    return moved ? now : [low, high];
  }

  function isEqual(scene, axes) {
    if (axes[0] < 0 || axes[1] < 0) { return false; }
    return scene.units[axes[0]] !== "" && scene.units[axes[0]] === scene.units[axes[1]] && scene.units[axes[0]] !== "rad";
  }

  function range(one, scene, view, ways) {
    const own = one.axes[0] === 0 && one.axes[1] === 1;
    let x, y;
    if (own && scene.extent && !view.follow) {
      x = [scene.extent[0], scene.extent[1]];
      y = [scene.extent[2], scene.extent[3]];
    } else {
      x = settled(view.x, wanted(one, 0, ways.mean[0], !view.follow));
      y = settled(view.y, wanted(one, 1, ways.mean[1], !view.follow));
      view.x = x;
      view.y = y;
      if (own && scene.extent && scene.extent[2] > scene.extent[3]) { y = [y[1], y[0]]; }
    }
    return [x, y];
  }

  function draw(canvas, one, scene, view, ways, picture) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) { return; }
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d"), look = colors(canvas);
    const box = { left: 58, right: width - 10, top: 10, bottom: height - 40 };
    let [x, y] = range(one, scene, view, ways);
    if (isEqual(scene, one.axes)) { [x, y] = levelled(x, y, box); }
    const across = function (value) { return box.left + (value - x[0]) / (x[1] - x[0]) * (box.right - box.left); };
    const up = function (value) { return box.bottom - (value - y[0]) / (y[1] - y[0]) * (box.bottom - box.top); };
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = look.back;
    pen.fillRect(0, 0, width, height);
    axes(pen, look, box, x, y, across, up, names(scene, one.axes));
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    pen.clip();
    if (one.axes[0] === 0 && one.axes[1] === 1) {
      if (picture && scene.extent) {
        const e = scene.extent;
        pen.imageSmoothingEnabled = true;
        pen.drawImage(picture, across(e[0]), up(e[3]), across(e[1]) - across(e[0]), up(e[2]) - up(e[3]));
      }
      scene.marks.forEach(function (mark) { marks(pen, look, mark, across, up); });
      if (scene.moving && one.moving.length) {
        const places = scene.moving.shape === "line" ? one.moving.concat([one.moving[0]]) : one.moving;
        marks(pen, look, { shape: scene.moving.shape, places: places }, across, up);
      }
    }
    if (one.axes[0] < 0 && ways.sd[1]) { band(pen, look, ways, across, up); }
    line(pen, ways.truth, across, up, look.truth, look.halo, 2.4);
    line(pen, ways.mean, across, up, look.mean, look.halo, 1.6);
    cloud(pen, look, one, across, up, one.axes[0] < 0 ? 10 : 0);
    ellipse(pen, look, one, across, up);
    dots(pen, look, one, across, up);
    pen.restore();
    const narrow = one.axes[0] === 0 && one.axes[1] === 1 && scene.extent && !view.follow &&
      2 * REACH * Math.sqrt(Math.max(one.cov[0], one.cov[2])) < SMALL * Math.min(Math.abs(x[1] - x[0]), Math.abs(y[1] - y[0]));
    if (narrow) { closer(pen, look, one, scene, view, box, across, up); }
  }

  // Where the law is a dot on the map, it is shown larger in a corner away from it.
  function closer(pen, look, one, scene, view, box, across, up) {
    const side = Math.min(INSET * Math.min(box.right - box.left, box.bottom - box.top), 240);
    const a = across(one.mean[0]), b = up(one.mean[1]), left = a > (box.left + box.right) / 2 ? box.left + 6 : box.right - side - 6;
    const top = b > (box.top + box.bottom) / 2 ? box.top + 6 : box.bottom - side - 6;
    const ways = [one.cov[0], one.cov[2]].map(function (value) { return 1.2 * REACH * Math.sqrt(Math.max(value, 0)); });
    const half = settled(view.half ? [-view.half, view.half] : null, [-Math.max(ways[0], ways[1], 1e-12), Math.max(ways[0], ways[1], 1e-12)])[1];
    view.half = half;
    const over = scene.extent[2] > scene.extent[3] ? -1 : 1;
    const near = function (value) { return left + side / 2 + (value - one.mean[0]) / half * side / 2; };
    const high = function (value) { return top + side / 2 - over * (value - one.mean[1]) / half * side / 2; };
    pen.save();
    pen.beginPath();
    pen.rect(left, top, side, side);
    pen.fillStyle = look.back;
    pen.fill();
    pen.clip();
    cloud(pen, look, one, near, high, 0);
    ellipse(pen, look, one, near, high);
    dots(pen, look, one, near, high);
    pen.restore();
    pen.strokeStyle = look.text;
    pen.lineWidth = 1.5;
    pen.strokeRect(left, top, side, side);
    pen.fillStyle = look.text;
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(written(2 * half, 2 * half) + (scene.units[0] ? " " + scene.units[0] : "") + " wide", left + 5, top + side - 4);
  }

  function levelled(x, y, box) {
    const wide = box.right - box.left, high = box.bottom - box.top;
    const scale = Math.max(Math.abs(x[1] - x[0]) / wide, Math.abs(y[1] - y[0]) / high);
    const grown = function (side, length) {
      const middle = (side[0] + side[1]) / 2, half = scale * length / 2 * Math.sign(side[1] - side[0]);
      return [middle - half, middle + half];
    };
    return [grown(x, wide), grown(y, high)];
  }

  function names(scene, axes) {
    return axes.map(function (axis) {
      if (axis < 0) { return scene.timed ? "time, s" : "step"; }
      return scene.names[axis] + (scene.units[axis] ? ", " + scene.units[axis] : "");
    });
  }

  function axes(pen, look, box, x, y, across, up, labels) {
    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = look.grid;
    pen.fillStyle = look.text;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const low = Math.min(x[0], x[1]), high = Math.max(x[0], x[1]), bottom = Math.min(y[0], y[1]), top = Math.max(y[0], y[1]);
    ticks(low, high, (box.right - box.left) / 90).forEach(function (value) {
      pen.beginPath();
      pen.moveTo(across(value), box.top);
      pen.lineTo(across(value), box.bottom);
      pen.stroke();
      pen.fillText(written(value, high - low), across(value), box.bottom + 4);
    });
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    ticks(bottom, top, (box.bottom - box.top) / 55).forEach(function (value) {
      pen.beginPath();
      pen.moveTo(box.left, up(value));
      pen.lineTo(box.right, up(value));
      pen.stroke();
      pen.fillText(written(value, top - bottom), box.left - 5, up(value));
    });
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    pen.fillText(labels[0], (box.left + box.right) / 2, box.bottom + 37);
    pen.save();
    pen.translate(11, (box.top + box.bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textBaseline = "middle";
    pen.fillText(labels[1], 0, 0);
    pen.restore();
  }

  function marks(pen, look, mark, across, up) {
    pen.strokeStyle = pen.fillStyle = look.mark;
    pen.lineWidth = 2;
    if (mark.shape === "line") {
      line(pen, [mark.places.map(function (p) { return p[0]; }), mark.places.map(function (p) { return p[1]; })], across, up, look.mark,
        look.halo, 2);
      return;
    }
    mark.places.forEach(function (place) {
      const a = across(place[0]), b = up(place[1]);
      pen.beginPath();
      if (mark.shape === "cross") {
        pen.moveTo(a - 5, b - 5); pen.lineTo(a + 5, b + 5); pen.moveTo(a - 5, b + 5); pen.lineTo(a + 5, b - 5);
        pen.stroke();
      } else {
        pen.moveTo(a, b - 7); pen.lineTo(a + 6, b + 5); pen.lineTo(a - 6, b + 5);
        pen.closePath();
        pen.fill();
        pen.lineWidth = 1;
        pen.strokeStyle = look.halo;
        pen.stroke();
        pen.strokeStyle = look.mark;
        pen.lineWidth = 2;
      }
    });
  }

  function line(pen, way, across, up, color, halo, thick) {
    const xs = way[0], ys = way[1];
    if (!xs || !ys || xs.length < 2) { return; }
    pen.beginPath();
    let there = false;
    for (let i = 0; i < xs.length; i++) {
      const a = across(xs[i]), b = up(ys[i]);
      if (!Number.isFinite(a) || !Number.isFinite(b) || xs[i] === null || ys[i] === null) { there = false; continue; }
      if (there) { pen.lineTo(a, b); } else { pen.moveTo(a, b); }
      there = true;
    }
    pen.lineJoin = "round";
    pen.strokeStyle = halo;
    pen.lineWidth = thick + 2;
    pen.stroke();
    pen.strokeStyle = color;
    pen.lineWidth = thick;
    pen.stroke();
  }

  function band(pen, look, ways, across, up) {
    const xs = ways.mean[0], ys = ways.mean[1], sd = ways.sd[1];
    pen.beginPath();
    for (let i = 0; i < xs.length; i++) { pen.lineTo(across(xs[i]), up(ys[i] + 2 * sd[i])); }
    for (let i = xs.length - 1; i >= 0; i--) { pen.lineTo(across(xs[i]), up(ys[i] - 2 * sd[i])); }
    pen.globalAlpha = 0.25;
    pen.fillStyle = look.mean;
    pen.fill();
    pen.globalAlpha = 1;
  }

  // Heavier particles are drawn later and less transparent; a few levels, since a change of style is slow.
  function cloud(pen, look, one, across, up, scatter) {
    const count = one.count, size = count > 5000 ? 1.6 : count > 600 ? 2.2 : 3.2;
    pen.fillStyle = look.cloud;
    for (let level = 0; level < LEVELS; level++) {
      pen.globalAlpha = 0.16 + 0.74 * (level + 1) / LEVELS * (count > 5000 ? 0.7 : 1);
      for (let i = 0; i < count; i++) {
        if (Math.min(LEVELS - 1, Math.floor(one.weights[i] * LEVELS / 256)) !== level) { continue; }
        const aside = scatter ? (i * 0.618034 % 1 - 0.5) * scatter : 0;
        pen.fillRect(across(one.x[i]) + aside - size / 2, up(one.y[i]) - size / 2, size, size);
      }
    }
    pen.globalAlpha = 1;
  }

  function ellipse(pen, look, one, across, up) {
    const [a, b, c] = one.cov;
    if (one.mean[0] === null || one.mean[1] === null || a === null || c === null || one.axes[0] < 0) { return; }
    const first = Math.sqrt(Math.max(a, 0)), cross = first > 0 ? b / first : 0, second = Math.sqrt(Math.max(c - cross * cross, 0));
    pen.beginPath();
    for (let k = 0; k <= 64; k++) {
      const angle = 2 * Math.PI * k / 64, cosine = 2 * Math.cos(angle), sine = 2 * Math.sin(angle);
      pen.lineTo(across(one.mean[0] + first * cosine), up(one.mean[1] + cross * cosine + second * sine));
    }
    pen.strokeStyle = look.halo;
    pen.lineWidth = 4;
    pen.stroke();
    pen.strokeStyle = look.mean;
    pen.lineWidth = 2;
    pen.stroke();
  }

  function dots(pen, look, one, across, up) {
    if (one.truth[0] !== null && one.truth[1] !== null) {
      const a = across(one.truth[0]), b = up(one.truth[1]);
      [[look.halo, 5], [look.truth, 2.4]].forEach(function (style) {
        pen.beginPath();
        pen.arc(a, b, 9, 0, 2 * Math.PI);
        pen.strokeStyle = style[0];
        pen.lineWidth = style[1];
        pen.stroke();
      });
    }
    if (one.mean[0] !== null && one.mean[1] !== null) {
      pen.beginPath();
      pen.arc(across(one.mean[0]), up(one.mean[1]), 4.5, 0, 2 * Math.PI);
      pen.fillStyle = look.mean;
      pen.fill();
      pen.strokeStyle = look.halo;
      pen.lineWidth = 1.5;
      pen.stroke();
    }
  }

  function element(kind, text) {
    const found = document.createElement(kind);
    found.textContent = text;
    return found;
  }

  function style(name) { return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim(); }

  // How many steps, in order, are not after one.
  function count(steps, step) {
    let low = 0, high = steps.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (steps[middle] <= step) { low = middle + 1; } else { high = middle; }
    }
    return low;
  }

  // The first rows along two coordinates: the means, the truth or the standard deviations.
  function way(scene, column, axes, kind, upto) {
    return axes.map(function (axis) {
      const found = axis < 0 ? column(scene.timed ? "time" : "step") : column(scene.names[axis] + " " + kind);
      return upto < found.length ? found.slice(0, upto) : found;
    });
  }

  function ways(scene, column, axes, upto) {
    const of = function (kind) { return way(scene, column, axes, kind, upto); };
    return { mean: of("mean"), truth: scene.truth ? of("truth") : [[], []], sd: of("sd") };
  }

  function labels(scene) {
    return scene.marks.concat(scene.moving ? [scene.moving] : []).map(function (mark) { return mark.label; });
  }

  // The values of a chart; on a logarithmic axis there is no place for what is not above 0.
  function charted(values, logarithmic, factor) {
    return values.map(function (value) { return value === null || (logarithmic && value <= 0) ? null : factor * value; });
  }

  // Both axes of a chart, left of which there is so much room.
  function chartAxes(logarithmic, below, beside) {
    const line = function () { return { stroke: style("grid"), width: 1 }; };
    const axis = { stroke: style("text"), grid: line(), ticks: line() };
    // over more than a decade nine marks of each would run into one another
    const isPower = function (value) { return Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-6; };
    const decades = function (plot, values) {
      return values.length < 12 ? values : values.map(function (value) { return isPower(value) ? value : null; });
    };
    const ticks = Object.assign(line(), { filter: decades });
    return [Object.assign({}, axis, below), Object.assign({}, axis, beside, logarithmic ? { grid: { show: false }, ticks: ticks } : {})];
  }

  return { draw: draw, frame: frame, element: element, style: style, count: count, ways: ways, labels: labels, charted: charted,
           chartAxes: chartAxes };
})();
