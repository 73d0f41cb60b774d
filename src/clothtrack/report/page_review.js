// Decisions about labels: a served page sends each to its server, which saves it; one that was
// opened from a disk cannot write files beside the trajectory, so it offers one.
function reviewed(section, inTurn) {
  if (!section) return { at: () => {}, decide: () => {}, undo: () => {}, step: () => {}, onJump: () => {}, load: () => {} };
  const review = JSON.parse(section.dataset.review), rows = [...section.querySelectorAll("[data-action]")];
  const firsts = rows.map((row) => Number(row.dataset.first)), undo = section.querySelector("#undo"), past = [];
  const served = document.body.dataset.version !== undefined, state = section.querySelector("#saved");
  // The same label on the time bar and at the top of the page.
  const twins = rows.map((_, k) => [...document.querySelectorAll(`[data-mark="${k}"]`)]);
  let current = 0, chosen = null, go = () => {};
  // Whether the server took this, or told the decisions so far; the page then shows what it has.
  const synchronized = async (message) => {
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
    if (served) return synchronized({ action: which, verdict });
    review.labels[which].verdict = verdict;
    return true;
  };
  const paint = () => {
    rows.forEach((row, k) => {
      for (const one of [row, ...twins[k]]) {
        one.dataset.verdict = review.labels[k].verdict;
        one.classList.toggle("current", k === current);
        const word = one.querySelector(".verdict, .decided");
        if (word) word.textContent = review.labels[k].verdict;
      }
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
    for (const one of [row.querySelector(".jump"), ...twins[k]]) {
      one.addEventListener("click", () => inTurn(() => choose(k)));
    }
    for (const button of row.querySelectorAll("[data-decide]")) {
      button.addEventListener("click", () => inTurn(() => decide(button.dataset.decide, k)));
    }
  });
  section.querySelector("#save").addEventListener("click", () => {
    download(new Blob([JSON.stringify(review, null, 2) + "\n"], { type: "application/json" }), section.dataset.file);
  });
  for (const part of section.querySelectorAll("[data-when]")) {
    part.hidden = (part.dataset.when === "served") !== served;
  }
  paint();
  return {
    decide,
    load: async () => { if (served && (await synchronized())) paint(); },
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

function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
