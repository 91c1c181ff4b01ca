// WebGL 2 renderer: lit solids with occlusion and shadows, drawn when they or the camera move; then
// in each frame device, proxy and plumb line, at the pixels' depths.
import { Kept } from "./kept.js";
import { AMBIENT, LIGHT } from "./light.js";
import { coarser, normalsOf } from "./solids.js";
import { axesOf, dot, minus } from "./camera.js";

const SHADOW = 1024; // side of the shadow's picture [pixels]
const SHADED = 0.72; // brightness in a shadow
const SAMPLES = 4; // per pixel; 1 where a processor draws what moves
const QUICK = 16000; // triangles of a part that a processor draws while the camera turns
const INPUTS = ["point", "normal"], POINT = 0, NORMAL = 1;
const BY_PROCESSOR = /swiftshader|llvmpipe|softpipe|software|basic render/i;

const SOLID = `#version 300 es
uniform mat3 view; uniform vec3 middle, scale, offset; uniform mat3 turn; uniform vec3 place;
in vec3 point; in vec3 normal; out vec3 at; out vec3 facing;
void main() {
  at = turn * point + place; facing = turn * normal;
  gl_Position = vec4(view * (at - middle) * scale + offset, 1.0);
}`;
// How open it is straight above: 0 in a shadow.
const SHADOWED = `#version 300 es
precision highp float; precision highp sampler2DShadow;
uniform vec3 tint, away, light, middle; uniform float ambient, shaded, reach; uniform int soft;
uniform sampler2DShadow shadow;
in vec3 at; in vec3 facing; out vec4 colour;
float open() {
  // Nothing shades itself.
  vec3 s = vec3((at.xy - middle.xy) / (4.0 * reach) + 0.5, 0.5 - (at.z - middle.z) / (8.0 * reach) - 0.004);
  if (!all(lessThan(abs(s.xy - 0.5), vec2(0.5)))) return 1.0;
  if (soft == 0) return texture(shadow, s);
  float sum = 0.0;
  for (int i = -soft; i <= soft; i++) for (int j = -soft; j <= soft; j++) sum += texture(shadow, s + vec3(vec2(i, j) * 0.0015, 0.0));
  return sum / float((2 * soft + 1) * (2 * soft + 1));
}`;
const SHADE = `${SHADOWED}
uniform bool flatly;
void main() {
  vec3 n = normalize(flatly ? cross(dFdx(at), dFdy(at)) : facing);
  if (dot(n, away) > 0.0) n = -n;
  float lit = ambient * (0.8 + 0.2 * n.z) + (1.0 - ambient) * max(dot(n, light), 0.0);
  if (n.z > 0.05) lit *= mix(1.0, mix(shaded, 1.0, open()), smoothstep(0.05, 0.35, n.z));
  colour = vec4(tint * lit, 1.0);
}`;
// The ground: lines of a grid, which fade outwards; it does not hide what is below.
const GROUND = `${SHADOWED}
uniform float grid;
void main() {
  float far = length(at.xy - middle.xy) / (1.9 * reach);
  if (far >= 1.0) discard;
  vec2 cell = at.xy / grid, line = abs(fract(cell - 0.5) - 0.5) / fwidth(cell);
  float on = 1.0 - min(min(line.x, line.y), 1.0), alpha = 1.0 - smoothstep(0.55, 1.0, far), lit;
  if (away.z > 0.0) { lit = 0.6 * ambient / (ambient + (1.0 - ambient) * light.z); alpha *= 0.25; }
  else lit = mix(shaded, 1.0, open());
  colour = vec4(tint * (1.0 - 0.18 * on) * lit * alpha, alpha);
}`;
const WHOLE = `#version 300 es
out vec2 uv;
void main() { uv = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2); gl_Position = vec4(uv * 2.0 - 1.0, 0.0, 1.0); }`;
// Depths as bytes of a colour.
const BYTES = `#version 300 es
precision highp float;
uniform sampler2D depths; in vec2 uv; out vec4 colour;
void main() {
  int d = int(texture(depths, uv).r * 16777215.0 + 0.5);
  colour = vec4(d >> 16, (d >> 8) & 255, d & 255, 255) / 255.0;
}`;
const COMPOSE = `#version 300 es
precision highp float;
uniform sampler2D scene, depths; uniform mat3 view; uniform vec3 middle, scale, light;
uniform vec4 device, proxy; uniform vec3 deviceTint, proxyTint, lineTint; uniform float landing, ambient, pixel;
in vec2 uv; out vec4 colour;
vec4 over(vec4 below, vec3 tint, float alpha) { return vec4(tint * alpha, alpha) + below * (1.0 - alpha); }
// A ball in parallel projection; weaker where something is in front of it.
vec4 ball(vec4 below, vec2 at, float front, vec4 one, vec3 tint) {
  vec3 centre = view * (one.xyz - middle);
  vec2 o = at - centre.xy; float r = length(o);
  if (r > one.w + pixel) return below;
  float high = sqrt(max(one.w * one.w - r * r, 0.0)), hidden = step(front, centre.z - high - 2.0 * pixel);
  vec3 n = vec3(o, -high) / one.w * view;
  float lit = ambient + (1.0 - ambient) * max(dot(n, light), 0.0);
  return over(below, tint * lit, mix(1.0, 0.4, hidden) * clamp((one.w - r) / pixel + 0.5, 0.0, 1.0));
}
void main() {
  vec4 c = texture(scene, uv); float d = texture(depths, uv).r;
  vec2 at = (uv * 2.0 - 1.0) / scale.xy; float front = (d * 2.0 - 1.0) / scale.z;
  vec3 world = vec3(at, front) * view + middle;
  float r = length(world.xy - device.xy), near = device.w * 1.1;
  if (d < 1.0 && abs(world.z - landing) < 2.0 * near && world.z < device.z - 0.2 * device.w) c.rgb *= 1.0 - 0.5 * (1.0 - smoothstep(0.75 * near, near, r));
  // The plumb line, from the device to where it lands.
  vec3 a = view * (device.xyz - middle), b = view * (vec3(device.xy, landing) - middle);
  vec2 way = b.xy - a.xy; float part = clamp(dot(at - a.xy, way) / max(dot(way, way), 1e-20), 0.0, 1.0);
  float off = length(at - a.xy - part * way), deep = mix(a.z, b.z, part);
  float dash = step(0.45, fract(part * length(way) / (9.0 * pixel)));
  float line = clamp(1.3 - off / pixel, 0.0, 1.0) * dash * (deep > front + 2.0 * pixel ? 0.25 : 0.9);
  c = over(c, lineTint, line);
  if (proxy.w > 0.0) c = ball(c, at, front, proxy, proxyTint);
  c = ball(c, at, front, device, deviceTint);
  colour = c;
}`;

export class Lit {
  // Return a renderer; null without WebGL 2.
  static made() {
    const gl = document.createElement("canvas").getContext("webgl2", { antialias: false, depth: false, premultipliedAlpha: true });
    return gl && !gl.isContextLost() ? new Lit(gl, rendererOf(gl)) : null;
  }

  constructor(gl, renderer) {
    Object.assign(this, { gl, renderer, meshes: [], targets: new Map(), shadowed: "", slow: BY_PROCESSOR.test(renderer) });
    // The canvas that has the picture.
    this.kept = this.slow ? new Kept() : null;
    this.canvas = this.kept?.canvas ?? gl.canvas;
    this.solid = program(gl, SOLID, SHADE);
    this.floor = program(gl, SOLID, GROUND);
    this.compose = program(gl, WHOLE, COMPOSE);
    this.bytes = program(gl, WHOLE, BYTES);
    this.none = gl.createVertexArray();
    this.shadow = texture(gl, gl.DEPTH_COMPONENT24, SHADOW, SHADOW, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL);
    this.shadowFrame = frame(gl, null, this.shadow);
  }

  // Upload the parts, once.
  load(solids) {
    const { gl } = this;
    for (const { array, buffers } of this.meshes) {
      gl.deleteVertexArray(array);
      for (const buffer of buffers) gl.deleteBuffer(buffer);
    }
    this.solids = solids;
    const made = (part) => this.mesh(part, part.flat ? null : normalsOf(part));
    this.whole = solids.parts.map(made);
    // A finer part is drawn coarser, and closed, as long as the camera turns.
    const quick = solids.parts.map((part) => (this.slow ? coarser(part, QUICK) : part));
    this.quick = quick.map((part, k) => (part === solids.parts[k] ? this.whole[k] : made(part)));
    this.coarse = this.quick.some((mesh, k) => mesh !== this.whole[k]);
    this.meshes = [...new Set([...this.whole, ...this.quick])];
    this.ground = this.mesh({ points: new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]), faces: new Uint16Array([0, 1, 2, 0, 2, 3]) }, null);
    this.meshes.push(this.ground);
    this.shadowed = "";
  }

  mesh({ points, faces, closed = false }, normals) {
    const { gl } = this, array = gl.createVertexArray(), buffers = [];
    const filled = (kind, data) => {
      buffers.push(gl.createBuffer());
      gl.bindBuffer(kind, buffers.at(-1));
      gl.bufferData(kind, data, gl.STATIC_DRAW);
    };
    gl.bindVertexArray(array);
    filled(gl.ARRAY_BUFFER, points);
    gl.enableVertexAttribArray(POINT);
    gl.vertexAttribPointer(POINT, 3, gl.FLOAT, false, 0, 0);
    if (normals) {
      filled(gl.ARRAY_BUFFER, normals);
      gl.enableVertexAttribArray(NORMAL);
      gl.vertexAttribPointer(NORMAL, 3, gl.FLOAT, false, 0, 0);
    }
    filled(gl.ELEMENT_ARRAY_BUFFER, faces);
    gl.bindVertexArray(null);
    return { array, buffers, count: faces.length, type: faces.BYTES_PER_ELEMENT === 4 ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, flatly: normals === null, closed };
  }

  // Draw the solids; `turn` is the camera, `pixels` how many a metre has, `tints` their colours,
  // `turning` whether another picture follows at once, and `least` the share of its pixels. Return whether this one has less detail.
  draw({ turn, pixels, width, height, ground, tints, turning, least = 0 }) {
    const { gl, canvas, kept } = this, far = 6 * turn.reach, { right, up, away } = axesOf(turn), began = performance.now();
    const share = turning && kept ? kept.share(least) : 1, into = this.target(turning, [canvas.width, canvas.height].map((side) => Math.ceil(side * share)));
    this.view = { matrix: [right, up, away], middle: turn.middle, scale: [(2 * pixels) / width, (2 * pixels) / height, 1 / far], pixel: 1 / (pixels * (canvas.width / width)) };
    this.drawn = turning ? this.quick : this.whole;
    const shadowed = `${this.solids.version} ${turn.reach}`;
    if (this.shadowed !== shadowed) {
      this.pass(this.shadowFrame, SHADOW, SHADOW, { matrix: [[1, 0, 0], [0, 1, 0], [0, 0, -1]], scale: [0.5 / turn.reach, 0.5 / turn.reach, 0.25 / turn.reach] }, turn, null, ground, away);
      this.shadowed = shadowed;
    }
    this.pass(into.many, into.width, into.height, this.view, turn, tints, ground, away);
    // Several samples a pixel become one.
    if (into.many !== into.one) this.copy(into, into.many, into.one, gl.COLOR_BUFFER_BIT, gl.DEPTH_BUFFER_BIT);
    this.into = into;
    if (kept) {
      kept.take(this.read(into));
      if (turning) kept.pace(performance.now() - began);
    }
    return turning && (this.coarse || this.slow);
  }

  // Read colours and depths of the solids.
  read({ one, depths, width, height, bytes }) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, one);
    const found = { width, height, colours: pixels(gl, width, height) };
    gl.bindFramebuffer(gl.FRAMEBUFFER, bytes);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(this.bytes.program);
    gl.bindVertexArray(this.none);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, depths);
    gl.uniform1i(this.bytes.depths, 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return { ...found, depths: pixels(gl, width, height) };
  }

  copy({ width, height }, from, to, ...bits) {
    const { gl } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to);
    for (const bit of bits) gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, bit, gl.NEAREST);
  }

  pass(target, width, height, { matrix, scale }, turn, tints, ground, away) {
    const { gl, solid, floor } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.activeTexture(gl.TEXTURE0);
    // The shadow's own picture must not be read while it is drawn.
    gl.bindTexture(gl.TEXTURE_2D, tints ? this.shadow : null);
    this.use(solid, { matrix, scale }, turn, away);
    this.solids.parts.forEach((part, k) => {
      const pose = this.solids.at(part);
      if (pose && (tints || !part.tool)) this.put(solid, this.drawn[k], pose, tints?.[k] ?? [0, 0, 0]);
    });
    if (!tints) return;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.use(floor, { matrix, scale }, turn, away);
    gl.uniform1f(floor.grid, ground.cell);
    const wide = 2 * turn.reach, [x, y] = turn.middle;
    this.put(floor, this.ground, [x, y, ground.at, wide, 0, 0, 0, wide, 0, 0, 0, 1], tints.ground);
  }

  // Choose a program, with camera, light and shadow.
  use(drawn, { matrix, scale }, turn, away) {
    const { gl } = this;
    gl.useProgram(drawn.program);
    gl.uniformMatrix3fv(drawn.view, false, columns(matrix));
    gl.uniform3fv(drawn.middle, turn.middle);
    gl.uniform3fv(drawn.scale, scale);
    gl.uniform3fv(drawn.offset, [0, 0, 0]);
    gl.uniform3fv(drawn.away, away);
    gl.uniform3fv(drawn.light, LIGHT);
    gl.uniform1f(drawn.ambient, AMBIENT);
    gl.uniform1f(drawn.shaded, SHADED);
    gl.uniform1f(drawn.reach, turn.reach);
    gl.uniform1i(drawn.soft, this.slow ? 0 : 1);
    gl.uniform1i(drawn.shadow, 0);
  }

  put(drawn, { array, count, type, flatly, closed }, [x, y, z, ...rows], tint) {
    const { gl } = this;
    gl.bindVertexArray(array);
    if (flatly) gl.vertexAttrib3f(NORMAL, 0, 0, 1);
    gl.uniform1i(drawn.flatly, flatly);
    // The inside of what is closed is never seen.
    if (closed) gl.enable(gl.CULL_FACE); else gl.disable(gl.CULL_FACE);
    gl.uniform3f(drawn.place, x, y, z);
    gl.uniformMatrix3fv(drawn.turn, false, columns([rows.slice(0, 3), rows.slice(3, 6), rows.slice(6, 9)]));
    gl.uniform3fv(drawn.tint, tint);
    gl.drawElements(gl.TRIANGLES, count, type, 0);
  }

  // Device and proxy: balls of a centre and a radius [m]; null for none.
  finish({ device, proxy, landing, tints }) {
    const { gl, canvas, compose: c, view, into, kept } = this;
    // Only what device, proxy, line and shadow can change.
    const patch = device && this.around([device, [device[0], device[1], landing, 1.5 * device[3]], ...(proxy ? [proxy] : [])]);
    if (kept) return kept.put(patch, view, { device, proxy, landing, tints });
    this.copy(into, into.one, null, gl.COLOR_BUFFER_BIT);
    if (!device) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...patch);
    gl.useProgram(c.program);
    gl.bindVertexArray(this.none);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, into.colours);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, into.depths);
    gl.uniform1i(c.scene, 0);
    gl.uniform1i(c.depths, 1);
    gl.uniformMatrix3fv(c.view, false, columns(view.matrix));
    gl.uniform3fv(c.middle, view.middle);
    gl.uniform3fv(c.scale, view.scale);
    gl.uniform3fv(c.light, LIGHT);
    gl.uniform1f(c.ambient, AMBIENT);
    gl.uniform1f(c.pixel, view.pixel);
    gl.uniform4fv(c.device, device);
    gl.uniform4fv(c.proxy, proxy ?? [0, 0, 0, 0]);
    gl.uniform1f(c.landing, landing);
    gl.uniform3fv(c.deviceTint, tints.device);
    gl.uniform3fv(c.proxyTint, tints.proxy);
    gl.uniform3fv(c.lineTint, tints.line);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindVertexArray(null);
    gl.disable(gl.SCISSOR_TEST);
  }

  // The part of the picture that contains some balls: left, bottom, width and height [pixels].
  around(balls) {
    const { canvas: { width, height }, view: { matrix, middle, scale, pixel } } = this, low = [width, height], high = [0, 0];
    for (const [x, y, z, radius] of balls) {
      const from = minus([x, y, z], middle);
      [width, height].forEach((wide, k) => {
        const at = (0.5 + 0.5 * scale[k] * dot(matrix[k], from)) * wide, far = radius / pixel + 2;
        low[k] = Math.min(low[k], Math.max(0, Math.floor(at - far)));
        high[k] = Math.max(high[k], Math.min(wide, Math.ceil(at + far)));
      });
    }
    return [low[0], low[1], Math.max(0, high[0] - low[0]), Math.max(0, high[1] - low[1])];
  }

  // Where solids are drawn, of a size [pixels]: several samples a pixel, but one where a processor
  // draws what moves.
  target(turning, [width, height]) {
    const old = this.targets.get(turning);
    if (old?.width === width && old.height === height) return old;
    old?.free();
    const { gl } = this, colours = texture(gl, gl.RGBA8, width, height, gl.NEAREST), depths = texture(gl, gl.DEPTH_COMPONENT24, width, height, gl.NEAREST);
    const one = frame(gl, colours, depths), frames = [one], buffers = [];
    let many = one, bytes = null;
    if (this.slow) {
      bytes = gl.createFramebuffer();
      frames.push(bytes);
      buffers.push(buffered(gl, bytes, gl.COLOR_ATTACHMENT0, gl.RGBA8, width, height, 0));
    }
    if (!this.slow || !turning) {
      many = gl.createFramebuffer();
      frames.push(many);
      for (const [format, place] of [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
        buffers.push(buffered(gl, many, place, format, width, height, Math.min(SAMPLES, gl.getParameter(gl.MAX_SAMPLES))));
      }
    }
    const free = () => {
      for (const each of [colours, depths]) gl.deleteTexture(each);
      for (const each of frames) gl.deleteFramebuffer(each);
      for (const each of buffers) gl.deleteRenderbuffer(each);
    };
    const made = { width, height, colours, depths, one, many, bytes, free };
    this.targets.set(turning, made);
    return made;
  }
}

// Name of what draws.
function rendererOf(gl) {
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  return gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}

function pixels(gl, width, height) {
  const found = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, found);
  return found;
}

function buffered(gl, into, place, format, width, height, samples) {
  const buffer = gl.createRenderbuffer();
  gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
  gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, into);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
  return buffer;
}

// A matrix by rows, in the order of WebGL.
const columns = ([a, b, c]) => [a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]];

function texture(gl, format, width, height, filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return made;
}

function frame(gl, colours, depths) {
  const made = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, made);
  if (colours) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, colours, 0);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depths, 0);
  return made;
}

// A program with the places of its inputs and uniforms by name.
function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(`shader: ${gl.getShaderInfoLog(shader)}`);
    gl.attachShader(made, shader);
  }
  // The same places of inputs in all programs, for the same buffers.
  INPUTS.forEach((name, place) => gl.bindAttribLocation(made, place, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(`program: ${gl.getProgramInfoLog(made)}`);
  const found = { program: made };
  for (let k = 0; k < (gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) ?? 0); k++) {
    const { name } = gl.getActiveUniform(made, k);
    found[name] = gl.getUniformLocation(made, name);
  }
  return found;
}
