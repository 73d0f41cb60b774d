// Where the eye is: free, on an orbit about a target, or where a camera of the recording stands.

function orbit(header, canvas, extent, changed) {
  const up = header.up, near = (value, low, high) => Math.min(high, Math.max(low, value));
  const side = V.unit(V.cross(Math.abs(V.dot(header.forward, up)) < 0.999 ? header.forward : [1, 0.1, 0], up));
  const front = V.cross(up, side), steepest = 1.5;
  // Angles of an eye that looks along `forward`, above it in the picture `above`.
  const angles = (forward, above) => {
    const height = Math.asin(near(-V.dot(forward, up), -1, 1));
    const level = Math.abs(V.dot(forward, up)) < 0.99 ? forward : V.scale(above, Math.sign(-V.dot(forward, up)) || 1);
    return { height: near(height, -steepest, steepest), turn: Math.atan2(-V.dot(level, side), V.dot(level, front)) };
  };
  const start = angles(header.forward, up);
  const state = { ...start, target: header.origin, distance: 1, camera: null };
  const direction = () => {
    const flat = V.add(V.scale(front, -Math.cos(state.turn)), side, Math.sin(state.turn));
    return V.add(V.scale(flat, Math.cos(state.height)), up, Math.sin(state.height));
  };
  const axes = () => {
    const back = direction(), right = V.unit(V.cross(up, back));
    return { back, right, above: V.cross(back, right) };
  };
  const aspect = () => canvas.clientWidth / Math.max(1, canvas.clientHeight);

  // Stand so far away that all points fill the picture, and look at their middle there.
  const fit = () => {
    const points = extent(), { back, right, above } = axes(), tan = Math.tan(header.fieldOfView / 2);
    state.target = middleOf(points);
    for (let round = 0; round < 3; round++) {
      let distance = 0.02;
      const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
      const far = round ? state.distance : Infinity;
      for (let k = 0; k < points.length; k += 3) {
        const p = [points[k] - state.target[0], points[k + 1] - state.target[1], points[k + 2] - state.target[2]];
        const [x, y, z] = [V.dot(p, right), V.dot(p, above), V.dot(p, back)];
        distance = Math.max(distance, z + Math.max(Math.abs(x) / aspect(), Math.abs(y)) / tan);
        [x, y].forEach((value, axis) => {
          const seen = value / Math.max(0.2, 1 - z / far);
          low[axis] = Math.min(low[axis], seen);
          high[axis] = Math.max(high[axis], seen);
        });
      }
      state.distance = 1.1 * distance;
      if (round < 2) state.target = V.add(V.add(state.target, right, (low[0] + high[0]) / 2), above, (low[1] + high[1]) / 2);
    }
  };

  let touched = false;
  const set = (values) => { Object.assign(state, values); changed(); };
  // Whoever moves the eye leaves the camera, from where it stood.
  const free = () => {
    touched = true;
    if (state.camera === null) return;
    const camera = header.views[state.camera], toTarget = V.dot(V.add(header.origin, camera.eye, -1), camera.forward);
    Object.assign(state, angles(camera.forward, V.scale(camera.down, -1)),
      { target: V.add(camera.eye, camera.forward, toTarget), distance: toTarget, camera: null });
    canvas.dispatchEvent(new CustomEvent("freed"));
  };
  const home = () => {
    free();
    Object.assign(state, start);
    touched = false;
    fit();
  };

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  const shift = (dx, dy) => {
    const { right, above } = axes();
    state.target = V.add(V.add(state.target, right, -dx * state.distance), above, dy * state.distance);
  };
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons || !fingers.has(event.pointerId)) return;
    const before = [...fingers.values()], last = fingers.get(event.pointerId);
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]].map((move) => move / canvas.clientHeight);
    if (dx === 0 && dy === 0) return;
    free();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (before.length === 2) {
      // Two fingers: what lies between them stays between them.
      const span = (two) => Math.hypot(two[0][0] - two[1][0], two[0][1] - two[1][1]);
      state.distance *= span(before) / Math.max(1, span([...fingers.values()]));
      shift(dx / 2, dy / 2);
    } else if (event.buttons & 1 && !event.shiftKey) {
      state.turn -= 4 * dx;
      state.height = near(state.height + 4 * dy, -steepest, steepest);
    } else shift(dx, dy);
    changed();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    free();
    state.distance *= Math.exp(0.001 * event.deltaY);
    changed();
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => { home(); changed(); });
  // What the pointer does, for those who have none; the arrows alone go from frame to frame.
  const tilt = (by) => { state.height = near(state.height + by, -steepest, steepest); };
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
    free();
    keys[event.key]();
    changed();
  });
  // Eye, direction and the matrix that puts the world on a canvas of this many pixels.
  const look = (width, height) => {
    const camera = state.camera === null ? null : header.views[state.camera];
    const eye = camera ? camera.eye : V.add(state.target, direction(), state.distance);
    const distance = camera ? V.dot(V.add(header.origin, eye, -1), camera.forward) : state.distance;
    const nearest = distance / 50, far = 20 * distance;
    const clip = camera ? clipFromCamera(camera, width, height, nearest, far)
      : clipFromEye({ eye, ...axes(), fieldOfView: header.fieldOfView }, width / height, nearest, far);
    const scale = camera ? 2 * camera.focal[1] * Math.min(width / camera.size[0], height / camera.size[1])
      : height / Math.tan(header.fieldOfView / 2);
    return { eye, clip, distance, pixels: scale / 2 };
  };
  return {
    look, set,
    fit: () => { if (state.camera !== null) free(); fit(); },
    from: (camera) => { if (camera === null) home(); set({ camera }); },
    camera: () => state.camera,
    place: () => ({ ...state }),
    moved: () => touched || state.camera !== null,
  };
}

// The middle of the box around points.
function middleOf(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  points.forEach((value, k) => {
    low[k % 3] = Math.min(low[k % 3], value);
    high[k % 3] = Math.max(high[k % 3], value);
  });
  return V.scale(V.add(low, high), 0.5);
}
