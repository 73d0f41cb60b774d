// What the graphics card runs: cloth, lines, points, table, and the light that reaches them.

const APART = `
in float rank;
uniform mat4 clip; uniform vec3 along; uniform float gap;
vec3 apart(vec3 p) { return p + along * (gap * rank); }`;

// How much of the sky a point sees, and whether something lies over it: both from the map that
// looks straight down (SHADE below).
const SKY = `
uniform sampler2D shade, heights;
uniform vec3 middle, first, second, rise; uniform float half_side, low, high; uniform int shade_known;
vec3 place(vec3 p) {
  vec3 d = p - middle;
  return vec3(0.5 + 0.5 * vec2(dot(d, first), dot(d, second)) / half_side, dot(d, rise));
}
float sky(vec3 p) {
  if (shade_known == 0) return 1.0;
  vec3 s = place(p);
  if (any(lessThan(s.xy, vec2(0.0))) || any(greaterThan(s.xy, vec2(1.0)))) return 1.0;
  float top = high - texture(heights, s.xy).r * (high - low);
  float covered = smoothstep(0.003, 0.012, top - s.z);
  return mix(texture(shade, s.xy).r, 0.38, covered);
}`;

const CLOTH = [`#version 300 es
in vec3 position, normal, film; in float value, seen, side;
out vec3 at, across, dyed; out float grade, known, shown, facing;
uniform float half_thickness;
${APART}
void main() {
  at = apart(position + side * half_thickness * normal);
  across = side < -0.5 && half_thickness > 0.0 ? -normal : normal;
  dyed = film;
  known = value > 254.5 ? 0.0 : 1.0;
  grade = known * value / 254.0;
  shown = seen;
  facing = side;
  gl_Position = clip * vec4(at, 1.0);
}`, `#version 300 es
precision highp float;
in vec3 at, across, dyed; in float grade, known, shown, facing;
uniform vec3 eye, lamp, outside, inside, hidden, unknown, stops[6];
uniform int mode; uniform float opacity, half_thickness;
out vec4 color;
${SKY}
vec3 heat(float share) {
  float place = clamp(share, 0.0, 1.0) * 5.0;
  int first = int(min(floor(place), 4.0));
  return mix(stops[first], stops[first + 1], place - float(first));
}
void main() {
  // Drawn thick, each side is a surface of its own; drawn thin, one surface has both.
  bool front = half_thickness > 0.0 ? facing > 0.0 : gl_FrontFacing;
  vec3 n = normalize(across), view = normalize(eye - at);
  if (half_thickness == 0.0 && !gl_FrontFacing) n = -n;
  vec3 paint = mode == 0 ? (front ? outside : inside)
    : mode == 1 ? mix(hidden, outside, step(0.5, shown))
    : mode == 3 ? dyed
    : known > 0.99 ? heat(grade) : unknown;
  // Woven cloth scatters: light wraps around, and its fibres shine where it turns away.
  float key = (dot(n, normalize(0.35 * view + lamp)) + 0.3) / 1.3;
  // What only shows from below gets a weak light from the eye: the sky does not reach it.
  float light = max(key, 0.55 * max(dot(n, view), 0.0));
  float rim = pow(1.0 - max(dot(n, view), 0.0), 3.0);
  float open = dot(view, rise) < 0.0 ? max(sky(at), 0.8) : sky(at);
  color = vec4(paint * (0.34 * (0.35 + 0.65 * open) + 0.78 * light * mix(0.5, 1.0, open))
    + 0.07 * rim * open, opacity);
}`];

const LINES = [`#version 300 es
in vec3 position;
uniform vec3 eye; uniform float lift;
${APART}
void main() {
  vec3 at = apart(position);
  gl_Position = clip * vec4(at + lift * normalize(eye - at), 1.0);
}`, `#version 300 es
precision highp float;
uniform vec3 paint; uniform float opacity;
out vec4 color;
void main() { color = vec4(paint, opacity); }`];

// Lines of a width in pixels: each end comes twice, on either side.
const RIBBON = [`#version 300 es
in vec3 position, other; in float away;
uniform mat4 clip; uniform vec2 screen; uniform float width;
void main() {
  vec4 a = clip * vec4(position, 1.0), b = clip * vec4(other, 1.0);
  vec2 d = (b.xy / max(b.w, 1e-4) - a.xy / max(a.w, 1e-4)) * screen;
  vec2 n = vec2(-d.y, d.x) / max(length(d), 1e-3);
  gl_Position = a + vec4(away * width * n / screen * a.w, 0.0, 0.0);
}`, LINES[1]];

const DOTS = [`#version 300 es
in vec3 position, tint;
uniform mat4 clip; uniform vec3 eye; uniform float size, pixels, least, lift;
out vec3 dye;
void main() {
  dye = tint;
  gl_Position = clip * vec4(position + lift * normalize(eye - position), 1.0);
  gl_PointSize = max(least, size * pixels / gl_Position.w);
}`, `#version 300 es
precision highp float;
in vec3 dye;
uniform float opacity, round;
out vec4 color;
void main() {
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float outer = dot(p, p);
  if (outer > 1.0) discard;
  color = vec4(dye * mix(1.0, 0.55 + 0.45 * sqrt(1.0 - outer), round), opacity);
}`];

const TABLE = [`#version 300 es
in vec3 position;
uniform mat4 clip; uniform vec3 center, first_axis, second_axis; uniform float side;
out vec2 place_at; out vec3 at;
void main() {
  place_at = side * position.xy;
  at = center + place_at.x * first_axis + place_at.y * second_axis;
  gl_Position = clip * vec4(at, 1.0);
}`, `#version 300 es
precision highp float;
in vec2 place_at; in vec3 at;
uniform vec3 paint; uniform float side;
out vec4 color;
${SKY}
float open_above(vec3 p) {
  vec3 s = place(p);
  if (shade_known == 0 || any(lessThan(s.xy, vec2(0.0))) || any(greaterThan(s.xy, vec2(1.0)))) return 1.0;
  return texture(shade, s.xy).g;
}
void main() {
  vec2 cells = place_at / 0.1;
  vec2 near = abs(fract(cells - 0.5) - 0.5) / max(fwidth(cells), vec2(1e-6));
  float line = 1.0 - clamp(min(near.x, near.y), 0.0, 1.0);
  float fade = 1.0 - smoothstep(0.55, 1.0, length(place_at) / side);
  color = vec4(paint * (1.0 - 0.14 * line) * mix(0.42, 1.0, open_above(at)), 0.75 * fade);
}`];

// Heights over the table, seen straight from above; only the depth is kept.
const ABOVE = [`#version 300 es
in vec3 position;
${APART}
void main() { gl_Position = clip * vec4(apart(position), 1.0); }`, `#version 300 es
precision highp float;
void main() {}`];

// From these heights, how much of the sky each place sees: red on top of what lies there, green
// down on the table. A place is darkened by what rises around it, by the sine of its horizon.
const SHADE = [`#version 300 es
in vec3 position;
out vec2 here;
void main() { here = 0.5 + 0.5 * position.xy; gl_Position = vec4(position.xy, 0.0, 1.0); }`, `#version 300 es
precision highp float;
in vec2 here;
uniform sampler2D heights;
uniform float half_side, low, high, ground;
out vec4 color;
float height(vec2 p) { return high - texture(heights, p).r * (high - low); }
void main() {
  float own = max(height(here), ground), turn = fract(52.98 * fract(dot(gl_FragCoord.xy, vec2(0.0671, 0.00584))));
  vec2 open = vec2(0.0);
  for (int k = 0; k < 8; k++) {
    float angle = 6.2832 * (float(k) + turn) / 8.0;
    vec2 way = vec2(cos(angle), sin(angle));
    vec2 horizon = vec2(0.0);
    for (int step = 0; step < 4; step++) {
      float reach = 0.003 * pow(2.6, float(step));
      float there = height(here + way * reach / (2.0 * half_side));
      horizon = max(horizon, vec2(there - own, there - ground) / reach);
    }
    open += 1.0 / (1.0 + horizon * horizon);
  }
  open /= 8.0;
  // Under cloth the table is dark, the nearer the darker.
  float over = height(here) - ground;
  open.y = mix(open.y, min(0.7, 9.0 * over), smoothstep(0.001, 0.004, over));
  color = vec4(open, 0.0, 1.0);
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
  const whole = new Set(["mode", "shade_known", "shade", "heights"]);
  return {
    use: () => gl.useProgram(made),
    set: (values) => {
      for (const [name, value] of Object.entries(values)) {
        if (whole.has(name)) gl.uniform1i(at(name), value);
        else if (typeof value === "number") gl.uniform1f(at(name), value);
        else if (value.length === 16) gl.uniformMatrix4fv(at(name), false, value);
        else if (value.length === 2) gl.uniform2fv(at(name), value);
        else gl.uniform3fv(at(name), value);
      }
    },
    // An attribute from a buffer, or one value for all vertices.
    feed: (name, source, width = 1) => {
      const place = gl.getAttribLocation(made, name);
      if (place < 0) return;
      if (typeof source === "number" || Array.isArray(source)) {
        gl.disableVertexAttribArray(place);
        gl.vertexAttrib3fv(place, Array.isArray(source) ? source : [source, 0, 0]);
        return;
      }
      gl.bindBuffer(gl.ARRAY_BUFFER, source);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    },
  };
}
