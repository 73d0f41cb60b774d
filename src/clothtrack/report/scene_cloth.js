// The cloth at one step as arrays of numbers, with what makes it look like cloth: normals that stay
// on their side of a seam, and hems that have a thickness.

// Triangles that meet at a sharper angle than this do not share a normal (cosine, 70 degrees).
const CREASE = 0.34;

// Normals of every corner of every triangle; `around` lists the triangles at each vertex.
function cornerNormals(faces, around, positions) {
  const count = faces.length / 3, areas = new Float32Array(faces.length), units = new Float32Array(faces.length);
  const normals = new Float32Array(3 * faces.length);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [3 * faces[3 * f], 3 * faces[3 * f + 1], 3 * faces[3 * f + 2]];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, s = 1 / (Math.hypot(x, y, z) || 1);
    areas.set([x, y, z], 3 * f);
    units.set([s * x, s * y, s * z], 3 * f);
  }
  for (let corner = 0; corner < faces.length; corner++) {
    const own = 3 * Math.floor(corner / 3), vertex = faces[corner];
    let x = 0, y = 0, z = 0;
    for (let k = around.starts[vertex]; k < around.starts[vertex + 1]; k++) {
      const f = 3 * around.faces[k];
      if (units[own] * units[f] + units[own + 1] * units[f + 1] + units[own + 2] * units[f + 2] < CREASE) continue;
      x += areas[f]; y += areas[f + 1]; z += areas[f + 2];
    }
    const s = 1 / (Math.hypot(x, y, z) || 1);
    normals.set([s * x, s * y, s * z], 3 * corner);
  }
  return normals;
}

function trianglesAround(faces, count) {
  const starts = new Uint32Array(count + 1);
  for (const vertex of faces) starts[vertex + 1]++;
  for (let k = 0; k < count; k++) starts[k + 1] += starts[k];
  const next = starts.slice(), found = new Uint32Array(faces.length);
  faces.forEach((vertex, corner) => { found[next[vertex]++] = Math.floor(corner / 3); });
  return { starts, faces: found };
}

// Every edge once: its two vertices, and the corners that hold them in the one or two triangles.
function edgesOf(faces, count) {
  const found = new Map();
  for (let corner = 0; corner < faces.length; corner++) {
    const next = corner % 3 === 2 ? corner - 2 : corner + 1;
    const [a, b] = [faces[corner], faces[next]], key = Math.min(a, b) * count + Math.max(a, b);
    const edge = found.get(key);
    if (!edge) found.set(key, { a, b, corners: [corner, next], others: null });
    else if (!edge.others) edge.others = faces[corner] === edge.a ? [corner, next] : [next, corner];
  }
  return [...found.values()];
}

function clothOf({ header, arrays, points }) {
  const count = header.vertices, faces = arrays.faces, corners = faces.length;
  const around = trianglesAround(faces, count), edges = edgesOf(faces, count);
  const cloth = {
    faces,
    positions: new Float32Array(3 * count),
    values: new Float32Array(count), seen: new Float32Array(count).fill(1), ranks: new Float32Array(count),
    edges: new Uint32Array(edges.flatMap(({ a, b }) => [a, b])),
    topRank: arrays.ranks.reduce((most, rank) => Math.max(most, rank), 0) / 16,
  };
  // What the graphics card gets: every corner by itself, and strips along hems and seams.
  const solid = { positions: new Float32Array(3 * corners), normals: null, values: new Float32Array(corners),
    seen: new Float32Array(corners), ranks: new Float32Array(corners), film: new Float32Array(3 * corners) };
  const dyed = (vertex) => arrays.film ? [0, 1, 2].map((k) => arrays.film[3 * vertex + k] / 255) : [0.62, 0.61, 0.6];
  faces.forEach((vertex, corner) => solid.film.set(dyed(vertex), 3 * corner));
  let rims = null;

  const move = (step, key) => {
    points("positions", count * step, count, cloth.positions);
    const graded = arrays[`color ${key}`];
    for (let k = 0; k < count; k++) {
      const bit = count * step + k;
      cloth.values[k] = graded ? graded[bit] : 255;
      cloth.ranks[k] = arrays.ranks[bit] / 16;
      if (arrays.visible) cloth.seen[k] = (arrays.visible[bit >> 3] >> (bit & 7)) & 1;
    }
    solid.normals = cornerNormals(faces, around, cloth.positions);
    for (let corner = 0; corner < corners; corner++) {
      const vertex = faces[corner];
      for (let axis = 0; axis < 3; axis++) solid.positions[3 * corner + axis] = cloth.positions[3 * vertex + axis];
      for (const name of ["values", "seen", "ranks"]) solid[name][corner] = cloth[name][vertex];
    }
    rims = null;
  };

  // Strips that close the gap between the two sides at a hem, and round off what bends sharply.
  const rimsOf = () => {
    const found = { positions: [], normals: [], values: [], seen: [], ranks: [], film: [], side: [] };
    const half = header.thickness / 2;
    const normal = (corner) => [...solid.normals.subarray(3 * corner, 3 * corner + 3)];
    const point = (vertex) => [...cloth.positions.subarray(3 * vertex, 3 * vertex + 3)];
    const strip = ({ a, b }, [fromA, fromB], [toA, toB], side, bent = [0, 0, 0]) => {
      const ends = [[a, fromA], [b, fromB], [a, toA], [b, toB]];
      for (const k of [0, 1, 2, 2, 1, 3]) {
        const [vertex, n] = ends[k];
        found.positions.push(...V.add(point(vertex), n, half));
        found.normals.push(...V.unit(V.add(n, bent, 0.8)));
        for (const name of ["values", "seen", "ranks"]) found[name].push(cloth[name][vertex]);
        found.film.push(...dyed(vertex));
        found.side.push(side);
      }
    };
    for (const edge of edges) {
      const one = edge.corners.map(normal), back = one.map((n) => V.scale(n, -1));
      if (!edge.others) {
        strip(edge, one, back, 1, V.unit(V.cross(V.add(point(edge.b), point(edge.a), -1), one[0])));
        continue;
      }
      const other = edge.others.map(normal);
      if (V.dot(one[0], other[0]) > 0.97 && V.dot(one[1], other[1]) > 0.97) continue;
      strip(edge, one, other, 1);
      strip(edge, back, other.map((n) => V.scale(n, -1)), -1);
    }
    return Object.fromEntries(Object.entries(found).map(([name, list]) => [name, new Float32Array(list)]));
  };

  // Far triangles first, so that what shines through does so in the right order.
  const order = new Uint32Array(corners / 3), depths = new Float32Array(order.length), sorted = new Uint32Array(corners);
  const farFirst = (eye, shift) => {
    for (let f = 0; f < order.length; f++) {
      order[f] = f;
      depths[f] = 0;
      const rank = cloth.ranks[faces[3 * f]];
      for (let axis = 0; axis < 3; axis++) {
        const from = 9 * f + axis;
        const sum = solid.positions[from] + solid.positions[from + 3] + solid.positions[from + 6];
        depths[f] += (sum / 3 + rank * shift[axis] - eye[axis]) ** 2;
      }
    }
    order.sort((a, b) => depths[b] - depths[a]);
    order.forEach((f, k) => { for (let c = 0; c < 3; c++) sorted[3 * k + c] = 3 * f + c; });
    return sorted;
  };

  // The vertex at a place of the screen (-1..1), of the triangle that is nearest to the eye there.
  const under = (clip, [x, y], shift) => {
    const seen = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) {
      const at = [0, 1, 2].map((axis) => cloth.positions[3 * k + axis] + cloth.ranks[k] * shift[axis]);
      seen.set(onScreen(clip, at) ?? [NaN, NaN, NaN], 3 * k);
    }
    let best = null, nearest = Infinity;
    for (let f = 0; f < corners; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const area = (seen[b] - seen[a]) * (seen[c + 1] - seen[a + 1]) - (seen[b + 1] - seen[a + 1]) * (seen[c] - seen[a]);
      const ofB = ((x - seen[a]) * (seen[c + 1] - seen[a + 1]) - (y - seen[a + 1]) * (seen[c] - seen[a])) / area;
      const ofC = ((seen[b] - seen[a]) * (y - seen[a + 1]) - (seen[b + 1] - seen[a + 1]) * (x - seen[a])) / area;
      const ofA = 1 - ofB - ofC;
      if (!(ofA >= 0 && ofB >= 0 && ofC >= 0)) continue;
      const depth = ofA * seen[a + 2] + ofB * seen[b + 2] + ofC * seen[c + 2];
      if (depth >= nearest) continue;
      nearest = depth;
      best = [[ofA, faces[f]], [ofB, faces[f + 1]], [ofC, faces[f + 2]]].sort((one, two) => two[0] - one[0])[0][1];
    }
    return best;
  };
  return { ...cloth, solid, move, farFirst, under, rims: () => (rims ??= rimsOf()) };
}
