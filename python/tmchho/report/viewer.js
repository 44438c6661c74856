/* The 3D view: points by WebGL2, orbit, pan and zoom, layers, colours and distances between points.
 *
 * Why our own: one short file that needs nothing else. Reads the scene that scene.py packs: a JSON of words and
 * numbers, and blocks of bytes in base64, all within the page. Positions are 16-bit steps from an origin, which
 * stays here in double precision: coordinates at 4 000 000 m are shown with all their digits.
 */
"use strict";

function startViewer(root) {
  const $ = (selector) => root.querySelector(selector);
  const scene = JSON.parse($("script[data-scene]").textContent);
  const canvas = $("canvas"), status = $("[data-status]"), overlay = $("[data-overlay]");
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
  if (!gl || !gl.getParameter(gl.VERSION)) {
    root.classList.add("no-3d");
    return null;
  }

  // ---- the data

  const bytes = (name) => {
    const script = root.querySelector(`script[data-block="${name}"]`);
    if (!script) return null;
    const text = atob(script.textContent.trim());
    const data = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) data[i] = text.charCodeAt(i);
    script.remove(); // the page need not keep it twice
    return data;
  };
  const positions = new Uint16Array(bytes("positions").buffer);
  const flags = bytes("flags"), colours = bytes("colours");
  const fields = scene.fields.map((_, i) => new Uint16Array(bytes(`field${i}`).buffer));
  const { step, layers, modes } = scene;
  const size = step.map((s) => s * 65535);
  const middle = size.map((s) => s / 2);
  const placeOf = (i) => [0, 1, 2].map((k) => positions[3 * i + k] * step[k] - middle[k]);
  const radius = Math.max(Math.hypot(...size) / 2, 1e-9);

  // ---- matrices: 16 numbers, column by column

  const multiply = (a, b) => {
    const c = new Float32Array(16);
    for (let i = 0; i < 4; i++)
      for (let j = 0; j < 4; j++)
        for (let k = 0; k < 4; k++) c[4 * i + j] += b[4 * i + k] * a[4 * k + j];
    return c;
  };
  const apply = (m, p) =>
    [0, 1, 2, 3].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  // ---- the camera: where it looks, from which direction, how far away

  const FIELD = Math.PI / 5;
  const HOME = { turn: -0.9, tilt: 0.5 };
  let share = 1; // of the points drawn while something moves, so that slow machines keep up
  let wasMoved = false; // by the reader, whose view is then kept whatever the size
  const camera = { at: [...scene.look_at], turn: HOME.turn, tilt: HOME.tilt, away: 1 };
  const axes = () => {
    const [s, c, st, ct] = [Math.sin(camera.turn), Math.cos(camera.turn), Math.sin(camera.tilt), Math.cos(camera.tilt)];
    const back = [ct * s, -ct * c, st], right = [c, s, 0];
    return { back, right, up: cross(back, right) };
  };
  const viewMatrix = () => {
    const { back, right, up } = axes();
    const eye = camera.at.map((v, i) => v + camera.away * back[i]);
    const look = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
    const reach = Math.hypot(...camera.at) + 1.3 * radius * (scene.before ? 2 : 1);
    const far = camera.away + reach, near = Math.max(camera.away - reach, far / 4000);
    const f = 1 / Math.tan(FIELD / 2), aspect = canvas.width / canvas.height;
    const lens = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
      0, 0, 2 * far * near / (near - far), 0]);
    return { matrix: multiply(lens, look), near, far };
  };
  /* Moves back until nearly all points are seen from the present direction, and puts them into the middle. */
  const fit = () => {
    const { back, right, up } = axes(), n = positions.length / 3, every = Math.max(1, Math.floor(n / 3000));
    const high = Math.tan(FIELD / 2), wide = high * canvas.width / Math.max(canvas.height, 1);
    const seen = [];
    for (let i = 0; i < n; i += every) {
      const p = placeOf(i).map((v, k) => v - scene.look_at[k]);
      if (Math.hypot(...p) <= 1.3 * scene.reach) seen.push([dot(right, p), dot(up, p), dot(back, p)]);
    }
    const ends = [0, 1].map((k) => seen.reduce(([a, b], p) => [Math.min(a, p[k]), Math.max(b, p[k])], [Infinity, -Infinity]));
    const [cx, cy] = ends.map(([a, b]) => (a + b) / 2);
    camera.at = scene.look_at.map((v, k) => v + cx * right[k] + cy * up[k]);
    const needed = seen.map(([x, y, z]) => z + Math.max(Math.abs(x - cx) / wide, Math.abs(y - cy) / high));
    camera.away = 1.06 * Math.max(...needed, 1e-6 * radius);
  };

  // ---- programs: points into a texture with their depths, then that texture with edges darkened by depth

  const compile = (vertex, fragment) => {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const uniform = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniform[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniform };
  };
  const points = compile(`
    layout(location=0) in vec3 position; layout(location=1) in float value;
    layout(location=2) in vec3 colour; layout(location=3) in float flags;
    uniform mat4 view, pose; uniform vec3 step_, middle, own, marked, faint; uniform vec2 range;
    uniform int paint, only, bit; uniform float pixels, least, most, height;
    uniform sampler2D ramp; out vec3 shade;
    bool has(int which) { return (int(flags) & which) != 0; }
    void main() {
      vec4 place = pose * vec4(position * step_ - middle, 1.0);
      gl_Position = view * place;
      gl_PointSize = clamp(pixels / gl_Position.w, least, most);
      shade = own;
      if (paint == 1) shade = value > 65534.5 ? faint
        : texture(ramp, vec2(clamp((value - range.x) / (range.y - range.x), 0.0, 1.0) * 0.996 + 0.002, 0.5)).rgb;
      if (paint == 2) shade = colour;
      if (paint == 3) shade = has(bit) ? marked : faint;
      if (paint == 4) shade = texture(ramp, vec2(clamp((place.z + middle.z) / height, 0.0, 1.0), 0.5)).rgb;
      if (only != 0 && !has(only)) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    }`, `
    in vec3 shade; out vec4 pixel;
    void main() { vec2 d = gl_PointCoord - 0.5; if (dot(d, d) > 0.25) discard; pixel = vec4(shade, 1.0); }`);
  const edges = compile(`
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`, `
    uniform sampler2D image, depths; uniform vec2 lens; uniform vec3 ground; uniform int reach; out vec4 pixel;
    float away(ivec2 at) {
      float d = texelFetch(depths, clamp(at, ivec2(0), textureSize(depths, 0) - 1), 0).r;
      return log2(2.0 * lens.x * lens.y / (lens.y + lens.x - (2.0 * d - 1.0) * (lens.y - lens.x)));
    }
    void main() {
      ivec2 at = ivec2(gl_FragCoord.xy);
      vec4 colour = texelFetch(image, at, 0);
      if (colour.a < 0.5) { pixel = vec4(ground, 1.0); return; }
      float here = away(at), dark = 0.0;
      dark += max(0.0, here - away(at + ivec2(reach, 0))) + max(0.0, here - away(at - ivec2(reach, 0)));
      dark += max(0.0, here - away(at + ivec2(0, reach))) + max(0.0, here - away(at - ivec2(0, reach)));
      pixel = vec4(colour.rgb * exp(-32.0 * min(dark, 0.022)), 1.0);
    }`);

  // ---- what lies on the graphics card

  const attribute = (location, data, count, type) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, count, type, location === 2, 0, 0);
  };
  const cloud = gl.createVertexArray(), nothing = gl.createVertexArray();
  gl.bindVertexArray(cloud);
  attribute(0, positions, 3, gl.UNSIGNED_SHORT);
  if (colours) attribute(2, colours, 3, gl.UNSIGNED_BYTE);
  attribute(3, flags, 1, gl.UNSIGNED_BYTE);
  const buffers = fields.map((data) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return buffer;
  });
  const texture = (filter) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, filter);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    return made;
  };
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  const ramps = Object.fromEntries(Object.entries(scene.ramps).map(([name, stops]) => {
    const made = texture(gl.LINEAR);
    const texels = new Uint8Array(stops.flatMap((hex) => [...rgb(hex).map((v) => Math.round(255 * v)), 255]));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, stops.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    return [name, made];
  }));
  const image = texture(gl.NEAREST), depths = texture(gl.NEAREST), frame = gl.createFramebuffer();
  const resize = () => {
    // Where even few points are too many, the pixels are: half as many each way while something moves.
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * (share < 0.3 ? 0.5 : 1);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
    if (canvas.width === w && canvas.height === h) return;
    [canvas.width, canvas.height] = [w, h];
    if (!wasMoved) fit();
    gl.bindTexture(gl.TEXTURE_2D, image);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, w, h, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindTexture(gl.TEXTURE_2D, depths);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.DEPTH_COMPONENT24, w, h, 0, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depths, 0);
  };

  // ---- what the controls say

  const chosen = () => modes[Math.max(0, [...root.querySelectorAll("input[data-mode]")].findIndex((i) => i.checked))];
  const shownLayers = () => layers.filter((_, i) => $(`input[data-layer="${i}"]`).checked);
  const upperEnds = scene.fields.map((field) => field.high);
  const encoded = (field, value) => (value - field.low_end) / field.value_step;
  let asBefore = 0; // 0 where the source lies now, 1 where it lay before

  /* The pose of a layer: between now (identity) and before, turned about the same axis all the way. */
  const poseOf = (layer) => {
    const pose = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    if (!layer.moves || !scene.before || asBefore === 0) return pose;
    const { axis: [x, y, z], angle, centre, shift } = scene.before;
    const [s, c] = [Math.sin(angle * asBefore), Math.cos(angle * asBefore)], k = 1 - c;
    const r = [[c + k * x * x, k * x * y - s * z, k * x * z + s * y], [k * x * y + s * z, c + k * y * y, k * y * z - s * x],
      [k * x * z - s * y, k * y * z + s * x, c + k * z * z]];
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) pose[4 * j + i] = r[i][j];
      pose[12 + i] = centre[i] + asBefore * shift[i] - dot(r[i], centre);
    }
    return pose;
  };

  // ---- drawing, only when something has changed

  let waiting = 0, last = null;
  const draw = () => {
    waiting = 0;
    resize();
    const began = performance.now();
    const style = getComputedStyle(root), dark = style.getPropertyValue("--is-dark").trim() === "1";
    const mode = chosen(), field = mode.field === undefined ? null : scene.fields[mode.field];
    const { matrix, near, far } = (last = viewMatrix());
    const ground = rgb(dark ? "#0f1317" : "#fbfbfa"), hasEdges = share > 0.5;
    gl.bindFramebuffer(gl.FRAMEBUFFER, hasEdges ? frame : null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...ground, hasEdges ? 0 : 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(points.program);
    gl.bindVertexArray(cloud);
    if (field) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[mode.field]);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 1, gl.UNSIGNED_SHORT, false, 0, 0);
    }
    const u = points.uniform, paints = { layer: 0, field: 1, colour: 2, flag: 3, height: 4 };
    const ratio = canvas.height / Math.max(canvas.clientHeight, 1), wish = Number($("[data-size]").value);
    gl.uniformMatrix4fv(u.view, false, matrix);
    gl.uniform3fv(u.step_, step);
    gl.uniform3fv(u.middle, middle);
    gl.uniform1i(u.paint, paints[mode.paint]);
    gl.uniform1i(u.only, mode.only || 0);
    gl.uniform1i(u.bit, mode.bit || 0);
    gl.uniform1f(u.least, 1.6 * ratio * Math.max(wish, 0.6));
    gl.uniform1f(u.most, (hasEdges ? 14 : 5) * ratio * wish);
    gl.uniform1f(u.height, size[2]);
    gl.uniform3fv(u.marked, rgb(scene.marked));
    gl.uniform3fv(u.faint, rgb(dark ? "#5d6670" : "#b4bac1"));
    if (field) gl.uniform2f(u.range, encoded(field, field.low), encoded(field, upperEnds[mode.field]));
    gl.bindTexture(gl.TEXTURE_2D, ramps[field ? field.ramp : "height"]);
    for (const layer of shownLayers()) {
      gl.uniform3fv(u.own, rgb(dark ? layer.colour_on_dark : layer.colour));
      gl.uniformMatrix4fv(u.pose, false, poseOf(layer));
      gl.uniform1f(u.pixels, wish * layer.spacing * canvas.height / (2 * Math.tan(FIELD / 2)) * Math.min(1.5, 1 / Math.sqrt(share)));
      gl.drawArrays(gl.POINTS, layer.first, Math.ceil(layer.count * share));
    }
    if (hasEdges) darkenEdges(near, far, ratio, ground);
    showPicks();
    return performance.now() - began;
  };
  const darkenEdges = (near, far, ratio, ground) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.useProgram(edges.program);
    gl.bindVertexArray(nothing);
    [[gl.TEXTURE0, image, edges.uniform.image, 0], [gl.TEXTURE1, depths, edges.uniform.depths, 1]].forEach(([unit, t, at, i]) => {
      gl.activeTexture(unit);
      gl.bindTexture(gl.TEXTURE_2D, t);
      gl.uniform1i(at, i);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform2f(edges.uniform.lens, near, far);
    gl.uniform1i(edges.uniform.reach, Math.max(1, Math.round(ratio)));
    gl.uniform3fv(edges.uniform.ground, ground);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };
  const redraw = () => { waiting = waiting || requestAnimationFrame(draw); };

  // While something moves, as much is drawn as the machine manages; all of it once it rests.
  let rest = 0, lastMove = 0, manageable = 1;
  const moving = () => {
    wasMoved = true;
    const now = performance.now(), apart = Math.max(1, now - lastMove);
    if (apart < 1500) manageable = Math.min(1, Math.max(0.05, manageable * Math.min(1.15, Math.max(0.5, 33 / apart))));
    share = manageable;
    lastMove = now;
    clearTimeout(rest);
    rest = setTimeout(refine, 200);
    redraw();
  };
  const refine = () => {
    share = Math.min(1, 3 * share);
    redraw();
    if (share < 1) rest = setTimeout(refine, 60);
  };

  // ---- picking: the point nearest to the pointer, of those in front

  const decimals = Math.max(0, Math.min(6, Math.ceil(-Math.log10(Math.max(...step)))));
  let picks = [];
  const project = (local) => {
    const [x, y, , w] = apply(last.matrix, local);
    return [(x / w + 1) / 2 * canvas.clientWidth, (1 - y / w) / 2 * canvas.clientHeight, w];
  };
  const pointAt = (px, py) => {
    last = viewMatrix();
    const only = chosen().only || 0;
    let best = null;
    for (const layer of shownLayers()) {
      const m = multiply(last.matrix, poseOf(layer)), [w2, h2] = [canvas.clientWidth / 2, canvas.clientHeight / 2];
      for (let i = layer.first; i < layer.first + layer.count; i++) {
        if (only && !(flags[i] & only)) continue;
        const x = positions[3 * i] * step[0] - middle[0], y = positions[3 * i + 1] * step[1] - middle[1],
          z = positions[3 * i + 2] * step[2] - middle[2];
        const w = m[3] * x + m[7] * y + m[11] * z + m[15];
        const dx = ((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) * w2 - px;
        const dy = (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) * h2 - py;
        const apart = dx * dx + dy * dy;
        if (w <= 0 || apart > 144) continue;
        const rank = w * (1 + 0.0004 * apart); // nearer to the eye counts more than a pixel nearer
        if (!best || rank < best.rank) best = { rank, i, layer };
      }
    }
    return best;
  };
  const describe = (pick, name) => {
    const given = placeOf(pick.i).map((v, k) => scene.origin[k] + v + middle[k]);
    const mode = chosen(), field = mode.field === undefined ? null : scene.fields[mode.field];
    const code = field ? fields[mode.field][pick.i] : 65535;
    const value = code < 65535 ? `, ${field.label} ${(field.low_end + code * field.value_step).toPrecision(3)}${field.unit}` : "";
    return `${name}: ${pick.layer.name}, x ${given[0].toFixed(decimals)}, y ${given[1].toFixed(decimals)}, z ${given[2].toFixed(decimals)}${value}`;
  };
  const pick = (px, py) => {
    const found = pointAt(px, py);
    if (!found) { status.textContent = "No point there."; return; }
    picks = picks.length === 2 ? [found] : [...picks, found];
    const words = picks.map((p, i) => describe(p, "AB"[i]));
    if (picks.length === 2) {
      const d = [0, 1, 2].map((k) => placeOf(picks[1].i)[k] - placeOf(picks[0].i)[k]);
      const say = (v) => v.toFixed(decimals) + scene.unit;
      words.push(`Distance ${say(Math.hypot(...d))}, level ${say(Math.hypot(d[0], d[1]))}, height difference ${say(d[2])}`);
    } else words.push("Pick a second point to measure the distance.");
    status.replaceChildren(...words.map((text) => Object.assign(document.createElement("div"), { textContent: text })));
    redraw();
  };
  const clearPicks = () => { picks = []; status.textContent = ""; redraw(); };
  const showPicks = () => {
    const at = picks.map((p) => project(apply(poseOf(p.layer), placeOf(p.i))));
    const line = at.length === 2 ? `<path d="M${at.map(([x, y]) => `${x} ${y}`).join("L")}"/>` : "";
    const rings = at.map(([x, y]) => `<circle cx="${x}" cy="${y}" r="5"/>`).join("");
    const names = at.map(([x, y], i) => `<text x="${x + 9}" y="${y - 7}">${"AB"[i]}</text>`).join("");
    overlay.innerHTML = `<g class="halo">${line}${rings}</g><g>${line}${rings}</g>${names}`;
  };

  // ---- moving about

  const orbit = (dx, dy) => {
    camera.turn -= dx;
    camera.tilt = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.tilt + dy));
    moving();
  };
  const pan = (dx, dy) => {
    const { right, up } = axes(), unit = 2 * camera.away * Math.tan(FIELD / 2) / canvas.clientHeight;
    camera.at = camera.at.map((v, k) => v + unit * (dy * up[k] - dx * right[k]));
    moving();
  };
  const zoom = (factor) => {
    camera.away = Math.min(40 * radius, Math.max(radius / 5000, camera.away * factor));
    moving();
  };
  const VIEWS = { oblique: [HOME.turn, HOME.tilt], top: [0, Math.PI / 2], front: [0, 0], side: [Math.PI / 2, 0] };
  const look = (name) => { [camera.turn, camera.tilt] = VIEWS[name]; fit(); redraw(); };

  const pointers = new Map();
  let travelled = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size === 0) travelled = 0;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size > 1) travelled = Infinity; // two fingers never pick
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.hypot(dx, dy);
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const length = (p) => Math.max(8, Math.hypot(p[0] - other[0], p[1] - other[1]));
      zoom(length(before) / length(now));
      pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) pan(dx, dy);
    else orbit(dx * 0.006, dy * 0.006);
    pointers.set(event.pointerId, now);
  });
  const release = (event) => {
    if (event.type === "pointerup" && pointers.size === 1 && travelled < 5 && event.button === 0) {
      const box = canvas.getBoundingClientRect();
      pick(event.clientX - box.left, event.clientY - box.top);
    }
    pointers.delete(event.pointerId);
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", (event) => {
    const box = canvas.getBoundingClientRect(), found = pointAt(event.clientX - box.left, event.clientY - box.top);
    if (found) camera.at = apply(poseOf(found.layer), placeOf(found.i)).slice(0, 3);
    clearPicks();
  });
  canvas.addEventListener("wheel", (event) => {
    // Until the view is clicked the wheel scrolls the page, which many want who only pass by.
    if (!scene.whole_page && document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY * (event.deltaMode ? 30 : 1))) * 0.004));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const move = event.shiftKey ? (x, y) => pan(-40 * x, -40 * y) : (x, y) => orbit(0.1 * x, 0.1 * y);
    const actions = {
      ArrowLeft: () => move(-1, 0), ArrowRight: () => move(1, 0), ArrowUp: () => move(0, -1), ArrowDown: () => move(0, 1),
      "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), Home: () => look("oblique"),
      t: () => look("top"), f: () => look("front"), s: () => look("side"), Escape: clearPicks,
      Enter: () => pick(canvas.clientWidth / 2, canvas.clientHeight / 2),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });

  // ---- controls and legend

  const legend = $("[data-legend]"), upper = $("[data-upper]");
  const showLegend = () => {
    const mode = chosen(), field = mode.field === undefined ? null : scene.fields[mode.field];
    legend.querySelectorAll("[data-legend-of]").forEach((part) => { part.hidden = part.dataset.legendOf !== mode.key; });
    upper.closest("label").hidden = !field;
    if (field) {
      upper.value = upperEnds[mode.field];
      upper.step = 10 ** Math.floor(Math.log10(field.high / 10));
      upper.min = upper.step;
      const ends = legend.querySelector(`[data-legend-of="${mode.key}"]`);
      ends.querySelector("[data-low]").textContent = field.low + field.unit;
      ends.querySelector("[data-high]").textContent = `≥ ${upperEnds[mode.field]}${field.unit}`;
    }
  };
  root.addEventListener("change", (event) => {
    const mode = chosen();
    if (event.target === upper && Number(upper.value) > 0) {
      upperEnds[mode.field] = Number(upper.value);
      if (scene.fields[mode.field].ramp === "diverging") scene.fields[mode.field].low = -Number(upper.value);
    }
    if (event.target.dataset.before !== undefined) return moveTo(event.target.checked ? 1 : 0);
    showLegend();
    redraw();
  });
  $("[data-size]").addEventListener("input", redraw);
  root.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    if (button.dataset.look) look(button.dataset.look);
    if (button.dataset.zoom) zoom(Number(button.dataset.zoom));
    if (button.dataset.clear !== undefined) clearPicks();
    if (button.dataset.full !== undefined)
      document.fullscreenElement ? document.exitFullscreen() : root.requestFullscreen();
  });
  const moveTo = (goal) => {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) { asBefore = goal; return redraw(); }
    const from = asBefore, began = performance.now();
    const go = (now) => {
      const t = Math.min(1, Math.max(0, (now - began) / 700));
      asBefore = from + (goal - from) * t * t * (3 - 2 * t);
      moving();
      if (t < 1) requestAnimationFrame(go);
    };
    requestAnimationFrame(go);
  };
  new ResizeObserver(redraw).observe(canvas);
  new MutationObserver(redraw).observe(document.documentElement, { attributeFilter: ["data-theme"] });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  canvas.addEventListener("webglcontextlost", () => root.classList.add("no-3d"));

  resize();
  showLegend();
  draw();
  performance.mark("tmchho-first-draw");
  return { draw, orbit, pan, zoom, look, pick, picks: () => picks, camera, share: () => share };
}

document.querySelectorAll(".viewer").forEach((root) => { root.viewer = startViewer(root); });
