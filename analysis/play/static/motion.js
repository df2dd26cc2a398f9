// Where figures are drawn between the ticks of the server, which alone decides where they are.
//
// A figure glides to its cell in the time that a step takes. The player's own next step is drawn from the moment the
// key goes down, if the rules as far as they can be seen allow it; should the server decide otherwise, it glides back.

import { STEPS } from "./keys.js";

export class Figure {
  constructor(cell, stepMilliseconds) {
    this.cell = cell;
    this.from = this.to = cell;
    this.begun = this.ends = 0;
    this.step = stepMilliseconds;
    this.facing = 0;
    this.guess = null;
  }

  at(now) {
    const share = this.ends > this.begun ? Math.min(1, Math.max(0, (now - this.begun) / (this.ends - this.begun))) : 1;
    return [0, 1].map((i) => this.from[i] + (this.to[i] - this.from[i]) * share);
  }

  glide(to, now, milliseconds) {
    this.from = this.at(now);
    this.to = to;
    this.begun = now;
    this.ends = now + milliseconds;
  }

  // The server's word.
  told(cell, now) {
    const [row, column] = this.cell;
    if (cell[0] !== row || cell[1] !== column) {
      const move = STEPS.findIndex(([down, right]) => cell[0] - row === down && cell[1] - column === right);
      if (move > 0) this.facing = move;
      this.cell = cell;
      this.guess = null;
      this.glide(cell, now, this.step);
    } else if (this.guess && now > this.guess.until) {
      this.guess = null;
      this.glide(cell, now, 80);
    }
  }

  // A step that is likely to come at the next tick.
  expect(move, cell, now, tickMilliseconds) {
    this.guess = { until: now + 2.5 * tickMilliseconds };
    this.facing = move;
    this.glide(cell, now, this.step + tickMilliseconds / 2);
  }
}
