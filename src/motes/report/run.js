"use strict";
(function () {
  const element = motesCloud.element;
  const data = JSON.parse(document.getElementById("data").textContent);
  const scene = data.scene, columns = data.columns, rows = data.rows;
  scene.timed = rows.length > 0 && rows[rows.length - 1][1] !== null;

  function column(name) {
    const place = columns.indexOf(name);
    return rows.map(function (row) { return row[place]; });
  }

  function bytes(text) {
    const found = atob(text), array = new Uint8Array(found.length);
    for (let i = 0; i < found.length; i++) { array[i] = found.charCodeAt(i); }
    return array.buffer;
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
    const ways = motesCloud.ways(scene, column, frame.axes, motesCloud.count(steps, frame.step));
    Promise.all([ground, loaded(one.picture)]).then(function (images) {
      const draw = function () { motesCloud.draw(canvas, frame, scene, { follow: !scene.extent }, ways, images[1] || images[0]); };
      drawings.push(draw);
      draw();
    });
  });
  const drawn = data.frames.every(function (one) { return one.header.drawn; });
  const marks = motesCloud.labels(scene).map(function (label) { return ", " + label; }).join("");
  document.getElementById("legend").textContent =
    "Blue: " + (drawn ? "points drawn from mean and covariance" : "particles") + "; orange: mean, way and two-sigma ellipse" + (scene.truth ? "; black or white: truth" : "") + marks + ".";

  function chart(title, name, logarithmic, factor) {
    const values = motesCloud.charted(column(name), logarithmic, factor || 1);
    if (values.every(function (value) { return value === null; })) { return; }
    const place = element("div", "");
    document.getElementById("charts").append(element("h3", title), place);
    const plot = new uPlot({
      width: Math.max(280, place.clientWidth), height: 180, scales: { x: { time: false }, y: { distr: logarithmic ? 3 : 1 } },
      axes: motesCloud.chartAxes(logarithmic, {}, { size: 64 }), legend: { show: false },
      series: [{ label: "step" }, { label: title, stroke: motesCloud.style("cloud"), width: 1.5, points: { show: false }, spanGaps: true }]
    }, [column(scene.timed ? "time" : "step"), values], place);
    drawings.push(function () { plot.setSize({ width: Math.max(280, place.clientWidth), height: 180 }); });
  }

  chart("Error of " + scene.judged.join(", "), "error", true);
  chart("Effective sample size", "ess");
  chart("Log evidence of a step", "log_evidence");
  chart("Time per step, ms", "seconds", true, 1e3);
  window.addEventListener("resize", function () { drawings.forEach(function (draw) { draw(); }); });
})();
