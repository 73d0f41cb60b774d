// One clock for everything on the page: the time bar, the video, the scene and the charts show the
// same frame, whichever of them was moved. Keys do what the buttons do.
(async () => {
  const find = (selector) => document.querySelector(selector);
  const nearest = (list, value) =>
    list.reduce((best, item, at) => Math.abs(item - value) < Math.abs(list[best] - value) ? at : best, 0);
  const stage = find(".stage"), all = JSON.parse(stage.dataset.frames), times = JSON.parse(stage.dataset.times);
  // A page of one frame has no time bar: nothing to play, nothing to tell.
  const video = find("video"), bar = find("#time"), told = find("#told"), player = find("#play");
  const shown = video ? JSON.parse(video.dataset.frames) : [], rate = video ? Number(video.dataset.rate) : 1;
  const charts = [...document.querySelectorAll("figure.chart[data-chart]")].map((figure) => ({
    svg: figure.querySelector("svg"),
    cursor: figure.querySelector(".cursor"),
    now: [...figure.querySelectorAll(".now")],
    ...JSON.parse(figure.dataset.chart),
  }));
  const labels = reviewed(find("#review"));
  let scene = null, step = 0, turn = Promise.resolve();

  // A decision waits until it is saved; what is pressed meanwhile waits for its turn.
  function inTurn(call) { turn = turn.catch(() => {}).then(call); }

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

  function show(wanted, { seek = true, label } = {}) {
    step = Math.min(all.length - 1, Math.max(0, wanted));
    const frame = all[step];
    if (bar) bar.value = step;
    if (told) told.textContent = `frame ${frame}, ${times[step].toFixed(2)} s`;
    point(frame);
    if (scene) scene.set({ step: nearest(scene.frames, frame) });
    labels.at(frame, label);
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

  const play = () => (video.paused ? video.play() : video.pause());
  if (video) {
    for (const name of ["timeupdate", "play"]) video.addEventListener(name, follow);
  }
  if (video && player) {
    player.addEventListener("click", play);
    for (const name of ["play", "pause"]) {
      video.addEventListener(name, () => { player.textContent = video.paused ? "Play" : "Pause"; });
    }
  }
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
  };
  document.addEventListener("keydown", (event) => {
    const busy = event.target.closest?.("select, textarea, input:not([type=range])");
    const slider = event.target.type === "range" && event.target !== bar;
    if (busy || (slider && event.key.startsWith("Arrow"))) return;
    if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
    event.preventDefault();
    inTurn(keys[event.key]);
  });

  const card = find(".scene");
  if (card) {
    scene = await openScene(card);
    if (scene) controls(card, scene);
  }
  await labels.load();
  show(0, { seek: false });
  document.body.dataset.ready = "yes";

  function controls(card, opened) {
    const note = card.querySelector(".controls .note"), mode = card.querySelector("[name=mode]");
    const legend = card.querySelector(".meaning");
    const recolor = () => {
      opened.set({ mode: mode.value });
      note.textContent = mode.selectedOptions[0]?.dataset.note ?? "";
      legend.innerHTML = card.querySelector(`template[data-mode="${mode.value}"]`)?.innerHTML ?? "";
    };
    mode.addEventListener("change", recolor);
    for (const input of card.querySelectorAll("input[type=range]")) {
      input.addEventListener("input", () => opened.set({ [input.name]: Number(input.value) }));
    }
    for (const input of card.querySelectorAll("input[type=checkbox]")) {
      input.addEventListener("change", () => opened.set({ [input.name]: input.checked }));
    }
    recolor();
  }

  // Decisions about labels: a served page sends each to its server, which saves it; one that was
  // opened from a disk cannot write files beside the trajectory, so it offers one.
  function reviewed(section) {
    if (!section) return { at: () => {}, decide: () => {}, undo: () => {}, step: () => {}, onJump: () => {}, load: () => {} };
    const review = JSON.parse(section.dataset.review), rows = [...section.querySelectorAll("[data-action]")];
    const firsts = rows.map((row) => Number(row.dataset.first)), undo = section.querySelector("#undo"), past = [];
    const served = document.body.dataset.version !== undefined, state = section.querySelector("#saved");
    let current = 0, chosen = null, go = () => {};
    // Whether the server took this, or told the decisions so far; the page then shows what it has.
    const synchronised = async (message) => {
      try {
        const sent = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(message) };
        const answer = await (await fetch("review", message && sent)).json();
        if (answer.error) throw new Error(answer.error);
        review.labels = answer.labels;
        state.textContent = message ? `Saved in ${section.dataset.file}` : `Decisions go to ${section.dataset.file}`;
      } catch (error) {
        const reason = error instanceof TypeError ? "the server has ended; start clothtrack view again" : error.message;
        state.textContent = `Not saved: ${reason}`;
      }
      state.classList.toggle("failed", state.textContent.startsWith("Not"));
      return !state.classList.contains("failed");
    };
    const put = async (which, verdict) => {
      if (served) return synchronised({ action: which, verdict });
      review.labels[which].verdict = verdict;
      return true;
    };
    const paint = () => {
      rows.forEach((row, k) => {
        row.dataset.verdict = review.labels[k].verdict;
        row.classList.toggle("current", k === current);
        row.querySelector(".verdict").textContent = review.labels[k].verdict;
      });
      const left = review.labels.filter((label) => label.verdict === "open").length;
      section.querySelector(".left").textContent = left ? `${left} still open` : "all decided";
      undo.disabled = past.length === 0;
    };
    const choose = (wanted) => {
      const which = Math.min(rows.length - 1, Math.max(0, wanted));
      go(review.labels[which].frame, which);
    };
    const decide = async (verdict, which = current) => {
      const before = review.labels[which].verdict;
      if (!(await put(which, verdict))) return;
      past.push({ which, verdict: before });
      choose(which + 1);
    };
    const takeBack = async () => {
      if (!past.length || !(await put(past.at(-1).which, past.at(-1).verdict))) return;
      choose(past.pop().which);
    };
    undo.addEventListener("click", () => inTurn(takeBack));
    rows.forEach((row, k) => {
      row.querySelector(".jump").addEventListener("click", () => inTurn(() => choose(k)));
      for (const button of row.querySelectorAll("[data-decide]")) {
        button.addEventListener("click", () => inTurn(() => decide(button.dataset.decide, k)));
      }
    });
    section.querySelector("#save").addEventListener("click", () => {
      const file = new Blob([JSON.stringify(review, null, 2) + "\n"], { type: "application/json" });
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: section.dataset.file });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
    for (const part of section.querySelectorAll("[data-when]")) {
      part.hidden = (part.dataset.when === "served") !== served;
    }
    paint();
    return {
      decide,
      load: async () => { if (served && (await synchronised())) paint(); },
      undo: takeBack,
      // Where two actions meet, one frame belongs to both: a label that was chosen stays chosen.
      at: (frame, label) => {
        if (label !== undefined) chosen = { frame, label };
        current = chosen?.frame === frame ? chosen.label : Math.max(0, firsts.findLastIndex((first) => frame >= first));
        paint();
      },
      step: (way) => choose(current + way),
      onJump: (call) => { go = call; },
    };
  }
})();
