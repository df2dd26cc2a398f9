// The game in words, for screen readers: what can be seen, and no more. Nobody is told that the robot is trapped, only
// what colour doors have, as everybody sees.

const PLACES = [["top left", "top right"], ["bottom left", "bottom right"]];

export class Words {
  constructor(element) { this.element = element; }

  begin(round) {
    const rows = round.map.length, columns = round.map[0].length;
    const middle = (cells, i) => cells.reduce((sum, cell) => sum + cell[i], 0) / cells.length;
    this.rooms = round.rooms.map((cells) =>
      `${PLACES[Number(middle(cells, 0) > rows / 2)][Number(middle(cells, 1) > columns / 2)]} room`);
    this.inside = new Map(round.rooms.flatMap((cells, i) => cells.map((cell) => [String(cell), i])));
    // Doors come room by room, two each.
    this.doorRoom = round.doors.map((_, i) => Math.floor(i / 2));
    round.doors.forEach((cell, i) => this.inside.set(String(cell), this.doorRoom[i]));
    this.last = round.state;
    this.say(`Round ${round.k + 1} of ${round.of}. ${this.where(round.state)}`);
  }

  // The same words twice are news too: a space without width makes them different.
  say(text) { this.element.textContent = this.element.textContent === text ? `${text}\u200b` : text; }

  place(cell) {
    const room = this.inside.get(String(cell));
    return `${room === undefined ? "corridor" : this.rooms[room]}, row ${cell[0]}, column ${cell[1]}`;
  }

  where(state) {
    const doors = this.rooms.map((name, i) => `${name}: ${this.doors(state, i)}`).join("; ");
    const tokens = state.yours.map((cell) => this.place(cell)).join("; ");
    return `You: ${this.place(state.you)}. Robot: ${this.place(state.robot)}. Your tokens: ${tokens}. Doors: ${doors}.`;
  }

  doors(state, room) {
    const own = [...state.doors].filter((_, i) => this.doorRoom[i] === room);
    if (own[0] === own[1]) return own[0] === "r" ? "both red" : "both blue";
    return "one red, one blue";
  }

  tick(state, secondsLeft) {
    const news = [];
    this.rooms.forEach((name, i) => {
      const now = this.doors(state, i), before = this.doors(this.last, i);
      if (now !== before) news.push(`The doors of the ${name} are now ${now}.`);
    });
    if (state.flash !== this.last.flash) {
      news.push(state.flash ? `The ${this.rooms[state.flash - 1]} is flashing.` : "No room is flashing any more.");
    }
    if (state.score[0] !== this.last.score[0]) {
      const left = state.yours.length;
      const cells = new Set(this.last.yours.map(String));
      const fresh = state.yours.filter((cell) => !cells.has(String(cell)));
      news.push(`${state.score[0]} tokens.`);
      if (fresh.length && left) news.push(`New tokens: ${state.yours.map((cell) => this.place(cell)).join("; ")}.`);
    }
    if (secondsLeft === 10 && this.warned !== 10) news.push("Ten seconds left.");
    this.warned = secondsLeft;
    this.last = state;
    if (news.length) this.say(news.join(" "));
  }
}
