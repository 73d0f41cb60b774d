// The scene in three dimensions: draws what scene_data.py packed, from where scene_view.js looks.

const MODES = { sides: 0, visible: 1, film: 3 };
const MAP_SIDE = 256;

async function openScene(card) {
  const canvas = card.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
  if (!gl) {
    card.querySelector(".no-webgl").hidden = false;
    return null;
  }
  const inside = (name) => card.querySelector(name).textContent;
  const scene = await unpacked(JSON.parse(inside(".scene-header")), inside(".scene-data"));
  const { header, arrays, points } = scene, palette = header.palette;
  const programs = Object.fromEntries(Object.entries({ cloth: CLOTH, lines: LINES, ribbon: RIBBON, dots: DOTS, table: TABLE, above: ABOVE, shade: SHADE })
    .map(([name, sources]) => [name, program(gl, sources)]));
  const cloth = clothOf(scene), buffers = {};
  const fill = (name, data, target = gl.ARRAY_BUFFER) => {
    buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(target, buffers[name]);
    gl.bufferData(target, data, gl.DYNAMIC_DRAW);
  };
  fill("square", new Float32Array([-1, -1, 0, 1, -1, 0, -1, 1, 0, 1, 1, 0]));
  fill("edges", cloth.edges, gl.ELEMENT_ARRAY_BUFFER);
  fill("solid.film", cloth.solid.film);
  const state = { step: 0, mode: "sides", opacity: 1, gap: 0, cloud: true, lines: false, path: true, hovered: null };
  const shift = () => V.scale(header.along, state.gap);
  let waiting = false, held = "", shaded = "", solidRims = 0, kept = null;
  const changed = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  const starts = header.counts.reduce((sums, count) => [...sums, sums[sums.length - 1] + count], [0]);
  const whole = pointsOfAll(scene, starts);
  const view = orbit(header, canvas, () => (state.gap ? lifted(cloth, shift()) : whole), changed);
  // The light falls from the side, so that folds show, and stays there when the eye moves.
  const LAMP = V.add(V.scale(header.up, 0.75), V.unit(V.add(V.scale(header.forward, 0.4), V.cross(header.up, header.forward))), 0.62);
  const paths = pathsOf(header), frames = frustumsOf(header, 2 * Math.hypot(...V.add([...whole.subarray(0, 3)], middleOf(whole), -1)));
  const light = skyMap(gl, header);

  function upload() {
    const wanted = `${state.step} ${state.mode}`;
    if (wanted === held) return;
    held = wanted;
    shaded = "";
    cloth.move(state.step, state.mode);
    for (const name of ["positions", "normals", "values", "seen", "ranks"]) fill(`solid.${name}`, cloth.solid[name]);
    for (const [name, data] of Object.entries(cloth.rims())) fill(`rims.${name}`, data);
    solidRims = cloth.rims().side.length;
    fill("positions", cloth.positions);
    fill("ranks", cloth.ranks);
    if (header.counts.length) {
      fill("cloud", points("cloud", starts[state.step], header.counts[state.step]));
      fill("cloud.tint", tintsOf(scene, starts[state.step], header.counts[state.step]));
    }
  }

  // What the light needs: heights seen from above, and how much of the sky each place sees.
  function shade() {
    const wanted = `${held} ${state.gap}`;
    if (!header.table || !cloth.faces.length || wanted === shaded) return;
    shaded = wanted;
    light.frame(cloth, shift());
    light.above(programs.above, () => {
      programs.above.feed("position", buffers["solid.positions"], 3);
      programs.above.feed("rank", buffers["solid.ranks"]);
      programs.above.set({ along: header.along, gap: state.gap });
      gl.drawArrays(gl.TRIANGLES, 0, cloth.faces.length);
    });
    light.below(programs.shade, () => {
      programs.shade.feed("position", buffers.square, 3);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
  }

  function draw() {
    const began = performance.now(), ratio = window.devicePixelRatio || 1;
    upload();
    shade();
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    const paper = getComputedStyle(card).backgroundColor.match(/[\d.]+/g).map(Number);
    gl.clearColor(paper[0] / 255, paper[1] / 255, paper[2] / 255, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const looked = { ...view.look(width, height), width, height, ratio };
    if (header.table) drawTable(looked);
    if (cloth.faces.length) drawCloth(looked);
    drawPoints(looked);
    if (state.path) drawRibbons(looked);
    Object.assign(canvas.dataset, { step: state.step, mode: state.mode, camera: view.camera() ?? "free", ms: (performance.now() - began).toFixed(1) });
  }

  function drawCloth({ eye, clip }) {
    const apart = { clip, along: header.along, gap: state.gap }, solid = state.opacity > 0.99;
    const painted = programs.cloth;
    painted.use();
    painted.set({
      ...apart, ...light.uniforms(), eye, lamp: LAMP, opacity: state.opacity, mode: MODES[state.mode] ?? 2,
      half_thickness: solid ? header.thickness / 2 : 0, outside: palette.outside, inside: palette.inside,
      hidden: palette.hidden, unknown: palette.unknown, stops: palette.heat.flat(),
    });
    const feed = (part) => {
      for (const name of ["position", "normal", "film"]) painted.feed(name, buffers[`${part}.${name === "film" ? name : `${name}s`}`], 3);
      painted.feed("value", buffers[`${part}.values`]);
      painted.feed("seen", buffers[`${part}.seen`]);
      painted.feed("rank", buffers[`${part}.ranks`]);
    };
    feed("solid");
    if (solid) {
      gl.enable(gl.CULL_FACE);
      for (const [side, cull] of [[1, gl.BACK], [-1, gl.FRONT]]) {
        gl.cullFace(cull);
        painted.feed("side", side);
        gl.drawArrays(gl.TRIANGLES, 0, cloth.faces.length);
      }
      gl.disable(gl.CULL_FACE);
      if (solidRims) {
        feed("rims");
        painted.feed("side", buffers["rims.side"]);
        painted.set({ half_thickness: 1e-9 });
        gl.drawArrays(gl.TRIANGLES, 0, solidRims);
      }
    } else {
      painted.feed("side", 1);
      gl.depthMask(false);
      fill("sorted", cloth.farFirst(eye, shift()), gl.ELEMENT_ARRAY_BUFFER);
      gl.drawElements(gl.TRIANGLES, cloth.faces.length, gl.UNSIGNED_INT, 0);
    }
    if (state.lines) {
      programs.lines.use();
      programs.lines.feed("position", buffers.positions, 3);
      programs.lines.feed("rank", buffers.ranks);
      programs.lines.set({ ...apart, eye, lift: header.thickness, paint: palette.ink, opacity: 0.22 * state.opacity });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.edges);
      gl.drawElements(gl.LINES, cloth.edges.length, gl.UNSIGNED_INT, 0);
    }
    gl.depthMask(true);
  }

  function drawPoints({ eye, clip, pixels, ratio }) {
    const dots = programs.dots;
    dots.use();
    const count = header.counts[state.step] ?? 0;
    if (state.cloud && count) {
      dots.feed("position", buffers.cloud, 3);
      dots.feed("tint", header.cloudColors.length ? buffers["cloud.tint"] : palette.observed, 3);
      dots.set({ clip, eye, pixels, lift: header.thickness, least: 1.5 * ratio, size: header.pointSize, opacity: 1, round: 0 });
      gl.drawArrays(gl.POINTS, 0, count);
    }
    const ball = (place, size, tint, lift) => {
      fill("ball", new Float32Array(place));
      dots.feed("position", buffers.ball, 3);
      dots.feed("tint", tint);
      dots.set({ clip, eye, pixels, lift, least: 5 * ratio, size, opacity: 1, round: 1 });
      gl.drawArrays(gl.POINTS, 0, 1);
    };
    for (const picker of header.pickers) {
      ball(picker.tips[state.step], 2 * header.pickerRadius, picker.closed[state.step] ? palette.closed : palette.open, 0);
    }
    if (state.hovered !== null && state.hovered < header.vertices) ball(placeOf(state.hovered), 0.004, palette.ink, 0.004);
  }

  const placeOf = (vertex) => V.add([...cloth.positions.subarray(3 * vertex, 3 * vertex + 3)], shift(), cloth.ranks[vertex]);

  // Where the pickers go, faint where they have not been yet, and where the cameras stand.
  function drawRibbons({ clip, width, height, ratio }) {
    const ribbon = programs.ribbon;
    ribbon.use();
    ribbon.set({ clip, screen: [width / 2, height / 2] });
    const drawn = (pairs, paint, opacity, wide) => {
      if (!pairs.length) return;
      const { position, other, away } = ribbonOf(pairs);
      fill("ribbon.position", position);
      fill("ribbon.other", other);
      fill("ribbon.away", away);
      ribbon.feed("position", buffers["ribbon.position"], 3);
      ribbon.feed("other", buffers["ribbon.other"], 3);
      ribbon.feed("away", buffers["ribbon.away"]);
      ribbon.set({ paint, opacity, width: wide * ratio });
      gl.drawArrays(gl.TRIANGLES, 0, away.length);
    };
    for (const path of paths) {
      for (const closed of [false, true]) {
        const parts = path.filter((one) => one.closed === closed), paint = closed ? palette.closed : palette.open;
        drawn(parts.filter((one) => one.step <= state.step), paint, 0.95, 1.4);
        drawn(parts.filter((one) => one.step > state.step), paint, 0.3, 1);
      }
    }
    frames.forEach((frustum, k) => { if (k !== view.camera()) drawn(frustum, palette.unknown, 0.9, 1); });
  }

  function drawTable({ clip, distance }) {
    const [point, normal] = header.table, [first, second] = V.across(normal);
    const center = V.add(header.origin, normal, V.dot(V.add(point, header.origin, -1), normal) - 5e-4);
    programs.table.use();
    programs.table.feed("position", buffers.square, 3);
    programs.table.set({ ...light.uniforms(), clip, center, first_axis: first, second_axis: second, side: 1.6 * distance, paint: palette.table });
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.depthMask(true);
  }

  // Layers apart need more room: the view makes it, and gives it back afterwards.
  function set(values) {
    const gap = state.gap;
    Object.assign(state, values);
    if (values.step !== undefined || values.mode !== undefined) upload();
    if (values.gap !== undefined && values.gap !== gap) {
      if (!gap) kept = view.place();
      if (state.gap) view.fit();
      else if (kept) view.set(kept);
    }
    changed();
  }

  new ResizeObserver(() => { if (!view.moved()) view.fit(); changed(); }).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  view.fit();
  changed();
  return {
    frames: header.frames,
    // The same cloth at other frames, as many as before.
    renew: (other) => {
      Object.assign(header, other.header);
      Object.assign(arrays, other.arrays);
      held = "";
      changed();
    },
    header, canvas, cloth, arrays, state, set, draw,
    from: view.from,
    // The vertex under a place of the canvas [CSS pixels]; null where there is no cloth.
    vertexAt: (x, y) => {
      const { clientWidth, clientHeight } = canvas, { clip } = view.look(clientWidth, clientHeight);
      return cloth.faces.length ? cloth.under(clip, [2 * x / clientWidth - 1, 1 - 2 * y / clientHeight], shift()) : null;
    },
  };
}
