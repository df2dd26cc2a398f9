// Keyboard and touch: which direction is held, and what was pressed just now.

export const STEPS = [[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]];

const MOVES = {
  ArrowUp: 1, ArrowDown: 2, ArrowLeft: 3, ArrowRight: 4,
  KeyW: 1, KeyS: 2, KeyA: 3, KeyD: 4,
};

// Of several held keys the one pressed last counts; when it is released, the one before.
export class Keys {
  constructor(changed, asked) {
    this.held = [];
    this.active = false;
    this.changed = changed;
    addEventListener("keydown", (event) => {
      if (!this.active || event.ctrlKey || event.altKey || event.metaKey) return;
      if (document.querySelector("dialog[open]")) return;
      if (event.code === "KeyI" && !event.repeat) asked();
      const move = MOVES[event.code];
      if (!move) return;
      event.preventDefault();
      if (!event.repeat) this.press(event.code, move);
    });
    addEventListener("keyup", (event) => this.release(event.code));
    addEventListener("blur", () => this.clear());
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.clear(); });
    for (const button of document.querySelectorAll("#pad [data-move]")) {
      const name = `pad ${button.dataset.move}`;
      button.addEventListener("pointerdown", (event) => {
        event.preventDefault();
        button.setPointerCapture(event.pointerId);
        if (this.active) this.press(name, Number(button.dataset.move));
      });
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
        button.addEventListener(end, () => this.release(name));
      }
    }
  }

  press(name, move) {
    this.held = this.held.filter((key) => key.name !== name);
    this.held.push({ name, move });
    this.changed(move, true);
  }

  release(name) {
    const before = this.move;
    this.held = this.held.filter((key) => key.name !== name);
    if (this.move !== before) this.changed(this.move, false);
  }

  clear() {
    if (!this.held.length) return;
    this.held = [];
    this.changed(0, false);
  }

  get move() { return this.held.length ? this.held[this.held.length - 1].move : 0; }
}
