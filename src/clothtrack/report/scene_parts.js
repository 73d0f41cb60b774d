// What stands around the cloth: the pickers' paths, the cameras, the light from above.

// Points of the cloth at a dozen of the frames; observed points where there is no cloth.
function pointsOfAll({ header, points }, starts) {
  const count = header.frames.length, every = Math.max(1, Math.floor(count / 12)), found = [];
  for (let step = 0; step < count; step += step + every >= count && step < count - 1 ? count - 1 - step : every) {
    if (header.vertices) found.push(points("positions", header.vertices * step, header.vertices));
    else if (header.counts[step]) found.push(points("cloud", starts[step], header.counts[step]));
  }
  const all = new Float32Array(found.reduce((sum, one) => sum + one.length, 0));
  found.reduce((at, one) => { all.set(one, at); return at + one.length; }, 0);
  return all.length ? all : new Float32Array([...V.add(header.origin, [-0.1, -0.1, -0.1]), ...V.add(header.origin, [0.1, 0.1, 0.1])]);
}

// Points of the cloth as it is drawn now, its layers lifted.
const lifted = (cloth, shift) => cloth.positions.map((value, k) => value + cloth.ranks[Math.floor(k / 3)] * shift[k % 3]);

// Colors of the observed points of a step, 0 to 1.
function tintsOf({ header, arrays }, first, count) {
  const tints = new Float32Array(3 * count), places = arrays["cloud colors"];
  if (places) for (let k = 0; k < count; k++) tints.set(header.cloudColors[places[first + k]].map((part) => part / 255), 3 * k);
  return tints;
}

// Each picker's path as pieces between steps: where from, where to, whether it held.
const pathsOf = (header) => header.pickers.map(({ tips, closed }) =>
  tips.slice(1).map((to, k) => ({ pair: [tips[k], to], step: k + 1, closed: closed[k] && closed[k + 1] })));

// Each real camera as the edges of a pyramid, as deep as a fifth of the cloth is wide.
function frustumsOf(header, size) {
  return header.views.map(({ eye, right, down, forward, focal, center, size: [width, height] }) => {
    const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([x, y]) => {
      const ray = V.add(V.add(forward, right, (x - 0.5 - center[0]) / focal[0]), down, (y - 0.5 - center[1]) / focal[1]);
      return V.add(eye, ray, 0.2 * size);
    });
    return corners.flatMap((corner, k) => [{ pair: [eye, corner] }, { pair: [corner, corners[(k + 1) % 4]] }]);
  });
}

// Two triangles for each pair of points: every end twice, on either side of the line.
function ribbonOf(pairs) {
  const position = [], other = [], away = [];
  for (const { pair: [a, b] } of pairs) {
    // Seen from its own end, the line runs the other way: so do its sides.
    for (const [from, to, side] of [[a, b, 1], [a, b, -1], [b, a, 1], [b, a, 1], [a, b, -1], [b, a, -1]].map(([p, q, s]) => [p, q, p === a ? s : -s])) {
      position.push(...from);
      other.push(...to);
      away.push(side);
    }
  }
  return { position: new Float32Array(position), other: new Float32Array(other), away: new Float32Array(away) };
}

// Two small pictures of the cloth from above: how high it is, and how much of the sky one sees there.
function skyMap(gl, header) {
  const texture = (format, internal, type, filter) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, MAP_SIDE, MAP_SIDE, 0, format, type, null);
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
    return made;
  };
  const heights = texture(gl.DEPTH_COMPONENT, gl.DEPTH_COMPONENT24, gl.UNSIGNED_INT, gl.NEAREST);
  const shade = texture(gl.RGBA, gl.RGBA8, gl.UNSIGNED_BYTE, gl.LINEAR);
  const into = (attachment, made) => {
    const buffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, made, 0);
    if (attachment === gl.DEPTH_ATTACHMENT) {
      gl.drawBuffers([gl.NONE]);
      gl.readBuffer(gl.NONE);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return buffer;
  };
  const upper = into(gl.DEPTH_ATTACHMENT, heights), lower = into(gl.COLOR_ATTACHMENT0, shade);
  const [point, normal] = header.table ?? [header.origin, header.up], [first, second] = V.across(normal);
  const window = { middle: point, half_side: 1, low: -1, high: 1, shade_known: 0 };
  const bind = (unit, made) => { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, made); };
  const pass = (buffer, program, render) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.viewport(0, 0, MAP_SIDE, MAP_SIDE);
    program.use();
    render();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  };
  return {
    // Choose the part of the table that the cloth lies on, and some air around.
    frame: (cloth, shift) => {
      const points = lifted(cloth, shift), center = middleOf(points);
      let reach = 0, low = 0, high = 0;
      for (let k = 0; k < points.length; k += 3) {
        const p = [points[k], points[k + 1], points[k + 2]], from = V.add(p, center, -1);
        reach = Math.max(reach, Math.abs(V.dot(from, first)), Math.abs(V.dot(from, second)));
        const rise = V.dot(V.add(p, point, -1), normal);
        [low, high] = [Math.min(low, rise), Math.max(high, rise)];
      }
      window.middle = V.add(center, normal, -V.dot(V.add(center, point, -1), normal));
      Object.assign(window, { half_side: reach + 0.06, low: low - 0.02, high: high + 0.02, shade_known: 1 });
    },
    above: (program, render) => pass(upper, program, () => {
      bind(0, null);
      bind(1, null);
      gl.enable(gl.DEPTH_TEST);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      program.set({ clip: clipFromAbove(window.middle, [first, second, normal], window.half_side, window.low, window.high) });
      render();
    }),
    below: (program, render) => pass(lower, program, () => {
      gl.disable(gl.DEPTH_TEST);
      gl.disable(gl.BLEND);
      bind(1, heights);
      program.set({ heights: 1, half_side: window.half_side, low: window.low, high: window.high, ground: 0 });
      render();
    }),
    uniforms: () => {
      bind(0, shade);
      bind(1, heights);
      return { shade: 0, heights: 1, ...window, first, second, rise: normal };
    },
  };
}
