// Unpacks what scene_data.py packed, and the vectors and matrices that the scene needs.

async function unpacked(header, data) {
  const deflated = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = await new Response(stream).arrayBuffer();
  const arrays = {};
  for (const [name, [kind, offset, length, width]] of Object.entries(header.arrays)) {
    if (kind === "words") arrays[name] = new Uint32Array(content, offset, length / 4);
    else if (kind === "bytes") arrays[name] = new Uint8Array(content, offset, length);
    else arrays[name] = integers(new Uint8Array(content, offset, length));
    if (kind === "differences") {
      const values = arrays[name];
      for (let k = width; k < values.length; k++) values[k] += values[k - width];
    }
  }
  // Points [m] of one step out of integers.
  const points = (name, first, count, into = new Float32Array(3 * count)) => {
    const values = arrays[name], { grain, origin } = header;
    for (let k = 0; k < 3 * count; k++) into[k] = grain * values[3 * first + k] + origin[k % 3];
    return into;
  };
  return { header, arrays, points };
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
  // A unit vector across this one, and the third of the three.
  across: (a) => {
    const first = V.unit(V.cross(a, Math.abs(a[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    return [first, V.cross(a, first)];
  },
};

// Column-major from rows, as WebGL wants it.
const columns = (rows) => new Float32Array([0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column])));

// Depth to -1..1 between near and far, and the distance that is divided by.
const depthRows = (eye, back, near, far) => [
  [...V.scale(back, (far + near) / (near - far)),
    -V.dot(back, eye) * (far + near) / (near - far) + 2 * far * near / (near - far)],
  [...V.scale(back, -1), V.dot(back, eye)],
];

// Projection times view of an eye that looks backwards along `back`.
function clipFromEye({ eye, right, above, back, fieldOfView }, aspect, near, far) {
  const f = 1 / Math.tan(fieldOfView / 2);
  return columns([
    [...V.scale(right, f / aspect), -V.dot(right, eye) * f / aspect],
    [...V.scale(above, f), -V.dot(above, eye) * f],
    ...depthRows(eye, back, near, far),
  ]);
}

// The same of a real camera, its picture as large as the canvas allows.
function clipFromCamera(camera, width, height, near, far) {
  const { eye, right, down, forward, focal, center, size } = camera;
  const scale = Math.min(width / size[0], height / size[1]);
  // Pixel centers lie at integers: the middle of the picture is at half its size, less a half.
  const row = (axis, side, which, sign) => {
    const f = sign * 2 * scale * focal[which] / side;
    const shift = sign * 2 * scale * (center[which] + 0.5 - size[which] / 2) / side;
    const local = V.add(V.scale(axis, f), forward, shift);
    return [...local, -V.dot(local, eye)];
  };
  return columns([row(right, width, 0, 1), row(down, height, 1, -1),
    ...depthRows(eye, V.scale(forward, -1), near, far)]);
}

// Straight down along `up` onto a square of the plane through `middle`; 0 is high, 1 is low.
function clipFromAbove(middle, [first, second, up], half, low, high) {
  const rise = -2 / (high - low), center = V.dot(up, middle) + (high + low) / 2;
  return columns([
    [...V.scale(first, 1 / half), -V.dot(first, middle) / half],
    [...V.scale(second, 1 / half), -V.dot(second, middle) / half],
    [...V.scale(up, rise), -rise * center],
    [0, 0, 0, 1],
  ]);
}

// Where a point is on the screen: -1..1, and its distance in the last number; null behind the eye.
function onScreen(clip, p) {
  const row = (k) => clip[k] * p[0] + clip[4 + k] * p[1] + clip[8 + k] * p[2] + clip[12 + k];
  const w = row(3);
  return w > 1e-6 ? [row(0) / w, row(1) / w, w] : null;
}
