// SPDX-License-Identifier: Apache-2.0
// Mouse, pen and finger on the picture: drag and wheel for the hand while it holds a tool, a click for
// a pick at all times. Orbiting is the camera's (OrbitControls).
import type { DragMode, Hand } from "./hand";

const kClick_px = 5;

export interface PointerListeners {
  pick(clientX: number, clientY: number): void;
  lost(): void;
}

/** Returns what a drag does: Shift turns, Ctrl (or ⌘) drives, whatever the mode is. */
export function dragMode(event: { shiftKey: boolean; ctrlKey: boolean; metaKey: boolean }, mode: DragMode): DragMode {
  if (event.ctrlKey || event.metaKey) return "drive";
  return event.shiftKey ? "turn" : mode;
}

export function listenToPointer(canvas: HTMLElement, hand: Hand, listeners: PointerListeners): void {
  let pointer: number | undefined;
  const fingers = new Set<number>();
  let last = { x: 0, y: 0 };
  let way = 0;

  canvas.addEventListener("pointerdown", (event) => {
    fingers.add(event.pointerId);
    canvas.focus({ preventScroll: true });
    // Two fingers are the camera's.
    if (event.button !== 0 || fingers.size > 1) {
      pointer = undefined;
      return;
    }
    pointer = event.pointerId;
    last = { x: event.clientX, y: event.clientY };
    way = 0;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pointer) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    last = { x: event.clientX, y: event.clientY };
    way += Math.hypot(dx, dy);
    hand.drag(dx, dy, dragMode(event, hand.mode));
  });
  canvas.addEventListener("pointerup", (event) => {
    fingers.delete(event.pointerId);
    if (event.pointerId !== pointer) return;
    pointer = undefined;
    if (way < kClick_px) listeners.pick(event.clientX, event.clientY);
  });
  canvas.addEventListener("pointercancel", (event) => {
    fingers.delete(event.pointerId);
    if (event.pointerId !== pointer) return;
    pointer = undefined;
    listeners.lost();
  });
  canvas.addEventListener("wheel", (event) => {
    if (!hand.tool) return;
    event.preventDefault();
    // Lines and pages as pixels.
    const unit = event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 400 : 1;
    if (event.ctrlKey || event.metaKey) hand.drive(-event.deltaY * unit * 0.00001);
    else hand.depth(event.deltaY * unit);
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}
