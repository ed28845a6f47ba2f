// SPDX-License-Identifier: Apache-2.0
import {
  BoxGeometry, Color, CylinderGeometry, Group, Mesh, MeshStandardMaterial, Quaternion, SphereGeometry, TorusGeometry, Vector3, type Material, type MeshMatcapMaterial,
} from "three";
import type { Pose, Quat, Vec3 } from "../maths/vector";
import { FORCE_ENGAGED, ToolState, type ToolView } from "../protocol/messages";
import { Arrows, type Arrow } from "./arrows";
import { AutoRange } from "./colour_map";
import { steel } from "./matcaps";
import { stampMs, Timeline } from "./timeline";

/** Of the tools, in the order in which they come. */
export const kToolColours = ["#2dd4bf", "#f59e0b", "#a78bfa", "#f472b6", "#60a5fa", "#a3e635"];

const kJaw_m = 0.006;
const kHinge_m = 0.0065;
const kShaft_m = 0.075;
const kProbe_m = 0.002;
/** How far each jaw opens. */
const kOpen_rad = 0.26;
const kQuiet_n = 0.003;

/** A tool's shaft runs along its z axis, from the origin towards the hand. */
class Instrument {
  readonly group = new Group();
  readonly timeline = new Timeline<ToolView>();
  readonly kind: string;
  readonly colour: Color;
  readonly #jaws: Group[] = [];
  readonly #body: MeshMatcapMaterial;

  constructor(kind: string, colour: Color) {
    this.kind = kind;
    this.colour = colour;
    this.#body = steel();
    const accent = new MeshStandardMaterial({ color: colour, roughness: 0.4, metalness: 0.1, emissive: colour, emissiveIntensity: 0.18 });
    const along = (mesh: Mesh, z: number) => {
      mesh.rotation.x = Math.PI / 2;
      mesh.position.z = z;
      return mesh;
    };
    const start = kind === "probe" ? kProbe_m : kHinge_m;
    this.group.add(along(new Mesh(new CylinderGeometry(0.0012, 0.0009, kShaft_m, 32), this.#body), start + kShaft_m / 2));
    this.group.add(along(new Mesh(new CylinderGeometry(0.0022, 0.0019, 0.03, 24), accent), start + kShaft_m + 0.013));
    const ring = new Mesh(new TorusGeometry(0.0013, 0.0004, 10, 28), accent);
    ring.position.z = start + 0.004;
    this.group.add(ring);
    if (kind === "probe") {
      this.group.add(new Mesh(new SphereGeometry(kProbe_m, 32, 24), this.#body));
    } else {
      for (const side of [1, -1]) {
        const jaw = new Group();
        jaw.position.z = kHinge_m;
        const blade = new Mesh(new BoxGeometry(0.0011, 0.0007, kJaw_m + 0.0008, 1, 1, 4), this.#body);
        taper(blade.geometry as BoxGeometry);
        blade.position.set(0, side * 0.00042, -kJaw_m / 2);
        jaw.add(blade);
        jaw.userData["side"] = side;
        this.#jaws.push(jaw);
        this.group.add(jaw);
      }
      const hinge = new Mesh(new CylinderGeometry(0.00085, 0.00085, 0.0022, 24), this.#body);
      hinge.rotation.z = Math.PI / 2;
      hinge.position.z = kHinge_m;
      this.group.add(hinge);
    }
    this.group.traverse((each) => (each.castShadow = true));
    this.group.visible = false;
  }

  place(position: Vector3, orientation: Quaternion, jaw: number): void {
    this.group.position.copy(position);
    this.group.quaternion.copy(orientation);
    for (const each of this.#jaws) each.rotation.x = (each.userData["side"] as number) * kOpen_rad * (1 - jaw);
  }

  /** Solid while it is led, a ghost while nobody has it. */
  set led(led: boolean) {
    this.group.traverse((each) => {
      if (!(each instanceof Mesh)) return;
      const material = each.material as Material;
      material.transparent = !led;
      material.opacity = led ? 1 : 0.28;
      each.castShadow = led;
    });
  }

  set faulty(faulty: boolean) {
    this.#body.color.set(faulty ? 0xff6a78 : 0xffffff);
  }
}

function taper(box: BoxGeometry): void {
  const position = box.getAttribute("position");
  const half = (kJaw_m + 0.0008) / 2;
  for (let i = 0; i < position.count; ++i) {
    const narrow = 0.55 + 0.45 * ((position.getZ(i) + half) / (2 * half));
    position.setX(i, position.getX(i) * narrow);
    position.setY(i, position.getY(i) * narrow);
  }
  box.computeVertexNormals();
}

/** A tool that no pose ever moved stands at the origin of everything: it is nowhere. */
export function wasLed(view: ToolView): boolean {
  return (view.flags & FORCE_ENGAGED) !== 0 || view.position_m.some((x) => x !== 0);
}

export class Tools {
  readonly group = new Group();
  readonly #arrows = new Arrows(16);
  readonly #tools = new Map<string, Instrument>();
  /** The force whose arrow is as long as an arrow gets. */
  readonly #range = new AutoRange(0.1);
  #updated_ms = 0;

  constructor() {
    this.group.add(this.#arrows.group);
  }

  push(view: ToolView): void {
    let tool = this.#tools.get(view.tool);
    if (tool?.kind !== view.kind) {
      // In another scene a tool of that name may be of another kind.
      if (tool) this.group.remove(tool.group);
      const colour = tool?.colour ?? new Color(kToolColours[this.#tools.size % kToolColours.length]);
      this.#tools.set(view.tool, (tool = new Instrument(view.kind, colour)));
      this.group.add(tool.group);
    }
    tool.timeline.push(stampMs(view.stamp_ns), view);
  }

  clear(): void {
    for (const tool of this.#tools.values()) {
      tool.timeline.clear();
      tool.group.visible = false;
    }
    this.#arrows.set([]);
  }

  /** Arrows are `longest_m` at the end of their scale, which follows the forces. */
  update(moment_ms: number, longest_m: number, radius_m: number): void {
    const arrows: Arrow[] = [];
    const largest_n = Math.max(0, ...this.views().map((view) => Math.hypot(...view.force_n)));
    this.#range.observe(largest_n, Math.min(0.1, Math.max(0, moment_ms - this.#updated_ms) / 1000));
    this.#updated_ms = moment_ms;
    for (const tool of this.#tools.values()) {
      const between = tool.timeline.at(moment_ms);
      if (!between) continue;
      const { before, after, share } = between;
      tool.group.visible = wasLed(after);
      if (!tool.group.visible) continue;
      const position = new Vector3(...before.position_m).lerp(new Vector3(...after.position_m), share);
      const orientation = new Quaternion(...before.orientation_xyzw).slerp(new Quaternion(...after.orientation_xyzw), share);
      tool.place(position, orientation, before.jaw + share * (after.jaw - before.jaw));
      const led = (after.flags & FORCE_ENGAGED) !== 0 && after.state !== ToolState.Idle;
      tool.led = led;
      tool.faulty = after.state === ToolState.Fault || after.state === ToolState.Stopped;
      const force = after.force_n;
      if (led && Math.hypot(...force) > kQuiet_n)
        arrows.push({
          from: position.toArray() as Vec3,
          vector: [...force].map((f) => (f * longest_m) / this.#range.top) as Vec3,
          radius_m,
          colour: tool.colour,
        });
    }
    this.#arrows.set(arrows);
  }

  /** The newest word on each tool, in the order in which they came. */
  views(): ToolView[] {
    return [...this.#tools.values()].flatMap((tool) => tool.timeline.latest ?? []);
  }

  view(name: string): ToolView | undefined {
    return this.#tools.get(name)?.timeline.latest;
  }

  colour(name: string): string {
    return `#${(this.#tools.get(name)?.colour ?? new Color("#888")).getHexString()}`;
  }
}

export function poseOf(view: { position_m: Float64Array; orientation_xyzw: Float64Array }): Pose {
  return { position: [...view.position_m] as Vec3, orientation: [...view.orientation_xyzw] as Quat };
}
