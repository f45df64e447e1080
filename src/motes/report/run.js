"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const scene = data.scene, columns = data.columns, rows = data.rows;
  scene.timed = rows.length > 0 && rows[rows.length - 1][1] !== null;

  function column(name) {
    const place = columns.indexOf(name);
    return rows.map(function (row) { return row[place]; });
  }

  function way(axes, kind, upto) {
    return axes.map(function (axis) {
      const found = axis < 0 ? column(scene.timed ? "time" : "step") : column(scene.names[axis] + " " + kind);
      return found.slice(0, upto);
    });
  }

  function bytes(text) {
    const found = atob(text), array = new Uint8Array(found.length);
    for (let i = 0; i < found.length; i++) { array[i] = found.charCodeAt(i); }
    return array.buffer;
  }

  function element(kind, text) {
    const found = document.createElement(kind);
    found.textContent = text;
    return found;
  }

  function loaded(source) {
    return new Promise(function (done) {
      if (!source) { done(null); return; }
      const image = new Image();
      image.onload = function () { done(image); };
      image.onerror = function () { done(null); };
      image.src = source;
    });
  }

  const steps = column("step"), drawings = [];
  const ground = loaded(data.picture);
  data.frames.forEach(function (one) {
    const frame = motesCloud.frame(one.header, bytes(one.body), 0);
    const figure = element("figure", ""), canvas = element("canvas", "");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "Particles, mean, two-sigma ellipse, way and truth at step " + frame.step);
    figure.append(canvas, element("figcaption", "step " + frame.step + (frame.time === null ? "" : ", " + frame.time + " s")));
    document.getElementById("moments").append(figure);
    const upto = steps.filter(function (step) { return step <= frame.step; }).length;
    const axes = frame.axes;
    const ways = { mean: way(axes, "mean", upto), truth: scene.truth ? way(axes, "truth", upto) : [[], []], sd: way(axes, "sd", upto) };
    Promise.all([ground, loaded(one.picture)]).then(function (images) {
      const draw = function () { motesCloud.draw(canvas, frame, scene, { follow: !scene.extent }, ways, images[1] || images[0]); };
      drawings.push(draw);
      draw();
    });
  });
  const marks = scene.marks.concat(scene.moving ? [scene.moving] : []).map(function (mark) { return ", " + mark.label; }).join("");
  document.getElementById("legend").textContent =
    "Blue: particles; orange: mean, way and two-sigma ellipse" + (scene.truth ? "; black or white: truth" : "") + marks + ".";

  function style(name) { return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim(); }

  function chart(title, name, logarithmic, factor) {
    const values = column(name).map(function (value) {
      return value === null || (logarithmic && value <= 0) ? null : (factor || 1) * value;
    });
    if (values.every(function (value) { return value === null; })) { return; }
    const place = element("div", ""), axis = { stroke: style("text"), grid: { stroke: style("grid"), width: 1 }, ticks: { stroke: style("grid"), width: 1 } };
    document.getElementById("charts").append(element("h3", title), place);
    const plot = new uPlot({
      width: Math.max(280, place.clientWidth), height: 180, scales: { x: { time: false }, y: { distr: logarithmic ? 3 : 1 } },
      axes: [axis, Object.assign({ size: 64 }, axis, logarithmic ? { grid: { show: false } } : {})], legend: { show: false },
      series: [{ label: "step" }, { label: title, stroke: style("cloud"), width: 1.5, points: { show: false }, spanGaps: true }]
    }, [column(scene.timed ? "time" : "step"), values], place);
    drawings.push(function () { plot.setSize({ width: Math.max(280, place.clientWidth), height: 180 }); });
  }

  chart("Error of " + scene.judged.join(", "), "error", true);
  chart("Effective sample size", "ess");
  chart("Log evidence of a step", "log_evidence");
  chart("Time per step, ms", "seconds", true, 1e3);
  window.addEventListener("resize", function () { drawings.forEach(function (draw) { draw(); }); });
})();
