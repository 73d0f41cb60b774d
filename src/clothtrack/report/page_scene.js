// The scene in three dimensions: unpacks what scene_data.py packed, draws it, lets one orbit it.

async function unpacked(card) {
  const header = JSON.parse(card.querySelector(".scene-header").textContent);
  const text = atob(card.querySelector(".scene-data").textContent);
  const deflated = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = await new Response(stream).arrayBuffer();
  const arrays = {};
  for (const [name, [kind, offset, length]] of Object.entries(header.arrays)) {
    if (kind === "words") arrays[name] = new Uint32Array(content, offset, length / 4);
    else if (kind === "bytes") arrays[name] = new Uint8Array(content, offset, length);
    else arrays[name] = integers(new Uint8Array(content, offset, length));
    if (kind === "differences") {
      const values = arrays[name], width = 3 * header.vertices;
      for (let k = width; k < values.length; k++) values[k] += values[k - width];
    }
  }
  return { header, arrays };
}

function integers(halves) {
  const count = halves.length / 2, values = new Int16Array(count);
  for (let k = 0; k < count; k++) values[k] = halves[k] | (halves[count + k] << 8);
  return values;
}

const V = {
  add: (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  scale: (a, s) => [s * a[0], s * a[1], s * a[2]],
  unit: (a) => V.scale(a, 1 / (Math.hypot(...a) || 1)),
};

// Column-major projection times view of an eye that looks at a target.
function clipFromWorld(eye, target, up, fieldOfView, aspect, near, far) {
  const back = V.unit(V.add(eye, target, -1)), right = V.unit(V.cross(up, back));
  const above = V.cross(back, right), f = 1 / Math.tan(fieldOfView / 2);
  const rows = [
    [...V.scale(right, f / aspect), -V.dot(right, eye) * f / aspect],
    [...V.scale(above, f), -V.dot(above, eye) * f],
    [...V.scale(back, (far + near) / (near - far)),
      -V.dot(back, eye) * (far + near) / (near - far) + 2 * far * near / (near - far)],
    [...V.scale(back, -1), V.dot(back, eye)],
  ];
  return new Float32Array([0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column])));
}

const APART = `
in float rank;
uniform mat4 clip; uniform vec3 along; uniform float gap;
vec3 apart(vec3 p) { return p + along * (gap * rank); }`;

const CLOTH = [`#version 300 es
in vec3 position, normal; in float value, seen;
out vec3 at, across; out float grade, known, shown;
${APART}
void main() {
  at = apart(position);
  across = normal;
  known = value > 254.5 ? 0.0 : 1.0;
  grade = known * value / 254.0;
  shown = seen;
  gl_Position = clip * vec4(at, 1.0);
}`, `#version 300 es
precision highp float;
in vec3 at, across; in float grade, known, shown;
uniform vec3 eye, up, outside, inside, hidden, unknown, stops[6];
uniform int mode; uniform float opacity;
out vec4 color;
vec3 heat(float share) {
  float place = clamp(share, 0.0, 1.0) * 5.0;
  int first = int(min(floor(place), 4.0));
  return mix(stops[first], stops[first + 1], place - float(first));
}
void main() {
  vec3 n = normalize(across), view = normalize(eye - at);
  if (!gl_FrontFacing) n = -n;
  vec3 paint = mode == 0 ? (gl_FrontFacing ? outside : inside)
    : mode == 1 ? mix(hidden, outside, step(0.5, shown))
    : known > 0.99 ? heat(grade) : unknown;
  float light = max(dot(n, normalize(view + 0.7 * up)), 0.0);
  color = vec4(paint * (0.42 + 0.66 * light), opacity);
}`];

const LINES = [`#version 300 es
in vec3 position;
${APART}
void main() { gl_Position = clip * vec4(apart(position), 1.0); }`, `#version 300 es
precision highp float;
uniform vec3 paint; uniform float opacity;
out vec4 color;
void main() { color = vec4(paint, opacity); }`];

const DOTS = [`#version 300 es
in vec3 position;
uniform mat4 clip; uniform float size, pixels;
void main() {
  gl_Position = clip * vec4(position, 1.0);
  gl_PointSize = max(1.5, size * pixels / gl_Position.w);
}`, `#version 300 es
precision highp float;
uniform vec3 paint; uniform float opacity, round;
out vec4 color;
void main() {
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float outer = dot(p, p);
  if (outer > 1.0) discard;
  color = vec4(paint * mix(1.0, 0.55 + 0.45 * sqrt(1.0 - outer), round), opacity);
}`];

const TABLE = [`#version 300 es
in vec3 position;
uniform mat4 clip; uniform vec3 middle, first, second; uniform float side;
out vec2 place;
void main() {
  place = side * position.xy;
  gl_Position = clip * vec4(middle + place.x * first + place.y * second, 1.0);
}`, `#version 300 es
precision highp float;
in vec2 place;
uniform vec3 paint; uniform float side;
out vec4 color;
void main() {
  vec2 cells = place / 0.1;
  vec2 near = abs(fract(cells - 0.5) - 0.5) / max(fwidth(cells), vec2(1e-6));
  float line = 1.0 - clamp(min(near.x, near.y), 0.0, 1.0);
  float fade = 1.0 - smoothstep(0.55, 1.0, length(place) / side);
  color = vec4(paint * (1.0 - 0.22 * line), 0.75 * fade);
}`];

function program(gl, [vertex, fragment]) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(made, name));
    return places.get(name);
  };
  return {
    use: () => gl.useProgram(made),
    set: (values) => {
      for (const [name, value] of Object.entries(values)) {
        if (name === "mode") gl.uniform1i(at(name), value);
        else if (typeof value === "number") gl.uniform1f(at(name), value);
        else if (value.length === 16) gl.uniformMatrix4fv(at(name), false, value);
        else gl.uniform3fv(at(name), value);
      }
    },
    feed: (name, buffer, width) => {
      const place = gl.getAttribLocation(made, name);
      if (place < 0) return;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    },
  };
}

// The cloth at one step as arrays of numbers: positions, normals, values, visibility.
function clothOf({ header, arrays }) {
  const count = header.vertices, faces = arrays.faces;
  const positions = new Float32Array(3 * count), normals = new Float32Array(3 * count);
  const values = new Float32Array(count), seen = new Float32Array(count).fill(1), ranks = new Float32Array(count);
  const move = (step, key) => {
    const from = 3 * count * step;
    for (let k = 0; k < 3 * count; k++) {
      positions[k] = header.grain * arrays.positions[from + k] + header.origin[k % 3];
    }
    normals.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const corners = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const [a, b, c] = corners.map((k) => positions.subarray(k, k + 3));
      const n = V.cross(V.add(b, a, -1), V.add(c, a, -1));
      for (const k of corners) for (let axis = 0; axis < 3; axis++) normals[k + axis] += n[axis];
    }
    const graded = arrays[`color ${key}`];
    for (let k = 0; k < count; k++) {
      const bit = count * step + k;
      values[k] = graded ? graded[bit] : 255;
      ranks[k] = arrays.ranks[bit] / 16;
      if (arrays.visible) seen[k] = (arrays.visible[bit >> 3] >> (bit & 7)) & 1;
    }
  };
  const edges = [...new Set(Array.from(faces, (corner, k) => {
    const next = faces[k % 3 === 2 ? k - 2 : k + 1];
    return Math.min(corner, next) * count + Math.max(corner, next);
  }))].flatMap((pair) => [Math.floor(pair / count), pair % count]);
  // Far triangles first, so that what shines through does so in the right order.
  const order = new Uint32Array(faces.length / 3), depths = new Float32Array(order.length);
  const sorted = new Uint32Array(faces.length);
  const farFirst = (eye, shift) => {
    for (let f = 0; f < order.length; f++) {
      order[f] = f;
      depths[f] = 0;
      const rank = ranks[faces[3 * f]];
      for (let axis = 0; axis < 3; axis++) {
        const sum = positions[3 * faces[3 * f] + axis] + positions[3 * faces[3 * f + 1] + axis]
          + positions[3 * faces[3 * f + 2] + axis];
        depths[f] += (sum / 3 + rank * shift[axis] - eye[axis]) ** 2;
      }
    }
    order.sort((a, b) => depths[b] - depths[a]);
    order.forEach((f, k) => sorted.set(faces.subarray(3 * f, 3 * f + 3), 3 * k));
    return sorted;
  };
  return { positions, normals, values, seen, ranks, edges: new Uint32Array(edges), faces, move, farFirst };
}

// Where the eye is: it orbits a target about the upward direction.
function orbit(header, canvas, changed) {
  const up = header.up;
  const toTarget = V.dot(V.add(header.origin, header.eye, -1), header.forward);
  const start = { target: V.add(header.eye, header.forward, toTarget), distance: toTarget };
  const side = V.unit(V.cross(Math.abs(V.dot(header.forward, up)) < 0.999 ? header.forward : [1, 0.1, 0], up));
  const front = V.cross(up, side);
  start.height = Math.asin(Math.min(1, Math.max(-1, -V.dot(header.forward, up))));
  start.turn = 0;
  const state = { ...start };
  const direction = () => {
    const flat = V.add(V.scale(front, -Math.cos(state.turn)), side, Math.sin(state.turn));
    return V.add(V.scale(flat, Math.cos(state.height)), up, Math.sin(state.height));
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const [dx, dy] = [event.movementX, event.movementY].map((move) => move / canvas.clientHeight);
    if (event.buttons & 1 && !event.shiftKey) {
      state.turn -= 4 * dx;
      state.height = Math.min(1.55, Math.max(-1.55, state.height + 4 * dy));
    } else {
      const back = direction(), right = V.unit(V.cross(up, back)), above = V.cross(back, right);
      state.target = V.add(V.add(state.target, right, -dx * state.distance), above, dy * state.distance);
    }
    changed();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.distance *= Math.exp(0.001 * event.deltaY);
    changed();
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  const home = () => { Object.assign(state, start); };
  canvas.addEventListener("dblclick", () => { home(); changed(); });
  // What the pointer does, for those who have none; the arrows alone go from frame to frame.
  const tilt = (by) => { state.height = Math.min(1.55, Math.max(-1.55, state.height + by)); };
  const keys = {
    ArrowLeft: () => { state.turn += 0.12; },
    ArrowRight: () => { state.turn -= 0.12; },
    ArrowUp: () => tilt(0.12),
    ArrowDown: () => tilt(-0.12),
    "+": () => { state.distance /= 1.1; },
    "-": () => { state.distance *= 1.1; },
    "0": home,
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
    if (event.key.startsWith("Arrow") && !event.shiftKey) return;
    event.preventDefault();
    event.stopPropagation();
    keys[event.key]();
    changed();
  });
  return {
    eye: () => V.add(state.target, direction(), state.distance),
    target: () => state.target,
    distance: () => state.distance,
  };
}

async function openScene(card) {
  const canvas = card.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
  if (!gl) {
    card.querySelector(".no-webgl").hidden = false;
    return null;
  }
  const scene = await unpacked(card), { header, arrays } = scene, palette = header.palette;
  const programs = { cloth: program(gl, CLOTH), lines: program(gl, LINES), dots: program(gl, DOTS), table: program(gl, TABLE) };
  const cloth = clothOf(scene);
  const buffers = Object.fromEntries(["positions", "normals", "values", "seen", "ranks", "cloud", "tip", "corners", "faces", "edges"]
    .map((name) => [name, gl.createBuffer()]));
  const fill = (name, data, target = gl.ARRAY_BUFFER) => {
    gl.bindBuffer(target, buffers[name]);
    gl.bufferData(target, data, gl.DYNAMIC_DRAW);
  };
  fill("corners", new Float32Array([-1, -1, 0, 1, -1, 0, -1, 1, 0, 1, 1, 0]));
  fill("edges", cloth.edges, gl.ELEMENT_ARRAY_BUFFER);
  const state = { step: 0, mode: "sides", opacity: 1, gap: 0, cloud: true, lines: true };
  let waiting = false;
  const changed = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  const view = orbit(header, canvas, changed);
  const starts = header.counts.reduce((sums, count) => [...sums, sums[sums.length - 1] + count], [0]);
  const cloudAt = (step) => {
    const from = 3 * starts[step], points = new Float32Array(3 * header.counts[step]);
    for (let k = 0; k < points.length; k++) points[k] = header.grain * arrays.cloud[from + k] + header.origin[k % 3];
    return points;
  };
  let held = "";
  function upload() {
    const wanted = `${state.step} ${state.mode}`;
    if (wanted === held) return;
    held = wanted;
    cloth.move(state.step, state.mode);
    for (const name of ["positions", "normals", "values", "seen", "ranks"]) fill(name, cloth[name]);
    if (header.counts.length) fill("cloud", cloudAt(state.step));
  }

  function draw() {
    const began = performance.now();
    upload();
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    const paper = getComputedStyle(card).backgroundColor.match(/[\d.]+/g).map(Number);
    gl.clearColor(paper[0] / 255, paper[1] / 255, paper[2] / 255, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const eye = view.eye(), far = 20 * view.distance();
    const clip = clipFromWorld(eye, view.target(), header.up, header.fieldOfView, width / height, view.distance() / 50, far);
    const apart = { clip, along: header.along, gap: state.gap };
    const solid = state.opacity > 0.99;
    gl.depthMask(false);
    if (header.table) drawTable(clip);
    gl.depthMask(solid);
    if (cloth.faces.length) {
      const faces = solid ? cloth.faces : cloth.farFirst(eye, V.scale(header.along, state.gap));
      fill("faces", faces, gl.ELEMENT_ARRAY_BUFFER);
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
      const { cloth: painted } = programs;
      painted.use();
      painted.feed("position", buffers.positions, 3);
      painted.feed("normal", buffers.normals, 3);
      painted.feed("value", buffers.values, 1);
      painted.feed("seen", buffers.seen, 1);
      painted.feed("rank", buffers.ranks, 1);
      painted.set({
        ...apart, eye, up: header.up, opacity: state.opacity, mode: { sides: 0, visible: 1 }[state.mode] ?? 2,
        outside: palette.outside, inside: palette.inside, hidden: palette.hidden, unknown: palette.unknown,
        stops: palette.heat.flat(),
      });
      gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
      gl.disable(gl.POLYGON_OFFSET_FILL);
      if (state.lines) {
        programs.lines.use();
        programs.lines.feed("position", buffers.positions, 3);
        programs.lines.feed("rank", buffers.ranks, 1);
        programs.lines.set({ ...apart, paint: palette.ink, opacity: 0.16 * state.opacity });
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.edges);
        gl.drawElements(gl.LINES, cloth.edges.length, gl.UNSIGNED_INT, 0);
      }
    }
    gl.depthMask(true);
    programs.dots.use();
    const pixels = height / Math.tan(header.fieldOfView / 2) / 2;
    if (state.cloud && header.counts.length && header.counts[state.step]) {
      programs.dots.feed("position", buffers.cloud, 3);
      programs.dots.set({ clip, pixels, size: header.pointSize, paint: palette.observed, opacity: 1, round: 0 });
      gl.drawArrays(gl.POINTS, 0, header.counts[state.step]);
    }
    for (const picker of header.pickers) {
      fill("tip", new Float32Array(picker.tips[state.step]));
      programs.dots.feed("position", buffers.tip, 3);
      const paint = picker.closed[state.step] ? palette.closed : palette.open;
      programs.dots.set({ clip, pixels, size: 2 * header.pickerRadius, paint, opacity: 1, round: 1 });
      gl.drawArrays(gl.POINTS, 0, 1);
    }
    Object.assign(canvas.dataset, { step: state.step, mode: state.mode, ms: (performance.now() - began).toFixed(1) });
  }

  function drawTable(clip) {
    const [point, normal] = header.table;
    const first = V.unit(V.cross(normal, Math.abs(normal[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    const middle = V.add(header.origin, normal, V.dot(V.add(point, header.origin, -1), normal) - 5e-4);
    programs.table.use();
    programs.table.feed("position", buffers.corners, 3);
    programs.table.set({ clip, middle, first, second: V.cross(normal, first), side: 1.6 * view.distance(), paint: palette.table });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  new ResizeObserver(changed).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  changed();
  return {
    frames: header.frames,
    colorings: header.colorings,
    set: (values) => { Object.assign(state, values); changed(); },
  };
}
