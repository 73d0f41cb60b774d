// One clock for everything on the page: the time bar, the video, the scene and the charts show the
// same frame, whichever of them was moved. Keys do what the buttons do.
(async () => {
  const find = (selector) => document.querySelector(selector);
  const nearest = (list, value) =>
    list.reduce((best, item, at) => Math.abs(item - value) < Math.abs(list[best] - value) ? at : best, 0);
  const stage = find(".stage"), all = JSON.parse(stage.dataset.frames), times = JSON.parse(stage.dataset.times);
  // A page of one frame has no time bar: nothing to play, nothing to tell.
  const video = find("video"), bar = find("#time"), told = find("#told"), player = find("#play"), speed = find("#speed");
  const shown = video ? JSON.parse(video.dataset.frames) : [], rate = video ? Number(video.dataset.rate) : 1;
  const words = find(".words"), lines = words ? JSON.parse(words.dataset.words) : [];
  const charts = [...document.querySelectorAll("figure.chart[data-chart]")].map((figure) => ({
    svg: figure.querySelector("svg"),
    cursor: figure.querySelector(".cursor"),
    now: [...figure.querySelectorAll(".now")],
    ...JSON.parse(figure.dataset.chart),
  }));
  let scene = null, space = null, step = 0, turn = Promise.resolve(), writing = 0;

  // A decision waits until it is saved; what is pressed meanwhile waits for its turn.
  function inTurn(call) { turn = turn.catch(() => {}).then(call); }
  const labels = reviewed(find("#review"), inTurn);

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
      chart.now.forEach((slot, line) => { slot.textContent = worded(chart.lines[line][at]); });
    }
  }

  // The address leads to the frame that is shown; browsers slow down those who write it too often.
  function addressed(frame) {
    clearTimeout(writing);
    writing = setTimeout(() => history.replaceState(null, "", `#frame=${frame}`), 250);
  }

  function show(wanted, { seek = true, label, address = true } = {}) {
    step = Math.min(all.length - 1, Math.max(0, wanted));
    const frame = all[step];
    if (bar) bar.value = step;
    if (told) told.textContent = `frame ${frame}, ${times[step].toFixed(2)} s`;
    point(frame);
    if (scene) scene.set({ step: nearest(scene.frames, frame) });
    if (words) words.textContent = lines[nearest(shown, frame)] ?? "";
    labels.at(frame, label);
    if (address && all.length > 1) addressed(frame);
    if (video && seek) {
      video.pause();
      const wanted = (nearest(shown, frame) + 0.5) / rate;
      if (Math.abs(video.currentTime - wanted) > 0.2 / rate) video.currentTime = wanted;
    }
  }

  function follow() {
    if (!video.seeking) {
      const at = Math.min(shown.length - 1, Math.floor(video.currentTime * rate + 1e-3));
      // A short video may be over before a busy machine has shown any of it.
      if (!video.paused || video.ended) show(nearest(all, shown[at]), { seek: false });
    }
    if (video.requestVideoFrameCallback && !video.paused) video.requestVideoFrameCallback(follow);
  }

  const play = () => { if (video && player) (video.paused ? video.play() : video.pause()); };
  if (video) {
    for (const name of ["timeupdate", "play"]) video.addEventListener(name, follow);
    video.addEventListener("click", play);
  }
  if (video && player) {
    player.addEventListener("click", play);
    for (const name of ["play", "pause"]) {
      video.addEventListener(name, () => { player.textContent = video.paused ? "Play" : "Pause"; });
    }
    speed.addEventListener("change", () => { video.playbackRate = Number(speed.value); });
  }
  const parts = [...document.querySelectorAll("[data-part]")];
  const choosePart = (wanted) => {
    video.style.setProperty("--part", wanted);
    parts.forEach((one, k) => one.setAttribute("aria-pressed", k === wanted));
  };
  parts.forEach((one, k) => one.addEventListener("click", () => choosePart(k)));
  const nextPart = () => {
    if (parts.length) choosePart((parts.findIndex((one) => one.ariaPressed === "true") + 1) % parts.length);
  };
  if (bar) bar.addEventListener("input", () => show(Number(bar.value)));
  for (const chart of charts) {
    const seek = (event) => {
      const box = chart.svg.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * chart.svg.viewBox.baseVal.width;
      const share = Math.min(1, Math.max(0, (x - chart.left) / (chart.right - chart.left)));
      const first = chart.frames[0], last = chart.frames[chart.frames.length - 1];
      show(nearest(all, first + share * (last - first)));
    };
    chart.svg.addEventListener("pointerdown", (event) => { chart.svg.setPointerCapture(event.pointerId); seek(event); });
    chart.svg.addEventListener("pointermove", (event) => { if (event.buttons & 1) seek(event); });
  }
  labels.onJump((frame, label) => show(nearest(all, frame), { label }));

  const keys = {
    ArrowLeft: () => show(step - 1),
    ArrowRight: () => show(step + 1),
    ArrowUp: () => labels.step(-1),
    ArrowDown: () => labels.step(1),
    a: () => labels.decide("accepted"),
    r: () => labels.decide("rejected"),
    o: () => labels.decide("open"),
    u: () => labels.undo(),
    v: nextPart,
    c: () => space?.turn(),
    " ": play,
  };
  // Keys belong to the page whatever has the focus, but for a menu while it is open. A control
  // that was used by a pointer gives the focus back at once.
  let open = null;
  document.addEventListener("pointerdown", (event) => { open = event.target.closest?.("select") ?? null; });
  document.addEventListener("change", (event) => {
    open = null;
    if (event.target.matches("select")) event.target.blur();
  });
  document.addEventListener("click", (event) => { if (event.detail > 0) event.target.closest?.("button, summary, input")?.blur(); });
  document.addEventListener("keydown", (event) => {
    const { target, key } = event, menu = target.matches?.("select");
    if (event.ctrlKey || event.metaKey || event.altKey) {
      if (menu && key === "ArrowDown") open = target;
      return;
    }
    if (menu && ["Enter", "Escape", "Tab"].includes(key)) {
      open = key === "Enter" && open !== target ? target : null;
      return;
    }
    // A box is ticked by Enter: Space plays.
    if (key === "Enter" && target.matches?.("input[type=checkbox]")) target.click();
    if ((open && open === target) || target.matches?.("textarea, input:not([type=range], [type=checkbox])")) return;
    if (!keys[key] || (all.length === 1 && (key === " " || key === "ArrowLeft" || key === "ArrowRight"))) return;
    event.preventDefault();
    inTurn(keys[key]);
  });
  // A button is pressed when Space comes up: not here.
  document.addEventListener("keyup", (event) => { if (event.key === " " && all.length > 1) event.preventDefault(); });

  const linked = () => {
    const [, frame] = location.hash.match(/^#frame=(\d+)$/) ?? [];
    return frame === undefined ? null : nearest(all, Number(frame));
  };
  addEventListener("hashchange", () => { if (linked() !== null) show(linked(), { address: false }); });

  const card = find(".scene");
  if (card) {
    scene = await openScene(card);
    if (scene) space = sceneControls(card, scene);
    // For what a server tells later.
    card.scene = scene;
  }
  await labels.load();
  show(linked() ?? 0, { seek: linked() !== null, address: false });
  document.body.dataset.ready = "yes";
})();
