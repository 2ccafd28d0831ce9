// What differs where no graphics card draws: light is computed for corners instead of pixels, which
// takes a tenth of the time and looks nearly the same.

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
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
const SUNLIGHT = `
  uniform float opacity;
  uniform sampler2DShadow directionalShadowMap[1];
  varying vec4 vDirectionalShadowCoord[1];
  float sunlight() { return texture(directionalShadowMap[0], vDirectionalShadowCoord[0].xyz); }`;
const SOLID = `
  varying vec3 inSun, inShadow;
  void main() {
    gl_FragColor = vec4(mix(inShadow, inSun, inSun.g - inShadow.g > ${LEAST_LIGHT} ? sunlight() : 1.0), opacity);
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
