// The relighting viewer: the object's normals and colors under a light that follows the pointer.
(async () => {
  const root = document.getElementById('relight');
  if (!root) return;
  const canvas = root.querySelector('canvas'), lamp = root.querySelector('.lamp i'), state = root.querySelector('.state');
  const scale = root.querySelector('.scale');
  const control = name => root.querySelector(`[name=${name}]`);
  const gl = canvas.getContext('webgl2', {antialias: false, alpha: true, premultipliedAlpha: true, preserveDrawingBuffer: true});
  if (!gl || typeof DecompressionStream === 'undefined') {
    root.classList.add('unavailable');
    return;
  }

  const data = unpack.block('relight-data');
  const {width, height} = data;

  const vertex = `#version 300 es
    uniform vec2 offset, scale;
    out vec2 at;
    void main() {
      vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
      at = corner;
      gl_Position = vec4(vec2(corner.x, 1.0 - corner.y) * 2.0 * scale + offset, 0, 1);
    }`;
  const fragment = `#version 300 es
    precision highp float;
    uniform sampler2D normals, color;
    uniform vec3 light;
    uniform vec2 medianSlope;
    uniform float exaggeration, specular, gloss, brightness, normalScale;
    uniform int surface;
    in vec2 at;
    out vec4 result;
    float encode(float x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055; }
    void main() {
      vec4 texel = texture(color, at);
      if (texel.a < 0.5) discard;
      vec2 xy = texture(normals, at).xy / normalScale;
      float z = sqrt(max(1.0 - dot(xy, xy), 0.0025));
      // Slopes minus the median slope, so that exaggeration deepens the relief without tilting the object.
      vec2 slope = medianSlope + exaggeration * (xy / z - medianSlope);
      vec3 n = normalize(vec3(slope, 1.0));
      if (surface == 2) { result = vec4(n * 0.5 + 0.5, 1); return; }
      vec3 albedo = surface == 1 ? vec3(0.55) : pow(texel.rgb, vec3(2.2));
      float facing = dot(n, light);
      vec3 halfway = normalize(light + vec3(0, 0, 1));
      float shine = facing > 0.0 ? pow(max(dot(n, halfway), 0.0), gloss) * (gloss + 8.0) / 25.0 : 0.0;
      vec3 linear = albedo * brightness * (0.06 + 1.15 * max(facing, 0.0)) * (1.0 - 0.7 * specular) + vec3(specular * 0.5 * shine);
      linear = min(linear, vec3(1.0));
      result = vec4(encode(linear.r), encode(linear.g), encode(linear.b), 1);
    }`;

  function compile(type, source) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  }

  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  gl.useProgram(program);
  const uniform = name => gl.getUniformLocation(program, name);

  function texture(unit, upload) {
    const handle = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, handle);
    upload();
    for (const [key, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
                                [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]])
      gl.texParameteri(gl.TEXTURE_2D, key, value);
    return handle;
  }

  async function normalTexture(surface) {
    const planes = await unpack.normals(data, surface), count = width * height, pairs = new Float32Array(2 * count);
    for (let i = 0; i < count; ++i) {
      pairs[2 * i] = planes[i];
      pairs[2 * i + 1] = planes[count + i];
    }
    // Half floats: exact for whole numbers up to 2048, and every WebGL 2 interpolates them.
    return texture(0, () => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG16F, width, height, 0, gl.RG, gl.FLOAT, pairs));
  }

  const maps = {fused: await normalTexture('fused'), prior: await normalTexture('prior')};
  const image = await unpack.picture(data.color);
  gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  texture(1, () => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image));
  gl.uniform1i(uniform('normals'), 0);
  gl.uniform1i(uniform('color'), 1);
  gl.uniform1f(uniform('normalScale'), data.scale);
  gl.uniform2f(uniform('medianSlope'), ...data.median_slope);

  // Light: direction in the image, length = sine of the angle from the view direction.
  const start = {light: [-0.6, 0.55], zoom: 1, pan: [0, 0]};
  let {light, zoom, pan} = structuredClone(start);
  let held = false, waiting = false;

  function fit() {
    return Math.min(canvas.width / width, canvas.height / height);
  }

  function draw() {
    waiting = false;
    const density = Math.min(window.devicePixelRatio || 1, 2);
    const w = Math.round(canvas.clientWidth * density), h = Math.round(canvas.clientHeight * density);
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const sx = fit() * zoom * width / w, sy = fit() * zoom * height / h;
    gl.uniform2f(uniform('scale'), sx, sy);
    gl.uniform2f(uniform('offset'), 2 * pan[0] / canvas.clientWidth - sx, -2 * pan[1] / canvas.clientHeight - sy);
    gl.uniform3f(uniform('light'), light[0], light[1], Math.sqrt(Math.max(0, 1 - light[0] ** 2 - light[1] ** 2)));
    const value = name => Number(control(name).value);
    gl.uniform1f(uniform('exaggeration'), value('exaggeration'));
    gl.uniform1f(uniform('specular'), value('specular'));
    gl.uniform1f(uniform('gloss'), 2 ** value('gloss'));
    gl.uniform1f(uniform('brightness'), value('brightness'));
    gl.uniform1i(uniform('surface'), ['albedo', 'plain', 'normals'].indexOf(control('paint').value));
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, maps[control('source').value]);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    lamp.style.transform = `translate(${light[0] * 20}px, ${-light[1] * 20}px)`;
    for (const output of root.querySelectorAll('output')) {
      const input = control(output.htmlFor.value);
      output.textContent = output.htmlFor.value === 'gloss' ? Math.round(2 ** input.value) : Number(input.value).toFixed(2);
    }
    const azimuth = Math.round((450 - Math.atan2(light[1], light[0]) * 180 / Math.PI) % 360);
    const elevation = Math.round(Math.acos(Math.min(1, Math.hypot(...light))) * 180 / Math.PI);
    state.textContent = `Light from ${azimuth}° (clockwise from up), ${elevation}° high${held ? ', held' : ''}; zoom ${zoom.toFixed(1)}×`;
    drawScaleBar(scale, data.gsd * data.meters * density / (fit() * zoom));
  }

  function redraw() {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  }

  function setLight(x, y) {
    const length = Math.hypot(x, y), most = 0.985;
    light = length > most ? [x * most / length, y * most / length] : [x, y];
    redraw();
  }

  // Zooms about the point at (x, y), in CSS pixels from the center of the canvas.
  function zoomAt(factor, x = 0, y = 0) {
    const next = Math.min(40, Math.max(1, zoom * factor)), ratio = next / zoom;
    pan = [x + (pan[0] - x) * ratio, y + (pan[1] - y) * ratio];
    zoom = next;
    if (zoom === 1) pan = [0, 0];
    redraw();
  }

  const fromMiddle = event => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
  };
  const lightAt = event => {
    const [x, y] = fromMiddle(event), radius = Math.min(canvas.clientWidth, canvas.clientHeight) / 2;
    setLight(x / radius, -y / radius);
  };

  const fingers = new Map();
  let moved = 0;
  canvas.addEventListener('pointerdown', event => {
    canvas.focus({preventScroll: true});
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    moved = 0;
  });
  canvas.addEventListener('pointermove', event => {
    const before = fingers.get(event.pointerId);
    if (!before) {
      if (!held) lightAt(event);
      return;
    }
    moved += Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY);
    if (fingers.size === 2) {
      const other = [...fingers.values()].find(finger => finger.pointerId !== event.pointerId);
      const gap = finger => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
      zoomAt(gap(event) / Math.max(gap(before), 1), ...fromMiddle(event));
    } else if (event.pointerType === 'touch' && !held) {
      lightAt(event);
    } else {
      pan = [pan[0] + event.clientX - before.clientX, pan[1] + event.clientY - before.clientY];
      redraw();
    }
    fingers.set(event.pointerId, event);
  });
  for (const kind of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(kind, event => {
      fingers.delete(event.pointerId);
      if (kind === 'pointerup' && moved < 4 && event.pointerType !== 'touch') {
        held = !held;
        if (!held) lightAt(event);
        redraw();
      }
    });
  }
  canvas.addEventListener('wheel', event => {
    // The wheel scrolls the page until the picture has the focus, by a click or by the keyboard.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoomAt(Math.exp(-event.deltaY * 0.0015), ...fromMiddle(event));
  }, {passive: false});

  function reset() {
    ({light, zoom, pan} = structuredClone(start));
    held = false;
    root.querySelector('form').reset();
    redraw();
  }

  canvas.addEventListener('keydown', event => {
    const arrows = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key];
    if (arrows && event.shiftKey) {
      pan = [pan[0] - 30 * arrows[0], pan[1] + 30 * arrows[1]];
      redraw();
    } else if (arrows) {
      held = true;
      setLight(light[0] + 0.06 * arrows[0], light[1] + 0.06 * arrows[1]);
    } else if (event.key === '+' || event.key === '=') {
      zoomAt(1.25);
    } else if (event.key === '-') {
      zoomAt(0.8);
    } else if (event.key === '0') {
      reset();
    } else if (event.key === ' ') {
      held = !held;
      redraw();
    } else {
      return;
    }
    event.preventDefault();
  });
  root.addEventListener('input', redraw);
  root.querySelector('[data-act=in]').addEventListener('click', () => zoomAt(1.5));
  root.querySelector('[data-act=out]').addEventListener('click', () => zoomAt(1 / 1.5));
  root.querySelector('[data-act=reset]').addEventListener('click', reset);
  new ResizeObserver(redraw).observe(canvas);
  draw();
  root.classList.add('ready');
})();
