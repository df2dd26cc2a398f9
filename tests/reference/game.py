"""Slow twins of the token game: the rules on sets and dictionaries, and routes by networkx."""

import networkx

STEPS = {0: (0, 0), 1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}
OTHER = {"human": "robot", "robot": "human"}
COLOUR = {"human": "red", "robot": "blue"}
MASK = 2**64 - 1


def mixed(z):
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


class SlowRound:
    """The rules in words; nothing is shared with the compiled ones but the names of the parameters."""

    def __init__(self, lines, parameters, trapped, acts, seed):
        self.grid = {(r, c): ch for r, line in enumerate(lines) for c, ch in enumerate(line)}
        self.p, self.named, self.acts, self.tick = parameters, trapped, acts, 0
        self.seed, self.draws = mixed(seed ^ 0x746F6B656E730001), 0
        self.at = {"human": self.find("H")[0], "robot": self.find("R")[0]}
        self.room = {"human": None, "robot": None}
        self.ready = {"human": 0, "robot": 0}
        self.colour, self.room_of_door = {}, {}
        for cell in self.find("rb"):
            self.colour[cell] = "red" if self.grid[cell] == "r" else "blue"
            (self.room_of_door[cell],) = {self.grid[n] for n in self.beside(cell)} & set("1234")
        self.trapped = self.trap_room = self.trapped_tick = self.freed_tick = self.lifted = None
        self.tokens, self.group = {"human": [], "robot": []}, {"human": None, "robot": None}
        self.collected = {"human": 0, "robot": 0}
        for player in ("human", "robot"):
            self.appear(player, 3)

    def find(self, letters):
        return [cell for cell in sorted(self.grid) if self.grid[cell] in letters]

    def beside(self, cell):
        near = [(cell[0] + STEPS[m][0], cell[1] + STEPS[m][1]) for m in (1, 2, 3, 4)]
        return [n for n in near if self.grid.get(n, "#") != "#"]

    def below(self, limit):
        self.draws += 1
        return mixed((self.seed + self.draws * 0x9E3779B97F4A7C15) & MASK) % limit

    def appear(self, player, count):
        closed = self.trap_room if self.p.clear_trapped_room and self.trapped == OTHER[player] else None
        rooms = [r for r in "1234" if r not in (self.group["human"], self.group["robot"], closed)]
        self.group[player] = rooms[self.below(len(rooms))]
        self.tokens[player] = []
        for _ in range(count):
            taken = self.tokens["human"] + self.tokens["robot"]
            free = [c for c in self.find(self.group[player]) if c not in taken]
            self.tokens[player].append(free[self.below(len(free))])

    def step(self, human, robot):
        for player, move in (("human", human), ("robot", robot)):
            self.move(player, move)
        for player in ("human", "robot"):
            if self.at[player] in self.tokens[player]:
                self.tokens[player].remove(self.at[player])
                self.collected[player] += 1
                if not self.tokens[player]:
                    self.appear(player, 3)
        self.tick += 1

    def move(self, player, move):
        here = self.at[player]
        there = here[0] + STEPS[move][0], here[1] + STEPS[move][1]
        if move == 0 or self.tick < self.ready[player] or self.grid.get(there, "#") == "#":
            return
        if there in self.colour and self.colour[there] != COLOUR[player]:
            return
        self.at[player] = there
        self.ready[player] = self.tick + (self.p.human_step_ticks if player == "human" else self.p.robot_step_ticks)
        if here in self.colour:
            inside = self.grid[there] in "1234"
            if not inside:
                self.room[player] = None
            elif self.room[player] is None:
                self.room[player] = self.grid[there]
                self.enter(player, self.grid[there])

    def enter(self, player, room):
        doors = [d for d, r in self.room_of_door.items() if r == room]
        other = OTHER[player]
        if self.trapped == other and self.trap_room == room:
            # All were this player's: now all swap, and the one that the trap had recoloured swaps back.
            for door in doors:
                self.colour[door] = COLOUR[player] if door == self.lifted else COLOUR[other]
            self.trapped, self.freed_tick = None, self.tick
            return
        for door in doors:
            self.colour[door] = "red" if self.colour[door] == "blue" else "blue"
        on_door = self.room_of_door.get(self.at[other]) == room
        near = self.room[other] == room or on_door or self.grid[self.at[other]] == room
        if self.named == player and self.trapped_tick is None and self.tick >= self.p.trap_tick and not near:
            self.trapped, self.trap_room, self.trapped_tick = player, room, self.tick
            (self.lifted,) = (d for d in doors if self.colour[d] == COLOUR[player])
            self.colour[self.lifted] = COLOUR[other]
            if self.p.clear_trapped_room and self.group[other] == room:
                self.appear(other, len(self.tokens[other]))


def shortest(view, lines, player, goals, avoid=None):
    """Steps from where a player stands to the nearest goal by networkx, None if there is no way.

    Doors of the other's colour and those of the room `avoid` are closed, but not to who stands on one.
    """
    grid = {(r, c) for r, line in enumerate(lines) for c, ch in enumerate(line) if ch != "#"}
    start = getattr(view, player)
    graph = networkx.Graph()
    graph.add_node(start)
    closed = {cell for cell, colour in view.doors if colour != COLOUR[player]}
    for cell, _ in view.doors:
        beside = {lines[cell[0] + dr][cell[1] + dc] for dr, dc in list(STEPS.values())[1:]}
        if avoid is not None and str(avoid) in beside:
            closed.add(cell)
    open_cells = (grid - closed) | {start}
    for r, c in open_cells:
        for dr, dc in ((1, 0), (0, 1)):
            if (r + dr, c + dc) in open_cells:
                graph.add_edge((r, c), (r + dr, c + dc))
    found = networkx.single_source_shortest_path_length(graph, start)
    return min((found[g] for g in goals if g in found), default=None)
