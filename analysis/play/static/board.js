// Drawing: the map once, doors, tokens and figures on every frame. Round and red is the person's, square and blue the
// robot's, so that nothing is told by colour alone.

import { STEPS } from "./keys.js";

export const RED = "#c2332b", BLUE = "#1b5dbb";
const WALL = "#2a3342", WALL_EDGE = "#3b4658", CORRIDOR = "#e4dfd2", FLOOR = "#fbf9f3", GRID = "#d6d0c1", AMBER = "#ffc62e";
const PULSE = 800; // milliseconds: 1.25 flashes a second, well below the three that can be harmful

const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class Board {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.pops = [];
    addEventListener("resize", () => { if (this.map) this.fit(); });
  }

  begin(round) {
    this.map = round.map;
    this.rooms = round.rooms;
    this.doors = round.doors;
    this.pops = [];
    this.fit();
  }

  fit() {
    const rows = this.map.length, columns = this.map[0].length;
    const narrow = innerWidth < 896;
    const coarse = matchMedia("(pointer: coarse)").matches;
    const wide = narrow ? innerWidth - 24 : innerWidth - 340;
    const high = innerHeight - (narrow ? 150 : 100) - (coarse ? 210 : 0);
    const size = Math.max(14, Math.floor(Math.min(wide / columns, high / rows, 56)));
    const ratio = Math.min(devicePixelRatio || 1, 2);
    this.canvas.style.width = `${size * columns}px`;
    this.canvas.style.height = `${size * rows}px`;
    this.size = Math.round(size * ratio);
    this.canvas.width = this.size * columns;
    this.canvas.height = this.size * rows;
    this.ground = new OffscreenCanvas(this.canvas.width, this.canvas.height);
    ground(this.ground.getContext("2d"), this.map, this.size);
  }

  // A token was collected there.
  pop(cell, colour, now) { this.pops.push({ cell, colour, begun: now }); }

  draw(state, figures, now) {
    const c = this.context, s = this.size;
    c.drawImage(this.ground, 0, 0);
    if (state.flash) flash(c, this.rooms[state.flash - 1], s, now);
    this.doors.forEach(([row, column], i) => door(c, column * s, row * s, s, state.doors[i] === "r", this.along(row, column)));
    for (const [row, column] of state.yours) token(c, (column + .5) * s, (row + .5) * s, s, true);
    for (const [row, column] of state.robots) token(c, (column + .5) * s, (row + .5) * s, s, false);
    for (const who of ["robot", "you"]) {
      const [row, column] = figures[who].at(now);
      (who === "you" ? person : robot)(c, (column + .5) * s, (row + .5) * s, s, figures[who].facing);
    }
    this.pops = this.pops.filter((p) => now - p.begun < 600);
    for (const p of this.pops) {
      const share = (now - p.begun) / 600;
      c.globalAlpha = 1 - share;
      c.strokeStyle = p.colour;
      c.lineWidth = s * .08;
      c.beginPath();
      c.arc((p.cell[1] + .5) * s, (p.cell[0] + .5) * s, s * (.3 + .5 * (calm.matches ? .5 : share)), 0, 7);
      c.stroke();
      c.globalAlpha = 1;
    }
  }

  // Whether a door lies in a wall that runs from left to right.
  along(row, column) { return this.map[row][column - 1] === "#" && this.map[row][column + 1] === "#"; }
}

function ground(c, map, s) {
  const rows = map.length, columns = map[0].length;
  c.fillStyle = WALL;
  c.fillRect(0, 0, columns * s, rows * s);
  map.forEach((line, row) => [...line].forEach((letter, column) => {
    if (letter === "#") return;
    c.fillStyle = /[1-9rb]/.test(letter) ? FLOOR : CORRIDOR;
    c.fillRect(column * s, row * s, s, s);
    c.strokeStyle = GRID;
    c.lineWidth = Math.max(1, s * .02);
    c.strokeRect(column * s + .5, row * s + .5, s, s);
  }));
  // The lit upper edge of walls gives them height.
  c.fillStyle = WALL_EDGE;
  map.forEach((line, row) => [...line].forEach((letter, column) => {
    if (letter === "#" && row + 1 < rows && map[row + 1][column] !== "#") {
      c.fillRect(column * s, (row + .72) * s, s, s * .28);
    }
  }));
}

function flash(c, cells, s, now) {
  const strength = calm.matches ? .8 : .5 - .5 * Math.cos((now % PULSE) / PULSE * 2 * Math.PI);
  c.globalAlpha = .15 + .85 * strength;
  c.fillStyle = AMBER;
  for (const [row, column] of cells) c.fillRect(column * s, row * s, s, s);
  const low = [0, 1].map((i) => Math.min(...cells.map((cell) => cell[i])));
  const high = [0, 1].map((i) => Math.max(...cells.map((cell) => cell[i])) + 1);
  c.strokeStyle = AMBER;
  c.lineWidth = s * .3;
  c.strokeRect((low[1] - .15) * s, (low[0] - .15) * s, (high[1] - low[1] + .3) * s, (high[0] - low[0] + .3) * s);
  c.globalAlpha = 1;
}

export function door(c, x, y, s, yours, along) {
  c.fillStyle = FLOOR;
  c.fillRect(x, y, s, s);
  c.fillStyle = yours ? RED : BLUE;
  const thick = .2;
  c.beginPath();
  if (along) c.roundRect(x, y + thick * s * .5, s, s * (1 - thick), s * .1);
  else c.roundRect(x + thick * s * .5, y, s * (1 - thick), s, s * .1);
  c.fill();
  c.fillStyle = "#fff";
  c.beginPath();
  if (yours) c.arc(x + s / 2, y + s / 2, s * .2, 0, 7);
  else c.roundRect(x + s * .31, y + s * .31, s * .38, s * .38, s * .04);
  c.fill();
}

export function token(c, x, y, s, yours) {
  c.fillStyle = yours ? RED : BLUE;
  c.strokeStyle = "#fff";
  c.lineWidth = s * .06;
  c.beginPath();
  if (yours) c.arc(x, y, s * .24, 0, 7); else c.roundRect(x - s * .22, y - s * .22, s * .44, s * .44, s * .06);
  c.fill();
  c.beginPath();
  if (yours) c.arc(x, y, s * .13, 0, 7); else c.roundRect(x - s * .11, y - s * .11, s * .22, s * .22, s * .02);
  c.stroke();
}

function shadow(c, x, y, s) {
  c.fillStyle = "rgb(28 35 48 / 22%)";
  c.beginPath();
  c.ellipse(x, y + s * .4, s * .34, s * .09, 0, 0, 7);
  c.fill();
}

function eyes(c, x, y, s, facing, square) {
  const [down, right] = STEPS[facing];
  for (const side of [-1, 1]) {
    const ex = x + side * s * .13 + right * s * .07, ey = y - s * .03 + down * s * .08;
    c.fillStyle = "#fff";
    c.beginPath();
    if (square) c.roundRect(ex - s * .09, ey - s * .09, s * .18, s * .18, s * .04); else c.arc(ex, ey, s * .1, 0, 7);
    c.fill();
    c.fillStyle = "#1c2330";
    c.beginPath();
    c.arc(ex + right * s * .045, ey + down * s * .045, s * .05, 0, 7);
    c.fill();
  }
}

export function person(c, x, y, s, facing = 0, shaded = true) {
  if (shaded) shadow(c, x, y, s);
  c.fillStyle = RED;
  c.strokeStyle = "#fff";
  c.lineWidth = s * .06;
  c.beginPath();
  c.arc(x, y, s * .38, 0, 7);
  c.fill();
  c.stroke();
  eyes(c, x, y, s, facing, false);
}

export function robot(c, x, y, s, facing = 0, shaded = true) {
  if (shaded) shadow(c, x, y, s);
  c.strokeStyle = "#123d7c";
  c.lineWidth = s * .06;
  c.beginPath();
  c.moveTo(x, y - s * .34);
  c.lineTo(x, y - s * .46);
  c.stroke();
  c.fillStyle = AMBER;
  c.beginPath();
  c.arc(x, y - s * .46, s * .06, 0, 7);
  c.fill();
  c.fillStyle = BLUE;
  c.strokeStyle = "#fff";
  c.beginPath();
  c.roundRect(x - s * .35, y - s * .34, s * .7, s * .7, s * .12);
  c.fill();
  c.stroke();
  eyes(c, x, y, s, facing, true);
}

// Small pictures of the instructions and the legend: drawn with the same strokes as the game.
const PICTURES = {
  you: (c, w) => person(c, w / 2, w / 2, w * 1.1, 0, false),
  robot: (c, w) => robot(c, w / 2, w * .55, w, 0, false),
  "door-you": (c, w) => door(c, 0, 0, w, true, false),
  "door-robot": (c, w) => door(c, 0, 0, w, false, false),
  players: (c, w, h) => {
    area(c, CORRIDOR, 0, 0, w, h);
    person(c, w * .29, h / 2, h * .6, 4);
    robot(c, w * .71, h / 2, h * .6, 3);
  },
  tokens: (c, w, h) => {
    area(c, FLOOR, 0, 0, w, h);
    const s = h * .4;
    for (const i of [0, 1, 2]) {
      token(c, w * (.46 + .2 * i), h * .29, s, true);
      token(c, w * (.46 + .2 * i), h * .71, s, false);
    }
    person(c, w * .18, h * .29, s, 4);
    robot(c, w * .18, h * .71, s, 4);
  },
  doors: (c, w, h) => {
    const s = h * .3;
    area(c, CORRIDOR, 0, 0, w, h);
    area(c, WALL, w * .42, 0, s, h);
    area(c, FLOOR, w * .42 + s, 0, w, h);
    door(c, w * .42, h * .14, s, true, false);
    door(c, w * .42, h * .56, s, false, false);
    person(c, w * .2, h * .29, s, 4);
    robot(c, w * .2, h * .71, s, 4);
  },
  trap: (c, w, h) => {
    const s = h * .25;
    area(c, CORRIDOR, 0, 0, w, h);
    area(c, WALL, w * .14, h * .06, w * .72, h * .88);
    area(c, FLOOR, w * .14 + s, h * .06 + s, w * .72 - 2 * s, h * .88 - 2 * s);
    door(c, w * .14, h * .5 - s / 2, s, false, false);
    door(c, w * .5 - s / 2, h * .06, s, false, true);
    person(c, w * .52, h * .54, s * 1.15);
  },
};

function area(c, colour, x, y, w, h) { c.fillStyle = colour; c.fillRect(x, y, w, h); }

export function pictures() {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  for (const canvas of document.querySelectorAll("canvas[data-picture]")) {
    const [w, h] = [canvas.width, canvas.height];
    canvas.width = w * ratio;
    canvas.height = h * ratio;
    const c = canvas.getContext("2d");
    c.scale(ratio, ratio);
    PICTURES[canvas.dataset.picture](c, w, h);
  }
}
