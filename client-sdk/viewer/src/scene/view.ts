// SPDX-License-Identifier: Apache-2.0
// Renderer, light, camera and the loop. It draws while something changes, and rests otherwise.
import {
  Color, DirectionalLight, HemisphereLight, MOUSE, NeutralToneMapping, PCFShadowMap, PerspectiveCamera,
Raycaster, Scene, TOUCH, Vector2, Vector3,
  WebGLRenderer, type Object3D,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Vec3 } from "../maths/vector";
import type { CameraPlace, SceneAxes } from "./cameras";

const kFov_deg = 28;
const kAwake_ms = 400;
const kFly_ms = 450;
const kSlowFrame_ms = 45;
const kFastFrame_ms = 20;
/** Pixels of the picture to one of the page: the fewest, with which a page without a GPU begins. */
const kLeastRatio = 0.6;

/** Whether a processor draws, without a GPU: shadows would cost it most of its time. */
function isSoftware(context: WebGL2RenderingContext): boolean {
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class View {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(kFov_deg, 1, 1e-4, 10);
  readonly canvas: HTMLCanvasElement;
  readonly #renderer: WebGLRenderer;
  // A warm key that casts shadows, a cool fill beside the camera, a rim from behind, and the sky.
  readonly #key = new DirectionalLight(0xfff2e6, 2.0);
  readonly #fill = new DirectionalLight(0xe6eeff, 1.0);
  readonly #rim = new DirectionalLight(0xbfd4ff, 0.9);
  readonly #sky = new HemisphereLight(0xe9f0ff, 0x9a8078, 1.25);
  #controls: OrbitControls;
  #awakeUntil_ms = 0;
  #ratio: number;
  readonly #best: boolean;
  #adapts = false;
  #frame_ms = 16;
  #lastDrawn_ms = 0;
  #flight: { from: CameraPlace; to: CameraPlace; start_ms: number } | undefined;
  #handMode = false;
  /** Called once a display frame, before it is drawn. */
  onFrame: (now_ms: number) => void = () => {};
  /** Called after each picture. */
  onDrawn: (() => void) | undefined;
  framesDrawn = 0;

  /** `best`: shadows and all pixels, however slow. Throws where the browser has no WebGL 2. */
  constructor(canvas: HTMLCanvasElement, best: boolean) {
    this.canvas = canvas;
    // A context that is made in its size need not be made again, for which a page without a GPU waits long.
    this.#ratio = kLeastRatio;
    [canvas.width, canvas.height] = this.#pixels();
    const context = canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "high-performance" });
    if (!context) throw new Error("this browser has no WebGL 2, which the picture needs");
    this.#renderer = new WebGLRenderer({ canvas, context });
    // To ask a program whether it was made is to wait until it is: a second of the page's time without a GPU.
    this.#renderer.debug.checkShaderErrors = import.meta.env.DEV;
    const plain = !best && isSoftware(context);
    this.#renderer.toneMapping = NeutralToneMapping;
    this.#renderer.toneMappingExposure = 0.86;
    this.#renderer.shadowMap.enabled = !plain;
    this.#renderer.shadowMap.type = PCFShadowMap;
    if (!plain) this.#ratio = Math.min(devicePixelRatio, 2);
    this.#best = best;
    this.#key.castShadow = !plain;
    this.#key.shadow.mapSize.set(2048, 2048);
    this.#key.shadow.bias = -0.0006;
    this.#key.shadow.normalBias = 0.00025;
    this.#key.shadow.radius = 6;
    this.scene.add(this.#sky, this.#key, this.#key.target, this.#fill, this.#fill.target, this.#rim, this.#rim.target);
    this.camera.position.set(0.1, 0.06, 0.06);
    this.#controls = this.#makeControls(new Vector3());
    new ResizeObserver(() => this.#resize()).observe(canvas.parentElement!);
    this.#resize();
    const loop = (now_ms: number) => {
      requestAnimationFrame(loop);
      this.#tick(now_ms);
    };
    requestAnimationFrame(loop);
  }

  /** Draws for a while. */
  wake(): void {
    this.#awakeUntil_ms = performance.now() + kAwake_ms;
  }

  /** From now on pictures have fewer pixels where they come slowly: the scene is on show. */
  adapt(): void {
    this.#adapts = !this.#best;
  }

  get aspect(): number {
    return this.camera.aspect;
  }
  get fov_rad(): number {
    return (kFov_deg * Math.PI) / 180;
  }
  get target(): Vec3 {
    return this.#controls.target.toArray() as Vec3;
  }
  get size(): { width: number; height: number } {
    return { width: this.canvas.clientWidth, height: this.canvas.clientHeight };
  }

  set background(colour: string) {
    const dark = new Color(colour).getHSL({ h: 0, s: 0, l: 0 }).l < 0.5;
    this.#sky.intensity = dark ? 1.25 : 1.6;
    this.wake();
  }

  /** Makes the programs that will draw `object`, while its data are still on the way. */
  prepare(object: Object3D): void {
    this.#renderer.compile(object, this.camera, this.scene);
  }

  /** Sets light, clipping and the camera's up for a scene of that size. */
  setAxes(axes: SceneAxes): void {
    const centre = new Vector3(...axes.centre);
    this.camera.near = axes.radius / 100;
    this.camera.far = axes.radius * 60;
    this.camera.up.set(...axes.up);
    const light = new Vector3(...axes.front).multiplyScalar(1.1).addScaledVector(new Vector3(...axes.up), 1.7)
      .addScaledVector(new Vector3(...axes.along), -0.7).normalize();
    this.#key.position.copy(centre).addScaledVector(light, axes.radius * 4);
    for (const light of [this.#key, this.#fill, this.#rim]) light.target.position.copy(centre);
    const place = (light: DirectionalLight, front: number, up: number, along: number) =>
      light.position.copy(centre).addScaledVector(new Vector3(...axes.front), front * axes.radius)
        .addScaledVector(new Vector3(...axes.up), up * axes.radius).addScaledVector(new Vector3(...axes.along), along * axes.radius);
    place(this.#fill, 3, 0.4, 2.5);
    place(this.#rim, -3, 0.8, 0.5);
    const shadow = this.#key.shadow.camera;
    shadow.left = shadow.bottom = -axes.radius * 1.25;
    shadow.right = shadow.top = axes.radius * 1.25;
    shadow.near = axes.radius;
    shadow.far = axes.radius * 8;
    shadow.updateProjectionMatrix();
    const target = this.#controls.target.clone();
    this.#controls.dispose();
    this.#controls = this.#makeControls(target);
    this.#applyHandMode();
    this.#resize();
  }

  /** Looks from there, at once or in a short flight. */
  goTo(place: CameraPlace, fly: boolean): void {
    if (fly && !matchMedia("(prefers-reduced-motion: reduce)").matches) {
      const from = { position: this.camera.position.toArray() as Vec3, target: this.target };
      this.#flight = { from, to: place, start_ms: performance.now() };
    } else {
      this.#flight = undefined;
      this.camera.position.set(...place.position);
      this.#controls.target.set(...place.target);
      this.#controls.update();
      this.camera.updateMatrixWorld();
    }
    this.wake();
  }

  /** Turns about the target by angles in radians. */
  orbit(azimuth: number, elevation: number): void {
    const offset = this.camera.position.clone().sub(this.#controls.target);
    const right = new Vector3().crossVectors(this.camera.up, offset).normalize();
    const polar = this.camera.up.angleTo(offset);
    const lift = Math.min(polar - 0.05, Math.max(polar - Math.PI + 0.05, elevation));
    offset.applyAxisAngle(right, -lift).applyAxisAngle(this.camera.up, azimuth);
    this.camera.position.copy(this.#controls.target).add(offset);
    this.wake();
  }

  zoom(factor: number): void {
    this.camera.position.sub(this.#controls.target).multiplyScalar(factor).add(this.#controls.target);
    this.wake();
  }

  /** While a hand holds a tool the left button and the wheel are the hand's. */
  set handMode(on: boolean) {
    this.#handMode = on;
    this.#applyHandMode();
  }

  /** Returns the camera's axes in the world. */
  axes(): { right: Vec3; up: Vec3; back: Vec3 } {
    const [right, up, back] = [new Vector3(), new Vector3(), new Vector3()];
    this.camera.updateMatrixWorld();
    this.camera.matrixWorld.extractBasis(right, up, back);
    return { right: right.toArray() as Vec3, up: up.toArray() as Vec3, back: back.toArray() as Vec3 };
  }

  /** Returns how many metres a pixel is at that point. */
  metresPerPixel(at: Vec3): number {
    const depth = new Vector3(...at).sub(this.camera.position).dot(this.camera.getWorldDirection(new Vector3()));
    return (2 * Math.max(depth, this.camera.near) * Math.tan(this.fov_rad / 2)) / Math.max(1, this.size.height);
  }

  /** Returns the ray through a point of the page. */
  ray(clientX: number, clientY: number): Raycaster {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(((clientX - box.left) / box.width) * 2 - 1, 1 - ((clientY - box.top) / box.height) * 2);
    const ray = new Raycaster();
    ray.setFromCamera(at, this.camera);
    return ray;
  }

  #makeControls(target: Vector3): OrbitControls {
    const controls = new OrbitControls(this.camera, this.canvas);
    controls.target.copy(target);
    controls.enableDamping = true;
    controls.dampingFactor = 0.12;
    controls.zoomToCursor = false;
    controls.addEventListener("change", () => this.wake());
    controls.addEventListener("start", () => {
      this.#flight = undefined;
      this.wake();
    });
    return controls;
  }

  #applyHandMode(): void {
    const hand = this.#handMode;
    this.#controls.enableZoom = !hand;
    this.#controls.mouseButtons = hand
      ? { LEFT: null, MIDDLE: MOUSE.ROTATE, RIGHT: MOUSE.ROTATE }
      : { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };
    this.#controls.touches = hand ? { ONE: null, TWO: TOUCH.DOLLY_ROTATE } : { ONE: TOUCH.ROTATE, TWO: TOUCH.DOLLY_PAN };
  }

  #resize(): void {
    const [width, height] = this.#pixels();
    if (width === 0 || height === 0) return;
    if (width !== this.canvas.width || height !== this.canvas.height) this.#renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.wake();
  }

  /** Returns how many pixels the picture is wide and high. */
  #pixels(): [number, number] {
    const parent = this.canvas.parentElement!;
    return [Math.floor(parent.clientWidth * this.#ratio), Math.floor(parent.clientHeight * this.#ratio)];
  }

  #tick(now_ms: number): void {
    this.onFrame(now_ms);
    if (this.#flight) {
      const { from, to, start_ms } = this.#flight;
      const x = Math.min(1, (performance.now() - start_ms) / kFly_ms);
      const share = x * x * (3 - 2 * x);
      this.camera.position.set(...from.position).lerp(new Vector3(...to.position), share);
      this.#controls.target.set(...from.target).lerp(new Vector3(...to.target), share);
      if (x >= 1) this.#flight = undefined;
      this.wake();
    }
    this.#controls.update();
    if (performance.now() > this.#awakeUntil_ms) {
      this.#lastDrawn_ms = 0;
      return;
    }
    this.#renderer.render(this.scene, this.camera);
    ++this.framesDrawn;
    this.onDrawn?.();
    this.#adapt(now_ms);
  }

  /** Fewer pixels where drawing is slow: the hand and the loop matter more. */
  #adapt(now_ms: number): void {
    const elapsed_ms = now_ms - this.#lastDrawn_ms;
    const resting = this.#lastDrawn_ms === 0 || elapsed_ms > 1000;
    this.#lastDrawn_ms = now_ms;
    if (resting || !this.#adapts) return;
    this.#frame_ms += 0.05 * (elapsed_ms - this.#frame_ms);
    const most = Math.min(devicePixelRatio, 2);
    let ratio = this.#ratio;
    if (this.#frame_ms > kSlowFrame_ms) ratio = Math.max(kLeastRatio * Math.min(1, most), ratio * 0.85);
    else if (this.#frame_ms < kFastFrame_ms) ratio = Math.min(most, ratio * 1.1);
    if (Math.abs(ratio - this.#ratio) < 0.02) return;
    this.#ratio = ratio;
    this.#frame_ms = 30;
    this.#resize();
  }
}
