// What the report page uses of three.js; README.md says how three.min.js is made from this.
export {
  Box3, BoxGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, Group, Mesh,
  MeshStandardMaterial, NeutralToneMapping, PMREMGenerator, PerspectiveCamera,
  PlaneGeometry, Quaternion, Scene, ShadowMaterial, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
