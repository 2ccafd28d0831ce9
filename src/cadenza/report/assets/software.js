// What differs where no graphics card draws: light is computed for corners instead of pixels, and
// edges are smoothed afterwards, which takes a tenth of the time and looks nearly the same.

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const SHADOW_PIXELS = 1024; // of a side of what the sun sees
const LEAST_LIGHT = 0.1; // of the sun, of 1: nobody sees shadows where there is less, as on black

function lazily(make) {
  let made;
  return () => (made ??= make());
}

/** What draws WebGL here, such as the name of a graphics card; null where nothing does. */
const graphics = lazily(() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return null;
  const about = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(about ? about.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return name;
});
const bySoftware = lazily(() => graphics() === null || SOFTWARE.test(graphics()));

// As three.js lights its standard material, but at each corner: what is seen of it in the sun and in shadow.
const CORNERS = `
  #include <common>
  #include <lights_pars_begin>
  #include <shadowmap_pars_vertex>
  #include <tonemapping_pars_fragment>
  #include <colorspace_pars_fragment>
  uniform vec3 diffuse, emissive;
  uniform float roughness, metalness, envMapIntensity;
  uniform mat3 envMapRotation;
  uniform samplerCube envMap;
  varying vec3 inSun, inShadow;
  vec3 around(vec3 direction, float rough) {
    return envMapIntensity * textureLod(envMap, envMapRotation * inverseTransformDirection(direction, viewMatrix), MAX_LOD * rough * (2.0 - rough)).rgb;
  }
  vec3 shown(vec3 colour) { return sRGBTransferOETF(vec4(NeutralToneMapping(colour), 1.0)).rgb; }
  void main() {
    #include <beginnormal_vertex>
    #include <defaultnormal_vertex>
    #include <begin_vertex>
    #include <project_vertex>
    #include <worldpos_vertex>
    #include <shadowmap_vertex>
    vec3 normal = normalize(transformedNormal), eye = normalize(-mvPosition.xyz), sun = directionalLights[0].direction, middle = normalize(eye + sun);
    vec3 matt = (1.0 - metalness) * diffuse, mirrored = mix(vec3(0.04), diffuse, metalness);
    float alpha = roughness * roughness, spread = pow2(saturate(dot(normal, middle))) * (alpha * alpha - 1.0) + 1.0;
    vec3 rim = mirrored + (max(vec3(1.0 - roughness), mirrored) - mirrored) * pow(1.0 - saturate(dot(normal, eye)), 5.0);
    vec3 shine = mirrored * alpha * alpha / (PI * spread * spread * 4.0 * max(pow2(dot(sun, middle)), 0.1) * (roughness + 0.5));
    vec3 shadow = emissive + matt * around(normal, 1.0) + rim * around(normalize(mix(reflect(-eye, normal), normal, alpha * alpha)), roughness);
    inShadow = shown(shadow);
    inSun = shown(shadow + directionalLights[0].color * saturate(dot(normal, sun)) * (RECIPROCAL_PI * matt + shine));
  }`;
// Each pixel of four looks at a slightly different place of the shadow, so that its edge is soft.
const SUNLIGHT = `
  uniform float opacity;
  uniform sampler2DShadow directionalShadowMap[1];
  varying vec4 vDirectionalShadowCoord[1];
  float sunlight() {
    vec2 odd = mod(floor(gl_FragCoord.xy), 2.0), off = vec2(odd.x + 0.5 * odd.y, odd.y - 0.5 * odd.x) - vec2(0.75, 0.25);
    return texture(directionalShadowMap[0], vDirectionalShadowCoord[0].xyz + vec3(off / ${SHADOW_PIXELS}.0, 0.0));
  }`;
const SOLID = `
  varying vec3 inSun, inShadow;
  void main() {
    vec3 sun = inSun - inShadow;
    gl_FragColor = vec4(inShadow + (sun.g > ${LEAST_LIGHT} ? sunlight() : 1.0) * sun, opacity);
  }`;
const SHADOW = "void main() { gl_FragColor = vec4(0.0, 0.0, 0.0, opacity * (1.0 - sunlight())); }";

/** Has a standard or a shadow material lit at its corners, where software draws; returns it. */
function litCheaply(material) {
  if (!bySoftware()) return material;
  material.onBeforeCompile = (shader) => {
    shader.fragmentShader = SUNLIGHT + (material.isShadowMaterial ? SHADOW : SOLID);
    if (!material.isShadowMaterial) shader.vertexShader = `#define MAX_LOD ${shader.envMapMaxLod}.0\n${CORNERS}`;
  };
  return material;
}

const EDGE = 16; // of 256, by how much brighter a neighbour is at an edge
const SEARCH = 16; // pixels along an edge to either side, after which it ends

/** Smooths the edges of a picture that was drawn without, as FXAA does: along each, pixels take from across it, the more the nearer its end. */
function smoothEdges(context, width, height) {
  const picture = context.getImageData(0, 0, width, height), smooth = new Uint32Array(picture.data.buffer), jagged = smooth.slice();
  const light = new Uint8Array(jagged.length);
  for (let i = 0; i < light.length; i++) light[i] = ((jagged[i] & 255) + ((jagged[i] >> 7) & 510) + ((jagged[i] >> 16) & 255)) >> 2;
  /** After how many times `step` an edge ends, negative where the end is darker than its `mean`. */
  function end(at, across, step, mean, steep) {
    for (let far = 1; ; far++) {
      const off = (light[at + far * step] + light[at + far * step + across]) / 2 - mean;
      if (!(Math.abs(off) < steep && far < SEARCH)) return off > 0 ? far : -far;
    }
  }
  const bend = (at, one) => Math.abs(light[at - one] + light[at + one] - 2 * light[at]);
  for (let y = 1; y < height - 1; y++) {
    for (let at = y * width + 1, last = at + width - 2; at < last; at++) {
      const here = light[at];
      if (Math.abs(here - light[at + 1]) < EDGE && Math.abs(here - light[at + width]) < EDGE && Math.abs(here - light[at - 1]) < EDGE && Math.abs(here - light[at - width]) < EDGE) continue;
      const lies = bend(at - 1, width) + 2 * bend(at, width) + bend(at + 1, width) >= bend(at - width, 1) + 2 * bend(at, 1) + bend(at + width, 1);
      const step = lies ? width : 1, along = lies ? 1 : width, first = light[at - step] - here, second = light[at + step] - here;
      const isFirst = Math.abs(first) >= Math.abs(second), across = isFirst ? -step : step, jump = isFirst ? first : second;
      const mean = here + jump / 2, steep = Math.abs(jump) / 4;
      const back = end(at, across, -along, mean, steep), forth = end(at, across, along, mean, steep), near = Math.abs(back) < Math.abs(forth) ? back : forth;
      if (near > 0 === jump < 0) continue; // it turns away at its nearer end
      const share = 0.5 - Math.abs(near) / (Math.abs(back) + Math.abs(forth));
      if (share <= 0) continue;
      const own = jagged[at], other = jagged[at + across];
      let mixed = 0xff000000;
      for (let shift = 0; shift < 24; shift += 8) mixed |= ((1 - share) * ((own >> shift) & 255) + share * ((other >> shift) & 255)) << shift;
      smooth[at] = mixed;
    }
  }
  context.putImageData(picture, 0, 0);
}
