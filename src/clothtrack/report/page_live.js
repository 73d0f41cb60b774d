// A served page asks its server every second whether there is a newer one, and loads that.
(() => {
  const shown = Number(document.body.dataset.version);
  const ask = async () => {
    try {
      const { version } = await (await fetch("version")).json();
      if ((version ?? shown) !== shown) {
        location.reload();
        return;
      }
    } catch {
      // The server has ended: what is shown stays, until it serves again.
    }
    setTimeout(ask, 1000);
  };
  setTimeout(ask, 1000);
})();
