// The script of the page: states in the viewer, values at a picked point, curves of the steps.
const data = JSON.parse(document.getElementById("states").textContent);
const states = data.states;
const viewer = new TextDecoder().decode(
  Uint8Array.from(atob(document.getElementById("vtkjs").textContent), c => c.charCodeAt(0)));
const byId = id => document.getElementById(id);
const range = byId("state"), frame = byId("viewer");

// --- states ---

// vtk.js's viewer has an empty renderer, then that of the scene.
const renderer = page => page.global?.renderWindow?.getRenderersByReference()[1];
const camera = () => {
  const used = renderer(frame.contentWindow)?.getActiveCamera();
  return used && { position: used.getPosition(), focalPoint: used.getFocalPoint(), viewUp: used.getViewUp() };
};
const label = () => { byId("label").textContent = states[range.value].label; drawCurve(); };
// A new document for each state: the browser then frees the WebGL context of the last one.
let kept = null;
const show = () => {
  label();
  kept = camera() ?? kept;
  const load = "<script>function loadDataSet() {" +
    "OfflineLocalView.load(document.body, { base64Str: '" + states[range.value].scene + "' });" +
    "parent.keepCamera(window); }</" + "script>";
  frame.srcdoc = viewer.replace("</body>", () => load + "</body>");
};
// The viewer has loaded a scene when its second renderer exists.
window.keepCamera = page => {
  const wait = setInterval(() => {
    const loaded = renderer(page);
    if (!loaded) return;
    clearInterval(wait);
    if (kept) {
      loaded.getActiveCamera().set(kept);
      loaded.resetCameraClippingRange();
      page.global.renderWindow.render();
    }
    watchClicks(page);
    if (picked) showPicked();
    if (playing) timer = setTimeout(next, 300);
  }, 20);
};
// While the states play, each is followed by the next once it is drawn, until the last.
const play = byId("play");
let playing = false, timer;
const setPlaying = value => {
  clearTimeout(timer);
  playing = value;
  play.textContent = playing ? "Pause" : "Play";
};
const next = () => {
  if (!playing) return;
  if (+range.value >= +range.max) return setPlaying(false);
  range.value = +range.value + 1;
  show();
};
play.addEventListener("click", () => {
  setPlaying(!playing);
  if (!playing) return;
  if (+range.value < +range.max) return next();
  range.value = 0;
  show();
});
range.addEventListener("input", label);
range.addEventListener("change", () => { setPlaying(false); show(); });

// --- values at a point ---

const sub = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [0, 1, 2].map(i => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
const mix = (vectors, weights) => vectors[0].map((_, i) => weights.reduce((sum, w, k) => sum + w * vectors[k][i], 0));
const unit = a => a.map(x => x / Math.hypot(...a));
// What is picked: the number of a triangle of the surface, its cell, and weights of its corners.
let picked = null;
// The surface whose colours are the field, as points, triangles [a, b, c, cell], and its arrays.
const surface = page => page.drawnBody ??= findSurface(page);
const findSurface = page => {
  for (const actor of renderer(page).getActors()) {
    const body = actor.getMapper().getInputData();
    const [points, cells] = [body.getPointData(), body.getCellData()];
    const values = points.getArrayByName(data.field) ?? cells.getArrayByName(data.field);
    if (!values?.getData().length) continue;
    const triangles = [], list = body.getPolys().getData();
    for (let i = 0, cell = 0; i < list.length; i += list[i] + 1, cell++)
      for (let k = 2; k < list[i]; k++) triangles.push([list[i + 1], list[i + k], list[i + k + 1], cell]);
    return {
      x: body.getPoints().getData(), triangles, values: values.getData(),
      perCell: !points.getArrayByName(data.field), u: points.getArrayByName(data.vectors)?.getData(),
    };
  }
};
const vector = (array, i) => Array.from(array.slice(3 * i, 3 * i + 3));
// The camera's axes, and half of the picture's height at unit distance.
const lens = page => {
  const used = renderer(page).getActiveCamera(), position = used.getPosition();
  const forward = unit(sub(used.getFocalPoint(), position));
  const right = unit(cross(forward, used.getViewUp()));
  const { clientWidth: wide, clientHeight: tall } = page.document.documentElement;
  return { position, forward, right, up: cross(right, forward), wide, tall,
    half: Math.tan(used.getViewAngle() * Math.PI / 360) };
};
const pick = (page, left, top) => {
  const { position, forward, right, up, wide, tall, half } = lens(page);
  const across = half * (2 * left - wide) / tall, upwards = half * (tall - 2 * top) / tall;
  const ray = unit(mix([forward, right, up], [1, across, upwards]));
  const body = surface(page);
  let nearest = Infinity;
  picked = null;
  // Moeller and Trumbore 1997
  body?.triangles.forEach(([a, b, c, cell], number) => {
    const A = vector(body.x, a), ab = sub(vector(body.x, b), A), ac = sub(vector(body.x, c), A);
    const p = cross(ray, ac), determinant = dot(ab, p);
    if (!determinant) return;
    const from = sub(position, A), s = dot(from, p) / determinant;
    const q = cross(from, ab), t = dot(ray, q) / determinant, far = dot(ac, q) / determinant;
    if (s < 0 || t < 0 || s + t > 1 || far <= 0 || far >= nearest) return;
    nearest = far;
    picked = { number, cell, weights: [1 - s - t, s, t], of: body.triangles.length };
  });
  showPicked();
};
const digits = value => (Math.abs(value) < 1e-12 ? 0 : +value.toPrecision(5)).toString();
// Rounding is no displacement: parts of a vector below 1e-6 of it are 0.
const listed = values => {
  const least = 1e-6 * Math.hypot(...values);
  return values.map(value => digits(Math.abs(value) < least ? 0 : value)).join(", ");
};
const showPicked = () => {
  const page = frame.contentWindow, body = picked && surface(page);
  const same = body && picked.of === body.triangles.length;
  byId("dot").hidden = !same;
  if (!same) return byId("picked").textContent = "Click on the body for the values at a point.";
  const corners = body.triangles[picked.number].slice(0, 3);
  const at = mix(corners.map(i => vector(body.x, i)), picked.weights);
  const value = body.perCell ? body.values[picked.cell] : dot(corners.map(i => body.values[i]), picked.weights);
  const lines = [`${data.label}: ${digits(value)}`];
  if (body.u) {
    const u = mix(corners.map(i => vector(body.u, i)), picked.weights);
    lines.push(`displacement${data.length}: ${listed(u)}; length ${digits(Math.hypot(...u))}`);
    lines.push(`at rest${data.length}: ${listed(sub(at, u))}`);
  }
  byId("picked").textContent = [...lines, `now${data.length}: ${listed(at)}`].join("\n");
  const { position, forward, right, up, wide, tall, half } = lens(page);
  const arm = sub(at, position), size = tall / (2 * half * dot(arm, forward));
  byId("dot").style.left = `${wide / 2 + size * dot(arm, right)}px`;
  byId("dot").style.top = `${tall / 2 - size * dot(arm, up)}px`;
};
// A click is no drag, which turns the body.
const watchClicks = page => {
  let start = null;
  page.document.addEventListener("pointerdown", e => { start = [e.clientX, e.clientY]; }, true);
  page.document.addEventListener("pointerup", e => {
    if (start && Math.hypot(e.clientX - start[0], e.clientY - start[1]) < 4) pick(page, e.clientX, e.clientY);
    start = null;
  }, true);
  const follow = () => { if (picked && page === frame.contentWindow) showPicked(); };
  for (const kind of ["pointermove", "wheel"])
    page.document.addEventListener(kind, () => picked && page.requestAnimationFrame(follow), true);
};

// --- curves ---

const axes = { x: byId("x"), y: byId("y") };
const SIZE = { wide: 420, tall: 330, left: 72, right: 14, top: 12, bottom: 46 };
const draw = kind => document.createElementNS("http://www.w3.org/2000/svg", kind);
const chart = byId("chart").appendChild(draw("svg"));
chart.setAttribute("viewBox", `0 0 ${SIZE.wide} ${SIZE.tall}`);
const add = (kind, attributes, text) => {
  const made = draw(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return chart.appendChild(made);
};
// About five round numbers between two.
const ticks = (low, high) => {
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find(m => m * power >= rough) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
};
const scale = (values, from, to) => {
  let low = Math.min(...values), high = Math.max(...values);
  if (high - low <= 1e-12 * Math.max(Math.abs(low), Math.abs(high), 1e-300)) [low, high] = [low - 0.5, high + 0.5];
  const margin = 0.04 * (high - low);
  [low, high] = [low - margin, high + margin];
  return { ticks: ticks(low, high), at: value => from + (to - from) * (value - low) / (high - low) };
};
const drawCurve = () => {
  chart.replaceChildren();
  const [x, y] = [axes.x.value, axes.y.value].map(i => data.columns[i]);
  if (!x || !y) return;
  const rows = x.values.map((_, i) => i).filter(i => x.values[i] !== null && y.values[i] !== null);
  if (!rows.length) return;
  const { wide, tall, left, right, top, bottom } = SIZE;
  const across = scale(rows.map(i => x.values[i]), left, wide - right);
  const upwards = scale(rows.map(i => y.values[i]), tall - bottom, top);
  for (const value of across.ticks) {
    add("line", { x1: across.at(value), x2: across.at(value), y1: top, y2: tall - bottom, class: "grid" });
    add("text", { x: across.at(value), y: tall - bottom + 16, "text-anchor": "middle" }, digits(value));
  }
  for (const value of upwards.ticks) {
    add("line", { x1: left, x2: wide - right, y1: upwards.at(value), y2: upwards.at(value), class: "grid" });
    add("text", { x: left - 6, y: upwards.at(value) + 4, "text-anchor": "end" }, digits(value));
  }
  add("text", { x: (left + wide - right) / 2, y: tall - 6, "text-anchor": "middle" }, x.label);
  add("text", { transform: `translate(12 ${(top + tall - bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, y.label);
  const at = i => [across.at(x.values[i]), upwards.at(y.values[i])];
  add("polyline", { points: rows.map(i => at(i).join(",")).join(" "), class: "curve" });
  for (const i of rows) {
    const [cx, cy] = at(i), stored = states.findIndex(state => state.row === i);
    const now = stored >= 0 && stored === +range.value;
    const point = add("circle", { cx, cy, r: now ? 6 : 3, class: now ? "now" : stored < 0 ? "step" : "step stored" });
    point.appendChild(draw("title")).textContent =
      `${x.label} ${digits(x.values[i])}\n${y.label} ${digits(y.values[i])}`;
    if (stored >= 0) point.addEventListener("click", () => {
      setPlaying(false);
      range.value = stored;
      show();
    });
  }
};
for (const [axis, select] of Object.entries(axes)) {
  data.columns.forEach((column, i) => select.add(new Option(column.label, i, false, i === data[axis])));
  select.addEventListener("change", drawCurve);
}
byId("steps").querySelectorAll("tbody tr").forEach((row, i) => row.classList.toggle("failed", data.failed[i]));
show();
