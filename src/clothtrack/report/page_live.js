// A served page asks its server every second whether there is a newer one, and loads that. A page
// that is watched while it grows asks more often, and shows the newest mesh in its scene.
(() => {
  const shown = Number(document.body.dataset.version), words = document.querySelector(".growing");
  let known = 0, over = false;
  const grow = async () => {
    const { scene } = document.querySelector(".scene") ?? {};
    const newest = await (await fetch(`now?after=${scene ? known : -1}`)).json();
    words.textContent = newest.words;
    ({ over } = newest);
    if (!scene || !newest.data) return;
    known = newest.known;
    scene.renew(await unpacked(JSON.parse(newest.header), newest.data));
    document.body.dataset.frame = newest.frame;
  };
  const ask = async () => {
    try {
      const { version } = await (await fetch("version")).json();
      if ((version ?? shown) !== shown) {
        location.reload();
        return;
      }
      if (words) await grow();
    } catch {
      // The server has ended: what is shown stays, until it serves again.
      if (words && !over) words.textContent = "The tracking has stopped; this is the last mesh.";
    }
    if (!over) setTimeout(ask, words ? 400 : 1000);
  };
  setTimeout(ask, words ? 400 : 1000);
})();
