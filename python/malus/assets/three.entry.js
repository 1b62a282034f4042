export {
  AmbientLight, Box3, BufferAttribute, BufferGeometry, DirectionalLight, DoubleSide, Mesh, MeshStandardMaterial, PerspectiveCamera,
  Scene, SRGBColorSpace, Texture, Vector3, WebGLRenderer
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
