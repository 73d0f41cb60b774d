// One cursor for all charts and the video: pointing at a frame shows it, playing moves the cursor.
(() => {
  const video = document.querySelector("video");
  const shown = video ? JSON.parse(video.dataset.frames) : [];
  const rate = video ? Number(video.dataset.rate) : 1;
  const charts = [...document.querySelectorAll("figure.chart[data-chart]")].map((figure) => ({
    svg: figure.querySelector("svg"),
    cursor: figure.querySelector(".cursor"),
    now: [...figure.querySelectorAll(".now")],
    ...JSON.parse(figure.dataset.chart),
  }));
  const nearest = (list, value) =>
    list.reduce((best, item, at) => Math.abs(item - value) < Math.abs(list[best] - value) ? at : best, 0);

  const worded = (value) => value === null ? "\u2013"
    : value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(2) : String(value);

  function point(frame) {
    for (const chart of charts) {
      const first = chart.frames[0], last = chart.frames[chart.frames.length - 1];
      const share = (frame - first) / Math.max(1, last - first);
      const x = chart.left + share * (chart.right - chart.left);
      chart.cursor.setAttribute("x1", x);
      chart.cursor.setAttribute("x2", x);
      const at = nearest(chart.frames, frame);
      chart.now.forEach((slot, line) => {
        slot.textContent = worded(chart.lines[line][at]);
      });
    }
  }

  function follow() {
    if (shown.length) point(shown[Math.min(shown.length - 1, Math.floor(video.currentTime * rate + 1e-3))]);
    if (video.requestVideoFrameCallback && !video.paused) video.requestVideoFrameCallback(follow);
  }

  for (const chart of charts) {
    const seek = (event) => {
      const box = chart.svg.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * chart.svg.viewBox.baseVal.width;
      const share = Math.min(1, Math.max(0, (x - chart.left) / (chart.right - chart.left)));
      const first = chart.frames[0], last = chart.frames[chart.frames.length - 1];
      const frame = chart.frames[nearest(chart.frames, first + share * (last - first))];
      point(frame);
      if (video) {
        video.pause();
        video.currentTime = (nearest(shown, frame) + 0.5) / rate;
      }
    };
    chart.svg.addEventListener("pointerdown", (event) => { chart.svg.setPointerCapture(event.pointerId); seek(event); });
    chart.svg.addEventListener("pointermove", (event) => { if (event.buttons & 1) seek(event); });
  }
  if (video) for (const name of ["timeupdate", "play", "seeked"]) video.addEventListener(name, follow);
  point(shown.length ? shown[0] : 0);
})();
