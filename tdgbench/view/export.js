"use strict";
// A pose is world to camera: rows right, down, forward (OpenCV axes). Vectors are arrays of 3.
const $ = id => document.getElementById(id), canvas = document.querySelector("canvas");
const facts = JSON.parse($("facts").textContent), { count, channels, perRow, views, degC, response } = facts;
const columns = facts.low.length, rows = Math.ceil(count / perRow), SLOW = 40;  // ms per picture in motion
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, times = 1) => a.map((x, i) => x + times * b[i]);
const cross = (a, b) => [0, 1, 2].map(i => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
const turned = (v, axis, angle) => {  // Rodrigues' formula
  const along = axis.map(x => x * dot(axis, v));
  return plus(plus(along, plus(v, along, -1), Math.cos(angle)), cross(axis, v), Math.sin(angle));
};

const SPLAT = [`#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp usampler2D;
layout(location = 0) in uint which;
uniform sampler2D means; uniform usampler2D steps; uniform float low[${columns}], high[${columns}];
uniform mat3 pose; uniform vec3 position; uniform vec2 size; uniform float focal;
out vec2 at; flat out vec4 splat;
float column(int k) {
  uint step = texelFetch(steps, ivec2(int(which) % ${perRow} * ${columns} + k, int(which) / ${perRow}), 0).x;
  return mix(low[k], high[k], float(step) / 65535.0);
}
void main() {
  gl_Position = vec4(0, 0, 2, 1);  // outside of the image
  vec3 mean = texelFetch(means, ivec2(int(which) % ${perRow}, int(which) / ${perRow}), 0).xyz, p = pose * (mean - position);
  float opacity = 1.0 / (1.0 + exp(-column(7)));
  if (p.z <= ${facts.near} || opacity < 1.0 / 255.0) return;
  vec4 q = normalize(vec4(column(0), column(1), column(2), column(3)));
  mat3 skew = mat3(0, q.w, -q.z, -q.w, 0, q.y, q.z, -q.y, 0);
  vec3 scales = exp(vec3(column(4), column(5), column(6)));
  mat3 axes = pose * (mat3(1) + 2.0 * q.x * skew + 2.0 * skew * skew) * mat3(scales.x, 0, 0, 0, scales.y, 0, 0, 0, scales.z);
  vec2 ray = clamp(p.xy / p.z, -0.65 * size / focal, 0.65 * size / focal);  // 3DGS: 15 % beyond the border
  vec3 u = focal / p.z * (vec3(1, 0, -ray.x) * axes), v = focal / p.z * (vec3(0, 1, -ray.y) * axes);
  float xx = dot(u, u) + ${facts.eps2d}, xy = dot(u, v), yy = dot(v, v) + ${facts.eps2d};
  float middle = 0.5 * (xx + yy), spread = length(vec2(0.5 * (xx - yy), xy)), large = middle + spread;
  vec2 axis = normalize(xx >= yy ? vec2(large - yy + 1e-9, xy) : vec2(xy, large - xx));
  at = (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0) * sqrt(2.0 * log(255.0 * opacity));  // alpha is 1/255 there
  vec2 across = at.y * sqrt(max(middle - spread, ${facts.eps2d})) * vec2(-axis.y, axis.x);
  gl_Position = vec4((focal * p.xy / p.z + at.x * sqrt(large) * axis + across) * vec2(2, -2) / size, 0, 1);
  vec3 d = normalize(mean - position), e = d * d;
  float basis[16] = float[16](0.28209479, -0.48860251 * d.y, 0.48860251 * d.z, -0.48860251 * d.x, 1.09254843 * d.x * d.y,
    -1.09254843 * d.y * d.z, 0.31539157 * (2.0 * e.z - e.x - e.y), -1.09254843 * d.x * d.z, 0.54627422 * (e.x - e.y),
    -0.59004359 * d.y * (3.0 * e.x - e.y), 2.89061144 * d.x * d.y * d.z, -0.45704580 * d.y * (4.0 * e.z - e.x - e.y),
    0.37317633 * d.z * (2.0 * e.z - 3.0 * e.x - 3.0 * e.y), -0.45704580 * d.x * (4.0 * e.z - e.x - e.y),
    1.44530572 * d.z * (e.x - e.y), -0.59004359 * d.x * (e.x - 3.0 * e.y));
  splat = vec4(0.5, 0.5, 0.5, opacity);
  for (int k = 8; k < ${columns}; k++) splat[(k - 8) % ${channels}] += basis[(k - 8) / ${channels}] * column(k);
  splat.xyz = max(splat.xyz, 0.0);
}`, `#version 300 es
precision highp float;
in vec2 at; flat in vec4 splat; out vec4 color;
void main() {
  color = vec4(splat.xyz, min(0.99, splat.w * exp(-0.5 * dot(at, at))));
  if (color.w < 1.0 / 255.0) discard;
}`];
const SHOW = [`#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`, `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D light, palette; uniform vec2 ends, zoom; out vec4 color;
void main() {
  color = vec4(texelFetch(light, ivec2(gl_FragCoord.xy * zoom), 0).xyz, 1);
  int step = int(clamp((color.x - ends.x) / (ends.y - ends.x) * 256.0, 0.0, 255.0));
  if (${channels} == 1) color = texelFetch(palette, ivec2(step, 0), 0);
}`];

function fail(text) {
  $("problem").textContent = text;
  throw new Error(text);
}

function program(sources) {
  const made = gl.createProgram();
  for (const [i, source] of sources.entries()) {
    const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) fail(`Shaders cannot be compiled: ${gl.getProgramInfoLog(made)}`);
  gl.useProgram(made);
  return new Proxy({ made }, { get: (own, name) => own[name] ?? gl.getUniformLocation(made, name) });
}

function texture(unit, format, width, height, layout, type, data) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, layout, type, data);
  return made;
}

// Gaussians before the near plane, from far to near. row: z = row · (x, y, z, 1).
function orderOf(means, row, near) {
  const all = means.length / 3, z = new Float32Array(1), bits = new Uint32Array(z.buffer), keys = new Float64Array(all);
  let n = 0;
  for (let i = 0; i < all; i++) {
    z[0] = row[0] * means[3 * i] + row[1] * means[3 * i + 1] + row[2] * means[3 * i + 2] + row[3];
    if (z[0] > near) keys[n++] = (bits[0] >>> 1) * 2 ** 22 + i;  // positive floats are in the order of their bits
  }
  return Uint32Array.from(keys.subarray(0, n).sort().reverse(), key => key % 2 ** 22);
}

const gl = canvas.getContext("webgl2", { antialias: false, alpha: false }) ??
  fail("This browser has no WebGL 2, which the picture needs; open the page in another one.");
const isFloat = gl.getExtension("EXT_color_buffer_float"), isWide = isFloat && gl.getExtension("EXT_float_blend");
if (!isFloat && !gl.getExtension("EXT_color_buffer_half_float"))
  fail("This device draws no floating-point values (EXT_color_buffer_float), so no temperatures; use another one.");
if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) fail("The model is too large for this device; use another one.");
$("precision").textContent = `This device blends in ${isWide ? 32 : 16}-bit floats.`;
canvas.addEventListener("webglcontextlost", () => fail("The graphics device was lost; reload the page."));
const text = atob($("gaussians").textContent), bytes = new Uint8Array(text.length);
for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
const places = new Float32Array(bytes.buffer, 0, 3 * perRow * rows), means = places.slice(0, 3 * count);
const splats = program(SPLAT), steps = new Uint16Array(bytes.buffer, places.byteLength);
texture(0, gl.RGB32F, perRow, rows, gl.RGB, gl.FLOAT, places);
gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
texture(1, gl.R16UI, perRow * columns, rows, gl.RED_INTEGER, gl.UNSIGNED_SHORT, steps);
gl.uniform1i(splats.steps, 1);
gl.uniform1fv(splats.low, facts.low);
gl.uniform1fv(splats.high, facts.high);
gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
gl.enableVertexAttribArray(0);
gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
gl.vertexAttribDivisor(0, 1);
gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
const shown = program(SHOW), target = gl.createFramebuffer();
texture(2, gl.RGB8, 256, 1, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(facts.palette.flat()));
gl.uniform1i(shown.palette, 2);
gl.uniform1i(shown.light, 3);

let pose, center, distance, reach;  // of the camera, which turns around `center`
let drawn = 0, sortedFor = "", isSorting = false;
const position = () => plus(center, pose[2], -distance), zRow = () => [...pose[2], -dot(pose[2], position())];
function take([order, row]) {
  [drawn, sortedFor, isSorting] = [order.length, String(row), false];
  gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
  request();
}
let ask = row => setTimeout(() => take([orderOf(means, row, facts.near), row]));
try {  // a page from disk may have no worker in some browsers; then this thread sorts
  const worker = new Worker(URL.createObjectURL(new Blob([`${orderOf} let means; onmessage = ({ data }) => {
    if (means) postMessage([orderOf(means, data, ${facts.near}), data]); else means = data; };`]))), askHere = ask;
  worker.onmessage = ({ data }) => take(data);
  worker.onerror = () => { ask = askHere; ask(zRow()); };
  worker.postMessage(means);
  ask = row => worker.postMessage(row);
} catch (error) { console.info(`sorting without a worker: ${error}`); }

let light, size = [], scale = 1, pace = 1, isQueued = false, rest, pointer = null;  // scale: of the picture's pixels
function request() {
  if (!isQueued) requestAnimationFrame(draw);
  isQueued = true;
}

function moved() {  // pictures in motion are small where the device is slow; the full one follows
  scale = pace;
  document.body.dataset.state = "moving";
  clearTimeout(rest);
  rest = setTimeout(() => { scale = 1; request(); }, 250);
  request();
}

function resize(width, height) {
  gl.deleteTexture(light);
  light = texture(3, isWide ? gl.RGBA32F : gl.RGBA16F, width, height, gl.RGBA, isWide ? gl.FLOAT : gl.HALF_FLOAT, null);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, light, 0);
  if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE)
    fail("This device refuses floating-point pictures of this size; make the window smaller and reload the page.");
  size = [width, height];
}

function draw() {
  const start = performance.now(), row = zRow(), behind = facts.background;
  const [wide, high] = [canvas.clientWidth, canvas.clientHeight].map(n => Math.ceil(n * devicePixelRatio) || 1);
  isQueued = false;
  if (!isSorting && sortedFor !== String(row)) {
    isSorting = true;
    ask(row);
  }
  if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  const wanted = [wide, high].map(n => Math.ceil(n * scale));
  if (String(size) !== String(wanted)) resize(...wanted);
  gl.useProgram(splats.made);
  gl.uniformMatrix3fv(splats.pose, true, pose.flat());
  gl.uniform3fv(splats.position, position());
  gl.uniform2fv(splats.size, size);
  gl.uniform1f(splats.focal, size[1] / 2 / halfHeight());
  gl.viewport(0, 0, ...size);
  gl.clearColor(behind[0], behind[channels >> 1], behind[channels - 1], 1);
  gl.clear(gl.COLOR_BUFFER_BIT);
  gl.enable(gl.BLEND);
  gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, drawn);
  gl.disable(gl.BLEND);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
  gl.viewport(0, 0, wide, high);
  gl.useProgram(shown.made);
  gl.uniform2f(shown.zoom, size[0] / wide, size[1] / high);
  gl.uniform2fv(shown.ends, ends().map(value => (value - response[0]) / (response[1] - response[0])));
  gl.drawArrays(gl.TRIANGLE_STRIP, 0, 3);
  read();  // waits for the device
  const took = performance.now() - start;
  if (scale < 1 || took > SLOW) pace = Math.min(1, Math.max(0.25, scale * Math.sqrt(SLOW / took)));
  document.body.dataset.state = scale === 1 && sortedFor === String(row) ? "still" : "moving";
}

const halfHeight = () => Math.max(reach[1], reach[0] * size[1] / size[0]);  // of the picture, at z = 1
const ends = () => [$("low").value / 100, Math.max($("high").value, +$("low").value + 1) / 100];
const worded = value => degC ? `${(degC[0] + value * (degC[1] - degC[0])).toFixed(1)} °C` : value.toFixed(3);

function read() {  // the composited value under the pointer; without one, in the middle
  const [x, y] = (pointer ?? [0.5, 0.5]).map((share, i) => Math.min(size[i] - 1, Math.floor(share * size[i])));
  const pixel = new Float32Array(4);
  gl.readPixels(x, size[1] - 1 - y, 1, 1, gl.RGBA, gl.FLOAT, pixel);
  const values = [...pixel.subarray(0, channels)].map(value => response[0] + value * (response[1] - response[0]));
  document.querySelector("output").textContent = values.map(worded).join(" ") + (pointer ? "" : " in the middle");
}

function describeRange() {
  $("bar").style.background = `linear-gradient(90deg, ${facts.palette.filter((_, i) => i % 15 === 0).map(c => `rgb(${c})`)})`;
  [...$("ends").children].forEach((end, i) => { end.textContent = worded(ends()[i]); });
  request();
}

function goTo(view) {
  const away = plus(facts.focus, view.position, -1), ahead = dot(view.pose[2], away);
  [pose, reach, distance] = [view.pose, view.reach, ahead > 0 ? ahead : Math.hypot(...away) || 1];
  center = plus(view.position, pose[2], distance);
  moved();
}

function turn(x, y) {  // radians
  pose = pose.map(axis => turned(axis, facts.up, -x));
  pose = pose.map(axis => turned(axis, pose[0], -y));
  moved();
}

function shift(x, y) {  // shares of the picture's height
  center = plus(plus(center, pose[0], -2 * x * distance * halfHeight()), pose[1], -2 * y * distance * halfHeight());
  moved();
}

function approach(factor) {
  distance *= factor;
  moved();
}

const fingers = new Map();
canvas.addEventListener("pointerdown", event => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => fingers.delete(event.pointerId));
canvas.addEventListener("pointermove", event => {
  const before = fingers.get(event.pointerId), now = [event.offsetX, event.offsetY];
  pointer = [now[0] / canvas.clientWidth, now[1] / canvas.clientHeight].map(share => Math.min(1, Math.max(0, share)));
  if (!before) return read();
  fingers.set(event.pointerId, now);
  const [x, y] = now.map((n, i) => (n - before[i]) / canvas.clientHeight);
  const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
  const apart = place => Math.max(1, Math.hypot(place[0] - other[0], place[1] - other[1]));
  if (other) approach(apart(before) / apart(now));
  if (other || event.buttons & 2 || event.shiftKey) shift(other ? x / 2 : x, other ? y / 2 : y);
  else turn(4 * x, 4 * y);
});
canvas.addEventListener("contextmenu", event => event.preventDefault());
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  approach(Math.exp(Math.max(-100, Math.min(100, event.deltaY)) * 0.002));
}, { passive: false });
canvas.addEventListener("keydown", event => {
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  const factor = { "+": 1 / 1.1, "=": 1 / 1.1, "-": 1.1 }[event.key];
  if (event.ctrlKey || event.altKey || event.metaKey || !(arrow || factor)) return;
  event.preventDefault();
  if (factor) approach(factor);
  else if (event.shiftKey) shift(...arrow.map(n => n * -0.05));
  else turn(...arrow.map(n => n * 0.1));
});
$("view").append(...views.map(view => new Option(view.name)));
$("view").addEventListener("change", () => goTo(views[$("view").selectedIndex]));
for (const end of ["low", "high"]) $(end).addEventListener("input", describeRange);
$("colours").hidden = channels > 1;
goTo(views[0]);
describeRange();
new ResizeObserver(request).observe(canvas);
