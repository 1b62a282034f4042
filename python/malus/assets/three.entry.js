// The parts of three.js that mesh_stage.js, mesh_view.js and object_view.js use; README.md says how three.min.js is made from this.
export {
  AmbientLight, BufferAttribute, BufferGeometry, DataTexture, DataUtils, DirectionalLight, DoubleSide, HalfFloatType, LinearFilter, Mesh,
  MeshStandardMaterial, ObjectSpaceNormalMap, OrthographicCamera, RGBAFormat, Scene, SRGBColorSpace, Texture, Vector3, WebGLRenderer
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
export { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
