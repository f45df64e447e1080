"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const colors = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#111111", "#7f7f7f"];
  const sync = uPlot.sync("steps");

  function draw(place, block, logarithmic) {
    const series = [{ label: "step" }];
    const lines = [data.steps];
    block.filters.forEach(function (values, index) {
      series.push({ label: data.names[index], stroke: colors[index % colors.length], width: 1.5, points: { show: false } });
      lines.push(values);
    });
    if (block.bound) {
      series.push({ label: "bound", stroke: "#111111", width: 1.5, dash: [6, 4], points: { show: false } });
      lines.push(block.bound);
    }
    place.textContent = "";
    return new uPlot({
      width: Math.max(320, Math.min(900, place.clientWidth)),
      height: 280,
      scales: { x: { time: false }, y: { distr: logarithmic ? 3 : 1 } },
      axes: [{ label: "step" }, { label: "RMSE of " + block.name, size: 70 }],
      cursor: { sync: { key: sync.key } },
      series: series
    }, lines, place);
  }

  document.querySelectorAll("[data-block]").forEach(function (section) {
    const block = data.blocks[Number(section.dataset.block)];
    const place = section.querySelector(".chart");
    const choice = section.querySelector("input");
    let chart = draw(place, block, choice.checked);
    function again() {
      chart.destroy();
      chart = draw(place, block, choice.checked);
    }
    choice.addEventListener("change", again);
    window.addEventListener("resize", again);
  });
})();
