// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import type { HandReport } from "../src/connection/worker_messages";
import { Pad, rumble } from "../src/hand/gamepad";
import { HandDevice, kPosePeriod_ms, kSilence_ms } from "../src/hand/hand_device";
import { HeldKeys } from "../src/hand/held_keys";
import { distanceToCourse, pointAt } from "../src/hand/course";
import { carried, driven, graspShare, needleMotion, reachNeedle } from "../src/hand/needle_course";
import { reachThread, threadPlace } from "../src/hand/thread_course";
import { kMaxSpeed_m_per_s, kMaxSpin_rad_per_s, PosePacer } from "../src/hand/pacer";
import { dragMode } from "../src/hand/pointer";
import { about, dot, length, rotate, shaftAlong, subtract, turnBetween, type Pose, type Vec3 } from "../src/maths/vector";
import { NeedleShape, POSE_GOODBYE, POSE_IN_WORLD, type NeedleState, type ThreadState, type ToolForce, type ToolPose, type ToolStatus } from "../src/protocol/messages";
import { toolId } from "../src/protocol/fnv";

const kHome: Pose = { position: [0, 0, 0], orientation: [0, 0, 0, 1] };
const near = (a: number, b: number, tolerance: number) => assert.ok(Math.abs(a - b) <= tolerance, `${a} is not ${b} ± ${tolerance}`);

/** An arc of 180° with radius 8 mm around (11, 0, 0) mm, tip first. */
function arcNeedle(over: Partial<NeedleState> = {}): NeedleState {
  const course = new Float64Array(3 * 33);
  for (let i = 0; i < 33; ++i) {
    const angle = Math.PI * (1 - i / 32);
    course.set([0.011 + 0.008 * Math.cos(angle), 0.008 * Math.sin(angle), 0], 3 * i);
  }
  return {
    needle: "needle", epoch: 1n, sequence_number: 1n, stamp_ns: 1n, shape: NeedleShape.Arc, radius_m: 0.008,
    length_m: 0.008 * Math.PI, diameter_m: 0.0006, position_m: new Float64Array([0.011, 0, 0]),
    orientation_xyzw: new Float64Array([0, 0, 0, 1]), holder: "", tip_inside: false, tip_force_n: 0,
    embedded_length_m: 0, course_m: course, punctures: [], ...over,
  };
}

test("a hand that jumps makes poses that do not", () => {
  const pacer = new PosePacer(kHome, 0, 0);
  pacer.aim({ position: [0.5, 0, 0], orientation: about([0, 0, 1], 3) }, 1);
  let last = pacer.step(1e-6);
  for (let i = 1; i < 600; ++i) {
    // Timers are late at times; the poses do not make up for it.
    const elapsed_s = i % 50 === 0 ? 0.2 : 0.008;
    const now = pacer.step(i * 0.008 + Math.floor(i / 50) * 0.192);
    assert.ok(length(subtract(now.position, last.position)) <= kMaxSpeed_m_per_s * Math.min(elapsed_s, 0.012) * (1 + 1e-6));
    assert.ok(length(turnBetween(last.orientation, now.orientation)) <= kMaxSpin_rad_per_s * Math.min(elapsed_s, 0.012) * (1 + 1e-6));
    near(Math.hypot(...now.orientation), 1, 1e-12);
    last = now;
  }
  // It arrives: 0.5 m at 0.25 m/s are 2 s of 4.8 s.
  near(last.position[0], 0.5, 1e-6);
  near(length(turnBetween(last.orientation, about([0, 0, 1], 3))), 0, 1e-6);
  near(last.jaw, 1, 0);
});

test("a target that is not finite is no target", () => {
  const pacer = new PosePacer(kHome, 0, 0);
  pacer.aim({ position: [NaN, 0, 0], orientation: [0, 0, 0, 1] }, 0);
  assert.deepEqual(pacer.step(0.01).position, [0, 0, 0]);
});

function device(nowMs: () => number) {
  const poses: ToolPose[] = [];
  const profiles: string[] = [];
  const reports: HandReport[] = [];
  const hand = new HandDevice("driver", kHome, 0, 41n, { nowMs }, {
    sendPose: (pose) => poses.push(pose),
    sendProfile: (tool) => profiles.push(tool),
    report: (report) => reports.push(report),
  });
  return { hand, poses, profiles, reports };
}

const answer = (pose: ToolPose, force_n: Vec3): ToolForce => ({
  tool_id: pose.tool_id, device: new Uint8Array(16), epoch: 1n, sequence_number: 1n, stamp_ns: 5n,
  pose_sequence: pose.sequence_number, pose_stamp_ns: pose.stamp_ns, force_n, torque_nm: [0, 0, 0],
  state: 1, faults: 0, flags: 1, model_age_us: 100,
});

test("a hand poses, is answered, falls silent, and says goodbye", () => {
  let now = 1_764_000_000_000;
  const { hand, poses, profiles, reports } = device(() => now);
  assert.deepEqual(profiles, ["driver"]);
  hand.aim({ position: [0.01, 0, 0], orientation: [0, 0, 0, 1] }, 0);
  for (let i = 0; i < 10; ++i) {
    now += kPosePeriod_ms;
    assert.ok(hand.tick());
  }
  assert.deepEqual(poses.map((pose) => pose.sequence_number), Array.from({ length: 10 }, (_, i) => BigInt(42 + i)));
  assert.ok(poses.every((pose, i) => pose.flags === POSE_IN_WORLD && (i === 0 || pose.stamp_ns > poses[i - 1]!.stamp_ns)));
  assert.equal(poses[0]!.tool_id, toolId("driver"));

  // Another's force is not ours, ours tells the round trip.
  hand.tell();
  assert.equal(reports.at(-1)?.lease, "asking");
  hand.onForce({ ...answer(poses[9]!, [1, 0, 0]), pose_stamp_ns: 1n });
  now += 4;
  hand.onForce(answer(poses[9]!, [0, 2, 0]));
  hand.tick();
  hand.tell();
  assert.equal(reports.at(-1)?.lease, "held");
  assert.deepEqual(reports.at(-1)?.force, [0, 2, 0]);
  near(reports.at(-1)?.roundTripMs ?? NaN, 4, 0.01);

  // No answer: no force on show.
  now += 800;
  hand.tick();
  hand.tell();
  assert.deepEqual(reports.at(-1)?.force, [0, 0, 0]);

  now += kSilence_ms;
  assert.equal(hand.tick(), false, "a page that says nothing has lost its hand");
  hand.goodbye();
  assert.equal(poses.at(-1)?.flags, POSE_IN_WORLD | POSE_GOODBYE);
  assert.equal(reports.at(-1)?.lease, "none");
});

test("a tool that stays another's is refused", () => {
  let now = 1_764_000_000_000;
  const { hand, reports } = device(() => now);
  for (let i = 0; i < 200; ++i) {
    now += kPosePeriod_ms;
    hand.aim(kHome, 0);
    hand.tick();
    if (i % 60 === 0) hand.onStatus({ tool: "driver", leased: true } as ToolStatus);
  }
  hand.tell();
  assert.equal(reports.at(-1)?.lease, "refused");
});

test("driving turns the needle about its own centre, tip first", () => {
  const needle = arcNeedle();
  const motion = needleMotion(needle);
  assert.equal(motion.kind, "arc");
  const grip: Pose = { position: pointAt(needle.course_m, 0.9), orientation: [0, 0, 0, 1] };
  // The hand is somewhere else by now: the circle goes with it.
  const target: Pose = { position: [0.1, 0.2, 0.3], orientation: about([1, 0, 0], 0.5) };
  const moved = carried(motion, grip, target);
  const after = driven(target, moved, 0.008);
  near(length(turnBetween(target.orientation, after.orientation)), 1, 1e-9);
  if (moved.kind !== "arc") return assert.fail();
  near(length(subtract(after.position, moved.centre)), length(subtract(target.position, moved.centre)), 1e-12);

  // With the tool where it is, the tip goes on along its arc: at an angle of 180° downwards.
  const step = driven({ position: pointAt(needle.course_m, 0), orientation: [0, 0, 0, 1] }, motion, 0.001);
  assert.ok(step.position[1] < 0);

  const straight = needleMotion(arcNeedle({ shape: NeedleShape.Straight, course_m: new Float64Array([0.02, 0, 0, 0, 0, 0]) }));
  assert.deepEqual(driven(kHome, straight, 0.003).position, [0.003, 0, 0]);
});

test("a jaw closes at the end that is free", () => {
  const at = (arc_length_m: number) => ({ body: "b", position_m: new Float64Array(3), arc_length_m, inward: true });
  assert.equal(graspShare(arcNeedle(), undefined), 0.88);
  assert.equal(graspShare(arcNeedle({ punctures: [at(0.001), at(0.004)] }), undefined), 0.88);
  assert.equal(graspShare(arcNeedle({ punctures: [at(0.015), at(0.02)] }), undefined), 0.12);
  assert.equal(graspShare(arcNeedle({ embedded_length_m: 0.004, tip_inside: true }), undefined), 0.88);
  assert.equal(graspShare(arcNeedle({ embedded_length_m: 0.004 }), undefined), 0.12, "drawn out by the tip");
  const tail: Vec3 = [0.019, 0, 0];
  assert.equal(graspShare(arcNeedle(), tail), 0.12, "away from who holds it");
});

test("a hand reaches along its own shaft, across the needle, from the side of the eye", () => {
  const eye: Vec3 = [0.2, 0.3, -1];
  const [before, at] = reachNeedle(kHome, arcNeedle(), eye, undefined);
  const shaft = rotate(at!.orientation, [0, 0, 1]);
  near(Math.abs(shaft[2]), 1, 1e-9);
  assert.ok(dot(shaft, eye) > 0);
  near(length(subtract(before!.position, at!.position)), 0.012, 1e-12);
  near(distanceToCourse(arcNeedle().course_m, at!.position), 0, 1e-12);

  // The second hand comes from the other side.
  const holder: Pose = { position: [0.019, 0, 0], orientation: shaftAlong([0, 0, -1]) };
  const second = reachNeedle(kHome, arcNeedle(), eye, holder)[1]!;
  near(rotate(second.orientation, [0, 0, 1])[2], 1, 1e-9);
});

/** From the head at (100, 0, 0) mm along x to a bite between 20 and 10 mm, and `tail_m` of it beyond. */
function thread(tail_m: number, over: Partial<ThreadState> = {}): ThreadState {
  const puncture = (x: number) => ({ body: "proximal", position_m: new Float64Array([x, 0, 0]), arc_length_m: 0, inward: true });
  return {
    thread: "thread", epoch: 1n, sequence_number: 1n, stamp_ns: 1n, length_m: 0.1, diameter_m: 0.0003, tension_n: 0, slack_m: 0, taut: false,
    course_m: new Float64Array([0.1, 0, 0, 0.02, 0, 0, 0.01, 0, 0, 0.01 - tail_m, 0, 0]), segment_tension_n: new Float64Array(3),
    punctures: [puncture(0.02), puncture(0.01)], ...over,
  };
}

test("a thread is taken beside the tissue on its head's side, else on its tail's, and in its middle where it is in none", () => {
  const x = (of: ThreadState) => threadPlace(of)?.at[0];
  near(x(thread(0))!, 0.032, 1e-12);
  const short = { course_m: new Float64Array([0.024, 0, 0, 0.02, 0, 0, 0.01, 0, 0, -0.04, 0, 0]) };
  near(x(thread(0.05, short))!, 0.022, 1e-12);
  const used = { course_m: new Float64Array([0.021, 0, 0, 0.02, 0, 0, 0.01, 0, 0, -0.04, 0, 0]) };
  near(x(thread(0.05, used))!, -0.002, 1e-12);
  near(x(thread(0, { punctures: [] }))!, 0.055, 1e-12);
  assert.equal(x(thread(0, { course_m: new Float64Array([0.0205, 0, 0, 0.02, 0, 0, 0.01, 0, 0]) })), undefined, "nothing is left of it outside");
  assert.equal(x(thread(0, { course_m: new Float64Array(0), punctures: [] })), undefined);
});

test("a hand reaches across the thread, from the side of the eye", () => {
  const eye: Vec3 = [0.7, 0.3, -1];
  const [before, at] = reachThread(kHome, threadPlace(thread(0))!, eye);
  const shaft = rotate(at!.orientation, [0, 0, 1]);
  near(shaft[0], 0, 1e-9);
  assert.ok(dot(shaft, eye) > 0);
  near(length(subtract(before!.position, at!.position)), 0.012, 1e-12);
  near(at!.position[0], 0.032, 1e-12);
});

test("Shift turns and Ctrl drives, whatever the mode is", () => {
  const keys = { shiftKey: false, ctrlKey: false, metaKey: false };
  assert.equal(dragMode(keys, "drive"), "drive");
  assert.equal(dragMode({ ...keys, shiftKey: true }, "move"), "turn");
  assert.equal(dragMode({ ...keys, metaKey: true }, "turn"), "drive");
});

test("no key stays down that was released while Meta was", () => {
  const keys = new HeldKeys();
  const rest = { move: [0, 0, 0], turn: [0, 0, 0], drive: 0 };
  const kJ = { key: "j", metaKey: false };
  for (const event of [{ key: "Meta", metaKey: true }, { key: "Meta", metaKey: false }, { key: "j", metaKey: true }]) {
    keys.heed(kJ);
    assert.ok(keys.press("KeyJ"));
    keys.heed(kJ);
    assert.ok(keys.rates(false).turn[1] < 0, "without Meta it is down");
    keys.heed(event);
    assert.deepEqual(keys.rates(false), rest);
  }
});

/** A pad of the standard layout as a browser shows it. */
function pushed(over: { axes?: number[]; down?: Record<number, number> } = {}): Gamepad {
  return {
    connected: true, mapping: "standard", axes: over.axes ?? [0, 0, 0, 0],
    buttons: Array.from({ length: 17 }, (_, i) => ({ pressed: (over.down?.[i] ?? 0) > 0.5, value: over.down?.[i] ?? 0 })),
  } as unknown as Gamepad;
}
const [kLeftShoulder, kRightShoulder, kLeftTrigger, kRightTrigger] = [4, 5, 6, 7];
const read = (pad: Gamepad) => new Pad(() => [null, pad]).read()!;

test("a pad moves nothing unless its left shoulder is held", () => {
  const all = { axes: [1, 1, 1, 1], down: { [kRightTrigger]: 1 } };
  const free = read(pushed(all));
  assert.deepEqual(free.rates, { move: [0, 0, 0], turn: [0, 0, 0], drive: 0 });
  assert.equal(free.heldBack, true);
  const led = read(pushed({ ...all, down: { ...all.down, [kLeftShoulder]: 1 } }));
  assert.ok(length(led.rates.move) > 0 && length(led.rates.turn) > 0 && led.rates.drive > 0);
  assert.equal(led.heldBack, false);
  assert.equal(read(pushed()).heldBack, false, "a pad at rest asks for nothing");
  assert.equal(new Pad(() => [null, { ...pushed(), mapping: "" } as Gamepad]).read(), undefined, "another layout");
});

test("sticks go across the view, into depth, and turn; the right hand drives", () => {
  const led = (axes: number[], down: Record<number, number> = {}) => read(pushed({ axes, down: { [kLeftShoulder]: 1, ...down } })).rates;
  // Camera axes: right, up, towards the eye. A browser's sticks count right and down.
  assert.deepEqual(led([1, 0, 0, 0]).move.map(Math.sign), [1, -0, 0]);
  assert.deepEqual(led([0, -1, 0, 0]).move.map(Math.sign), [0, 1, 0]);
  assert.deepEqual(led([0, 0, 0, 1]).move.map(Math.sign), [0, -0, 1]);
  assert.deepEqual(led([0, 0, -1, 0]).turn.map(Math.sign), [0, -1, 0]);
  assert.deepEqual(led([0.1, -0.1, 0.1, 0.1]), { move: [0, -0, 0], turn: [0, 0, 0], drive: 0 }, "a stick at rest is never quite at zero");
  // Half a stick is a quarter of the way and less: near the middle it is fine.
  assert.ok(led([0.5, 0, 0, 0]).move[0] < 0.25 * led([1, 0, 0, 0]).move[0]);
  near(led([0, 0, 0, 0], { [kRightTrigger]: 0.5 }).drive, 0.5 * led([0, 0, 0, 0], { [kRightTrigger]: 1 }).drive, 1e-12);
  near(led([0, 0, 0, 0], { [kRightShoulder]: 1 }).drive, -led([0, 0, 0, 0], { [kRightTrigger]: 1 }).drive, 1e-12);
  near(led([1, 0, 0, 0], { [kLeftTrigger]: 1 }).move[0], 0.25 * led([1, 0, 0, 0]).move[0], 1e-12);
});

test("a button of a pad counts once, however long it is pressed", () => {
  let now = pushed();
  const pad = new Pad(() => [now]);
  const steps: Record<number, number>[] = [{}, { 0: 1 }, { 0: 1, 1: 1 }, {}, { 0: 1, 9: 1 }];
  const presses = steps.map((down) => {
    now = pushed({ down });
    const { jaw, reach, hold } = pad.read()!;
    return `${jaw ? "A" : ""}${reach ? "B" : ""}${hold ? "S" : ""}`;
  });
  assert.deepEqual(presses, ["", "A", "B", "", "AS"]);
});

test("a pad feels a force at most every 90 ms, and none that is too small", () => {
  const felt: number[] = [];
  const now = { ...pushed(), vibrationActuator: {
    playEffect: (_: string, effect: { strongMagnitude: number }) => (felt.push(effect.strongMagnitude), Promise.resolve("complete")),
  } } as unknown as Gamepad;
  const pad = new Pad(() => [now]);
  for (const at_ms of [100, 110, 150, 200]) pad.feel([0, 2, 0], 4, at_ms);
  pad.feel([0, 0.01, 0], 4, 400);
  assert.deepEqual(felt, [0.5 ** 1.5, 0.5 ** 1.5]);
});

test("a pad shakes more with more force, and not without", () => {
  assert.deepEqual(rumble(0), { strong: 0, weak: 0 });
  assert.deepEqual(rumble(7), { strong: 1, weak: 1 });
  assert.ok(rumble(0.5).weak > rumble(0.1).weak && rumble(0.1).weak > 0);
});
