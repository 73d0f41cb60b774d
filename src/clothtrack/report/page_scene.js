// What one can do with the scene: colors, views, layers apart, what lies under the pointer, files.

function sceneControls(card, scene) {
  const find = (selector) => card.querySelector(selector), canvas = scene.canvas;
  const note = find(".controls .note"), mode = find("[name=mode]"), view = find("[name=view]");
  const recolor = () => {
    if (!mode) return;
    scene.set({ mode: mode.value });
    note.textContent = mode.selectedOptions[0]?.dataset.note ?? "";
    find(".meaning").innerHTML = find(`template[data-mode="${mode.value}"]`)?.innerHTML ?? "";
  };
  mode?.addEventListener("change", recolor);
  view?.addEventListener("change", () => scene.from(view.value === "" ? null : Number(view.value)));
  canvas.addEventListener("freed", () => { if (view) view.value = ""; });
  for (const input of card.querySelectorAll("input[type=range]")) {
    input.addEventListener("input", () => scene.set({ [input.name]: Number(input.value) }));
  }
  for (const input of card.querySelectorAll("input[type=checkbox]")) {
    input.addEventListener("change", () => scene.set({ [input.name]: input.checked }));
    scene.set({ [input.name]: input.checked });
  }
  find("#home").addEventListener("click", () => scene.from(null));
  const title = document.querySelector("h1").textContent.replace(/[^\w.-]+/g, "_");
  const named = (suffix) => `${title}_frame${scene.header.frames[scene.state.step]}.${suffix}`;
  find("#shot").addEventListener("click", () => {
    scene.draw();
    canvas.toBlob((blob) => download(blob, named("png")));
  });
  find("#ply")?.addEventListener("click", () => download(plyOf(scene), named("ply")));
  find("#full").addEventListener("click", () => {
    if (document.fullscreenElement) document.exitFullscreen();
    else card.requestFullscreen();
  });
  pointing(card, scene);
  recolor();
  return {
    // From the camera and back.
    turn: () => {
      if (!view) return;
      view.selectedIndex = (view.selectedIndex + 1) % view.options.length;
      view.dispatchEvent(new Event("change"));
    },
  };
}

// The vertex under the pointer, and what the page knows of it.
function pointing(card, scene) {
  const { canvas, header } = scene, told = card.querySelector(".hover");
  let where = null, waiting = false;
  const look = () => {
    waiting = false;
    const vertex = where === null ? null : scene.vertexAt(...where);
    if (vertex !== scene.state.hovered) scene.set({ hovered: vertex });
    told.hidden = vertex === null;
    if (vertex === null) return;
    told.replaceChildren(...wordsOf(scene, vertex).map((line) => Object.assign(document.createElement("div"), { textContent: line })));
    const [x, y] = where, right = x > canvas.clientWidth / 2;
    Object.assign(told.style, {
      left: right ? "auto" : `${x + 14}px`, right: right ? `${canvas.clientWidth - x + 14}px` : "auto",
      top: `${Math.max(4, Math.min(y - 10, canvas.clientHeight - told.offsetHeight - 4))}px`,
    });
  };
  const later = (place) => {
    where = place;
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(look);
  };
  canvas.addEventListener("pointermove", (event) => later(event.buttons ? null : [event.offsetX, event.offsetY]));
  canvas.addEventListener("pointerleave", () => later(null));
  // A finger does not hover: it taps.
  canvas.addEventListener("click", (event) => later([event.offsetX, event.offsetY]));
  if (!header.vertices) told.hidden = true;
}

function wordsOf({ header, arrays, cloth, state }, vertex) {
  const at = header.vertices * state.step + vertex, lines = [`vertex ${vertex}`];
  const layer = 1 + Math.round(cloth.ranks[vertex]);
  const seen = arrays.visible ? (cloth.seen[vertex] > 0.5 ? ", visible" : ", hidden: believed") : "";
  lines.push(`layer ${layer} from below${seen}`);
  for (const { key, title, limit } of header.colorings) {
    const value = arrays[`color ${key}`][at], [, name, unit] = title.match(/^(.*?)(?: \[(.*)\])?$/);
    if (value === 255) continue;
    const shown = (limit * value / 254).toFixed(limit < 20 ? 1 : 0);
    lines.push(`${name}: ${value === 254 ? `${limit} or more` : shown} ${unit ?? ""}`);
  }
  const place = [...cloth.positions.subarray(3 * vertex, 3 * vertex + 3)].map((one) => (1000 * one).toFixed(0));
  lines.push(`at ${place.join(", ")} mm`);
  return lines;
}

// The mesh of the shown frame with the colors that it has in the page, as binary PLY [m].
function plyOf({ header, arrays, cloth, state }) {
  const count = header.vertices, faces = cloth.faces, { palette } = header;
  const colorOf = (k) => {
    if (state.mode === "film") return [0, 1, 2].map((axis) => arrays.film[3 * k + axis] / 255);
    if (state.mode === "sides") return palette.outside;
    if (state.mode === "visible") return cloth.seen[k] > 0.5 ? palette.outside : palette.hidden;
    if (cloth.values[k] > 254.5) return palette.unknown;
    const place = cloth.values[k] / 254 * 5, first = Math.min(4, Math.floor(place));
    return V.add(palette.heat[first], V.add(palette.heat[first + 1], palette.heat[first], -1), place - first);
  };
  const text = ["ply", "format binary_little_endian 1.0", "comment clothtrack, meters", `element vertex ${count}`,
    ..."xyz".split("").map((axis) => `property float ${axis}`), ...["red", "green", "blue"].map((one) => `property uchar ${one}`),
    `element face ${faces.length / 3}`, "property list uchar int vertex_indices", "end_header", ""].join("\n");
  const body = new DataView(new ArrayBuffer(15 * count + 13 * faces.length / 3));
  for (let k = 0; k < count; k++) {
    for (let axis = 0; axis < 3; axis++) body.setFloat32(15 * k + 4 * axis, cloth.positions[3 * k + axis], true);
    colorOf(k).forEach((part, axis) => body.setUint8(15 * k + 12 + axis, Math.round(255 * Math.min(1, Math.max(0, part)))));
  }
  for (let f = 0; f < faces.length / 3; f++) {
    const from = 15 * count + 13 * f;
    body.setUint8(from, 3);
    for (let corner = 0; corner < 3; corner++) body.setInt32(from + 1 + 4 * corner, faces[3 * f + corner], true);
  }
  return new Blob([text, body.buffer], { type: "application/octet-stream" });
}
