"use strict";
(function () {
  const element = motesCloud.element, style = motesCloud.style;
  const byId = function (id) { return document.getElementById(id); };
  const BEAT = 1000, AGAIN = 2000, CHARTS = 250, MOMENT = 40;
  const page = { axes: [0, 1], have: -1, at: null, by: 0, generation: -1, rows: 0, state: "" };
  const view = { follow: false };
  let scene = null, columns = [], socket = null, waiting = false, wanted = null, paused = false, playing = false;
  let shown = null, ground = null, moving = null, answer = null, charts = [], drawn = 0, stamps = [], timer = 0, updates = 0;

  function column(name) { return columns[scene.columns.indexOf(name)] || []; }

  function ask(more) {
    const question = Object.assign({}, page, more || {});
    if (!socket || socket.readyState !== 1) { return; }
    if (waiting) { wanted = question; return; }
    waiting = true;
    wanted = null;
    socket.send(JSON.stringify(question));
  }

  function connect() {
    socket = new WebSocket("ws://" + location.host + "/live");
    socket.binaryType = "arraybuffer";
    socket.onopen = function () { waiting = false; ask(); };
    socket.onmessage = function (event) { waiting = false; take(event.data); };
    socket.onclose = function (event) {
      waiting = false;
      byId("status").textContent = event.code === 1013 ? "closed: too many pages look at this run" : "no contact: the run has ended, or its page was closed";
      if (event.code !== 1013) { window.setTimeout(connect, AGAIN); }
    };
  }

  function take(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    answer = header;
    const width = scene.columns.length, begin = 4 + length, many = header.rows.count * width;
    const numbers = new Float64Array(buffer.slice(begin, begin + 8 * many));
    if (header.rows.from === 0) { columns = scene.columns.map(function () { return []; }); }
    for (let i = 0; i < header.rows.count; i++) {
      for (let c = 0; c < width; c++) {
        const value = numbers[i * width + c];
        columns[c].push(Number.isFinite(value) ? value : null);
      }
    }
    page.generation = header.rows.generation;
    page.rows = header.rows.from + header.rows.count;
    page.state = header.state;
    scene.timed = columns[1].length > 0 && columns[1][columns[1].length - 1] !== null;
    if (!header.frame) { told(); next(); return; }
    const one = motesCloud.frame(header.frame, buffer, begin + 8 * many);
    if (!header.frame.picture) { show(one, null); return; }
    const bytes = new Blob([buffer.slice(one.end, one.end + header.frame.picture)], { type: "image/jpeg" });
    createImageBitmap(bytes).then(function (image) { show(one, image); }, function () { show(one, null); });
  }

  function show(one, image) {
    if (moving) { moving.close(); }
    moving = image;
    if (one.axes[0] !== page.axes[0] || one.axes[1] !== page.axes[1]) { next(); return; }
    shown = one;
    if (answer.live) { page.have = one.number; }
    updates += 1;
    window.requestAnimationFrame(function () {
      draw();
      told();
      next();
    });
  }

  // The page asks again only when it has drawn: that is all that holds the server back.
  function next() {
    const now = performance.now();
    if (answer.frame) { stamps.push(now); }
    while (stamps.length > 1 && now - stamps[0] > 2000) { stamps.shift(); }
    if (wanted) { ask(wanted); return; }
    if (!paused) { page.at = null; ask(); return; }
    window.clearTimeout(timer);
    if (!playing) { timer = window.setTimeout(function () { ask({ at: shown ? shown.number : 0, by: 0 }); }, BEAT); return; }
    if (shown && shown.number >= answer.reel[1]) {
      playing = false;
      if (answer.state === "live") { live(); } else { buttons(); }
      return;
    }
    const speed = Number(byId("speed").value), pause = Math.max(25, MOMENT / speed);
    timer = window.setTimeout(function () {
      ask({ at: shown.number, by: Math.max(1, Math.round(speed * pause / MOMENT)) });
    }, pause);
  }

  function draw() {
    if (!shown) { return; }
    const upto = answer.live ? columns[0].length : motesCloud.count(columns[0], shown.step);
    const ways = motesCloud.ways(scene, column, page.axes, upto);
    motesCloud.draw(byId("cloud"), shown, scene, view, ways, moving || ground);
    const now = performance.now();
    if (now - drawn > CHARTS) { drawn = now; plots(); }
  }

  function last(values) { return values.length ? values[values.length - 1] : null; }
  function short(value, digits) { return value === null || value === undefined ? "-" : Number(value.toPrecision(digits || 4)).toString(); }

  function told() {
    const place = shown ? Math.max(0, motesCloud.count(columns[0], shown.step) - 1) : 0;
    const at = function (name) { const found = column(name); return found.length ? found[place] : null; };
    const rows = [["step", shown ? String(shown.step) : "-"]];
    if (scene.timed) { rows.push(["time", short(shown.time, 7) + " s"]); }
    rows.push(["effective size", short(at("ess"))]);
    if (answer.log_likelihood !== null) { rows.push(["log evidence, all", short(answer.log_likelihood, 6)]); }
    if (scene.truth && scene.judged.length) { rows.push(["error of " + scene.judged.join(", "), short(at("error")) + " " + unit()]); }
    const seconds = at("seconds");
    if (seconds !== null) { rows.push(["time per step", short(1e3 * seconds, 3) + " ms" + (scene.budget ? " of " + short(1e3 * scene.budget, 3) : "")]); }
    if (scene.budget) { rows.push(["late steps", answer.late + " of " + answer.taken]); }
    fill(byId("numbers"), rows.flatMap(function (row) { return [element("dt", row[0]), element("dd", row[1])]; }));
    alarms();
    fill(byId("told"), answer.told.map(function (one) { return element("li", "step " + one[0] + ": " + one[1]); }));
    byId("title").title = answer.filter;
    byId("status").textContent = answer.state + (paused ? (playing ? ", shown again" : ", paused here") : "");
    const rate = stamps.length > 1 ? 1000 * (stamps.length - 1) / (last(stamps) - stamps[0]) : 0;
    byId("rate").textContent = rate.toFixed(0) + " updates a second, " + (shown ? shown.count : 0) + " points";
    byId("rate").dataset.updates = String(updates);
    byId("report").hidden = !answer.report;
    const when = byId("when");
    when.min = answer.reel[0];
    when.max = answer.reel[1];
    if (shown && document.activeElement !== when) { when.value = shown.number; }
  }

  function alarms() {
    const place = byId("alarms"), found = answer.findings, bad = found.some(function (one) { return one.serious; });
    const text = JSON.stringify([found, shown !== null]);
    // said anew only where it is new: a reader would be told each time
    if (place.dataset.text === text) { return; }
    place.dataset.text = text;
    place.className = bad ? "bad" : "";
    fill(place, found.length ? found.map(function (one) {
      const line = element("p", "");
      line.append(element("b", (one.serious ? "warning, " : "note, ") + one.name + ": "), one.text);
      return line;
    }) : [element("p", shown ? "Nothing wrong was found in the last steps." : "The first measurement is waited for.")]);
  }

  function unit() {
    const place = scene.names.indexOf(scene.judged[0]);
    return place < 0 ? "" : scene.units[place];
  }

  function fill(place, children) { place.replaceChildren.apply(place, children); }

  function chart(title, names, logarithmic, factor, level) {
    const holder = element("div", "");
    holder.className = "chart";
    holder.append(element("h2", title));
    byId("charts").append(holder);
    const series = [{ label: "step" }].concat(names.map(function (name, index) {
      return { label: name, stroke: [style("cloud"), style("mean")][index], width: 1.4, points: { show: false }, spanGaps: true };
    }));
    if (level) { series.push({ label: "budget", stroke: style("mean"), width: 1.2, dash: [6, 4], points: { show: false } }); }
    const font = "11px system-ui";
    const plot = new uPlot({
      width: Math.max(240, holder.clientWidth), height: 120, cursor: { show: false }, legend: { show: false },
      scales: { x: { time: false }, y: { distr: logarithmic ? 3 : 1 } },
      axes: motesCloud.chartAxes(logarithmic, { size: 26, font: font }, { size: 58, font: font }),
      series: series
    }, [[]].concat(series.slice(1).map(function () { return []; })), holder);
    charts.push({ plot: plot, names: names, logarithmic: logarithmic, factor: factor || 1, level: level, holder: holder });
  }

  function plots() {
    const xs = scene.timed ? column("time") : column("step");
    charts.forEach(function (one) {
      const lines = one.names.map(function (name) {
        return motesCloud.charted(column(name), one.logarithmic, one.factor);
      });
      if (one.level) { lines.push(xs.map(function () { return one.level; })); }
      one.plot.setData([xs].concat(lines));
    });
  }

  function setCharts() {
    charts.forEach(function (one) { one.plot.destroy(); });
    charts = [];
    fill(byId("charts"), []);
    if (scene.truth && scene.judged.length) { chart("Error of " + scene.judged.join(", ") + (unit() ? ", " + unit() : ""), ["error"], true); }
    chart("Effective sample size", ["ess"], false);
    chart("Log evidence of a step", ["log_evidence"], false);
    chart("Time per step, ms", ["seconds"], true, 1e3, scene.budget ? 1e3 * scene.budget : 0);
    if (columns.length) { plots(); }
  }

  function live() { paused = playing = false; page.at = null; page.have = -1; window.clearTimeout(timer); buttons(); ask(); }
  function hold() { paused = true; playing = false; window.clearTimeout(timer); buttons(); }
  function buttons() { byId("pause").textContent = paused && !playing ? "Play" : "Pause"; }
  function toggle() {
    if (!paused || playing) { hold(); return; }
    if (shown && answer && shown.number >= answer.reel[1] && answer.state === "live") { live(); return; }
    playing = true;
    buttons();
    const again = shown && answer && shown.number >= answer.reel[1];
    ask({ at: again ? answer.reel[0] : shown ? shown.number : 0, by: again ? 0 : 1 });
  }
  function step(by) { hold(); if (shown) { ask({ at: shown.number, by: by }); } }
  function go(number) { hold(); ask({ at: number, by: 0 }); }

  function choose() {
    page.axes = [Number(byId("x").value), Number(byId("y").value)];
    view.x = view.y = undefined;
    page.have = -1;
    if (paused && shown) { ask({ at: shown.number, by: 0 }); } else { ask(); }
  }

  function turnTheme() {
    const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
    document.documentElement.dataset.theme = dark ? "light" : "dark";
    try { localStorage.setItem("theme", document.documentElement.dataset.theme); } catch (reason) { /* a frame may have no storage */ }
    setCharts();
    draw();
  }

  function cycle(id) {
    const place = byId(id);
    place.selectedIndex = (place.selectedIndex + 1) % place.options.length;
    choose();
  }

  function faster(by) {
    const place = byId("speed");
    place.selectedIndex = Math.min(Math.max(place.selectedIndex + by, 0), place.options.length - 1);
  }

  const KEYS = {
    " ": toggle, ArrowLeft: function () { step(-1); }, ArrowRight: function () { step(1); },
    Home: function () { if (answer) { go(answer.reel[0]); } }, End: live, "+": function () { faster(1); }, "-": function () { faster(-1); },
    f: function () { byId("follow").click(); }, t: turnTheme, x: function () { cycle("x"); }, y: function () { cycle("y"); }
  };

  function legend() {
    const found = [["cloud", "particle"], ["mean", "mean, way and two-sigma ellipse"]];
    if (scene.truth) { found.push(["truth", "truth"]); }
    const labels = motesCloud.labels(scene);
    if (labels.length) { found.push(["mark", labels.join(", ")]); }
    fill(byId("legend"), found.map(function (one) {
      const item = element("li", "");
      const key = element("span", "");
      key.className = "key-" + one[0];
      item.append(key, one[1]);
      return item;
    }));
  }

  function start(found) {
    scene = found;
    // a map is looked at as a whole, a plane without ends where the cloud is
    view.follow = byId("follow").checked = !scene.extent;
    document.title = scene.run;
    byId("title").textContent = scene.title ? scene.title + ": " + scene.run : scene.run;
    ["x", "y"].forEach(function (id, place) {
      const list = scene.names.map(function (name, index) { return [index, name]; });
      if (id === "x") { list.push([-1, "time"]); }
      fill(byId(id), list.map(function (one) {
        const option = element("option", one[1]);
        option.value = one[0];
        return option;
      }));
      page.axes[place] = scene.names.length > 1 ? place : place - 1;
      byId(id).value = page.axes[place];
    });
    legend();
    setCharts();
    if (scene.picture) {
      const image = new Image();
      image.onload = function () { ground = image; draw(); };
      image.src = "/picture";
    }
    connect();
  }

  try {
    const theme = localStorage.getItem("theme");
    if (theme) { document.documentElement.dataset.theme = theme; }
  } catch (reason) { /* a frame may have no storage */ }
  byId("pause").addEventListener("click", toggle);
  byId("back").addEventListener("click", function () { step(-1); });
  byId("forth").addEventListener("click", function () { step(1); });
  byId("now").addEventListener("click", live);
  byId("when").addEventListener("input", function () { go(Number(byId("when").value)); });
  byId("x").addEventListener("change", choose);
  byId("y").addEventListener("change", choose);
  byId("follow").addEventListener("change", function () { view.follow = byId("follow").checked; view.x = view.y = undefined; draw(); });
  byId("theme").addEventListener("click", turnTheme);
  document.addEventListener("keydown", function (event) {
    const does = KEYS[event.key];
    const inField = /^(SELECT|INPUT)$/.test(event.target.tagName) || (event.target.tagName === "BUTTON" && event.key === " ");
    if (!does || inField || event.ctrlKey || event.metaKey || event.altKey || !scene) { return; }
    event.preventDefault();
    does();
  });
  let resizing = 0;
  window.addEventListener("resize", function () {
    window.clearTimeout(resizing);
    resizing = window.setTimeout(function () { if (scene) { setCharts(); draw(); } }, 150);
  });
  fetch("/scene", { credentials: "same-origin" }).then(function (found) {
    if (!found.ok) { throw new Error(String(found.status)); }
    return found.json();
  }).then(start).catch(function () { byId("status").textContent = "no contact: open the link that was printed once more"; });
})();
