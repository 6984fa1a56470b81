"use strict";
// Tables that are stacked where they are too wide, and copied; pictures that are scrolled; bodies that turn, drawn by WebGL; nothing is fetched.

// A table that is wider than the page shows each row as a list of headings and cells.
function stackWideTables() {
  for (const table of document.querySelectorAll("div.wide > table")) {
    table.classList.remove("stacked");
    table.classList.toggle("stacked", table.parentElement.scrollWidth > table.parentElement.clientWidth);
  }
}
for (const table of document.querySelectorAll("div.wide > table")) {
  const headings = [...table.tHead.rows[0].cells].map((cell) => cell.textContent);
  for (const row of table.tBodies[0].rows) [...row.cells].forEach((cell, k) => { cell.dataset.heading = headings[k]; });
}
stackWideTables();
addEventListener("resize", stackWideTables);

const BROAD = 900;  // pixels: pictures of one panel have less
// What is scrolled is reached by keyboard, too.
function reachScrolledParts() {
  for (const image of document.images) image.classList.toggle("broad", image.naturalWidth > BROAD);
  for (const part of document.querySelectorAll("div.wide")) {
    if (part.scrollWidth > part.clientWidth) part.setAttribute("tabindex", "0"); else part.removeAttribute("tabindex");
  }
}
for (const event of ["load", "resize"]) addEventListener(event, reachScrolledParts);

for (const button of document.querySelectorAll("button.copy")) {
  button.addEventListener("click", () => {
    const range = document.createRange(), selection = getSelection(), table = button.previousElementSibling.firstElementChild;
    table.classList.remove("stacked");
    range.selectNode(table);
    selection.removeAllRanges();
    selection.addRange(range);
    button.textContent = document.execCommand("copy") ? "copied" : "selected: copy it with Ctrl-C";
    stackWideTables();
  });
}

const VERTEX = `attribute vec3 place, normal, colour; uniform mat3 turn; uniform vec3 scale; varying vec3 shade;
void main() {
  vec3 n = turn * normal, p = turn * place;
  shade = colour * (0.45 + 0.55 * max(dot(n, normalize(vec3(0.4, 0.5, 1.0))), 0.0));
  gl_Position = vec4(p * scale, 1.0);
}`;
const FRAGMENT = "precision mediump float; varying vec3 shade; void main() { gl_FragColor = vec4(shade, 1.0); }";

// Nine numbers for each corner: place, normal of its triangle, colour; places about the middle, the farthest at a distance of 1.
function corners(bodies) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const body of bodies) for (const v of body.vertices) for (let k = 0; k < 3; k++) {
    low[k] = Math.min(low[k], v[k]); high[k] = Math.max(high[k], v[k]);
  }
  const middle = low.map((l, k) => (l + high[k]) / 2), size = Math.hypot(...low.map((l, k) => (high[k] - l) / 2));
  const out = [];
  for (const body of bodies) for (const triangle of body.triangles) {
    const [a, b, c] = triangle.map((i) => body.vertices[i].map((x, k) => (x - middle[k]) / size));
    const u = b.map((x, k) => x - a[k]), v = c.map((x, k) => x - a[k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const length = Math.hypot(...n) || 1;
    for (const p of [a, b, c]) out.push(...p, n[0] / length, n[1] / length, n[2] / length, ...body.colour);
  }
  return new Float32Array(out);
}

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

// Columns of the rotation: about the upright axis by `about`, then towards the eye by `up`; x right, y up, z to the eye.
function rotation(about, up) {
  const [c, s, d, t] = [Math.cos(about), Math.sin(about), Math.cos(up), Math.sin(up)];
  return [c, t * s, -d * s, -s, t * c, -d * c, 0, d, t];
}

function show(canvas) {
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { canvas.dataset.drawn = "no WebGL"; return; }
  const data = corners(JSON.parse(canvas.dataset.bodies)), made = program(gl);
  gl.useProgram(made);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  ["place", "normal", "colour"].forEach((name, k) => {
    const at = gl.getAttribLocation(made, name);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 36, 12 * k);
  });
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(1, 1, 1, 1);
  let about = -0.6, up = 0.4, held = null;
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * ratio;
    canvas.height = canvas.clientHeight * ratio;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const least = Math.min(canvas.width, canvas.height);
    gl.uniformMatrix3fv(gl.getUniformLocation(made, "turn"), false, rotation(about, up));
    gl.uniform3f(gl.getUniformLocation(made, "scale"), 0.98 * least / canvas.width, 0.98 * least / canvas.height, -0.98);
    gl.drawArrays(gl.TRIANGLES, 0, data.length / 9);
  }
  function count() { // pixels that are not background
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let found = 0;
    for (let k = 0; k < pixels.length; k += 4) found += pixels[k] < 250 || pixels[k + 1] < 250 || pixels[k + 2] < 250;
    return found;
  }
  canvas.addEventListener("pointerdown", (event) => { held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    about -= (event.clientX - held[0]) / 150;
    up = Math.max(-1.5, Math.min(1.5, up + (event.clientY - held[1]) / 150));
    held = [event.clientX, event.clientY];
    draw();
  });
  window.addEventListener("resize", draw);
  draw();
  canvas.dataset.drawn = count();
}

document.querySelectorAll("canvas[data-bodies]").forEach(show);
document.documentElement.dataset.fits = document.documentElement.scrollWidth <= window.innerWidth;
