// The page: what is shown when, and the conversation with the server (analysis/play/conversation.py).

import { Board, BLUE, RED, pictures } from "./board.js";
import { Keys, STEPS } from "./keys.js";
import { Figure } from "./motion.js";
import { Words } from "./words.js";

const STORE = "prosocial-play";
const TAKEN_OVER = 4001;
const $ = (id) => document.getElementById(id);
const SECTIONS = [...document.querySelectorAll("main > section")];
const counted = (n, one) => `${n} ${one}${n === 1 ? "" : "s"}`;

const board = new Board($("board"));
const words = new Words($("status"));
let socket = null, welcome = null, session = null, round = null, state = null, figures = null;
let heard = 0, begins = 0, phase = "loading", over = false, leaving = false, retry = 0;

// -- pages ----------------------------------------------------------------------------------------
function show(id) {
  if (phase === id) return;
  phase = id;
  for (const section of SECTIONS) section.hidden = section.id !== id;
  keys.active = id === "play";
  if (id !== "play") keys.clear();
  $("withdraw").hidden = !session || ["withdrawn", "sorry", "consent", "loading"].includes(id);
  scrollTo(0, 0);
  (id === "play" ? $("board") : $(id).querySelector("h1"))?.focus({ preventScroll: true });
}

function rounds(now, done) {
  const list = $("rounds");
  list.replaceChildren(...Array.from({ length: session && welcome.rounds > 1 ? welcome.rounds : 0 }, (_, i) => {
    const item = document.createElement("li");
    item.textContent = i < done ? "✓" : i + 1;
    item.className = i < done ? "done" : i === now ? "now" : "";
    item.setAttribute("aria-label", `Round ${i + 1}${i < done ? ", played" : i === now ? ", now" : ""}`);
    return item;
  }));
}

function consentPage() {
  $("consent-text").replaceChildren(...welcome.consent.map((text) => {
    const paragraph = document.createElement("p");
    paragraph.textContent = text;
    return paragraph;
  }));
  $("agree").checked = false;
  $("agreed").disabled = true;
  show("consent");
}

function instructionsPage() {
  $("length").textContent = welcome.rounds === 1
    ? `There is one round of ${welcome.seconds} seconds.`
    : `There are ${welcome.rounds} rounds of ${welcome.seconds} seconds each, with a break after each.`;
  show("instructions");
}

function betweenPage(title, text, button, scores) {
  $("between-title").textContent = title;
  $("between-text").textContent = text;
  $("next").textContent = button;
  $("result").hidden = !scores;
  if (scores) {
    for (const [i, who] of ["you", "robot"].entries()) {
      $(`round-${who}`).textContent = scores.score[i];
      $(`total-${who}`).textContent = `${scores.totals[i]} so far`;
    }
  }
  show("between");
}

function endPage(totals) {
  $("end-score").textContent = `You collected ${counted(totals[0], "token")}, the robot ${counted(totals[1], "token")}.`;
  $("end-withdraw").textContent = `You can still withdraw with the button at the top. ${welcome.withdrawal}`;
  show("end");
}

function sorryPage(text, anew) {
  over = true;
  $("sorry-text").textContent = text;
  $("anew").hidden = !anew;
  show("sorry");
}

function cover(text, count = false) {
  $("cover").hidden = !text;
  $("cover").className = count ? "count" : "";
  if ($("cover").textContent !== text) $("cover").textContent = text;
}

// -- the server -----------------------------------------------------------------------------------
function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function stored() {
  try { return localStorage.getItem(STORE); } catch { return null; }
}

function store(token) {
  try {
    if (token) localStorage.setItem(STORE, token); else localStorage.removeItem(STORE);
  } catch { /* without a store the study can be played, but not gone on with */ }
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/play`);
  socket.addEventListener("open", () => { retry = 0; send({ type: "hello", token: session?.token ?? stored() }); });
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    HEAR[message.type]?.(message, performance.now());
  });
  socket.addEventListener("close", (event) => {
    if (over) return;
    if (event.code === TAKEN_OVER) {
      sorryPage("The study was opened in another window. It goes on there.", false);
      return;
    }
    if (phase === "play") { cover("The connection is lost. Trying again …"); keys.clear(); round = null; }
    setTimeout(connect, Math.min(5000, 300 * 2 ** retry++));
  });
}

const HEAR = {
  welcome(message) {
    welcome = message;
    if (!stored() && !session) consentPage();
  },

  session(message) {
    const fresh = !session && phase === "consent";
    session = message;
    store(message.token);
    if (leaving) { send({ type: "withdraw" }); return; }
    rounds(message.k, message.k);
    if (message.k >= message.of) endPage(message.totals);
    else if (message.paused) {
      betweenPage("Welcome back", `Round ${message.k + 1} of ${message.of} waits where you left it.`, "Continue", null);
    } else if (fresh || message.k === 0) instructionsPage();
    else if (phase !== "between") {
      betweenPage("Welcome back", `Next is round ${message.k + 1} of ${message.of}.`, `Start round ${message.k + 1}`, null);
    }
  },

  round(message, now) {
    round = message;
    state = message.state;
    heard = now;
    begins = now + message.countdown * 1000;
    figures = {
      you: new Figure(state.you, message.step_seconds.you * 1000),
      robot: new Figure(state.robot, message.step_seconds.robot * 1000),
    };
    board.begin(message);
    words.begin(message);
    rounds(message.k, message.k);
    panel(true);
    if (message.countdown > 0) cover(String(Math.ceil(message.countdown)), true);
    show("play");
    if (keys.move) send({ type: "key", move: keys.move, pressed: false });
  },

  tick(message, now) {
    if (!round) return;
    const before = state;
    state = message;
    heard = now;
    for (const who of ["you", "robot"]) figures[who].told(state[who], now);
    if (state.score[0] > before.score[0]) board.pop(state.you, RED, now);
    if (state.score[1] > before.score[1]) board.pop(state.robot, BLUE, now);
    words.tick(state, Math.ceil(state.left * round.tick_seconds));
    panel(false);
  },

  over(message) {
    round = null;
    session.k = message.k + 1;
    rounds(message.k + 1, message.k + 1);
    words.say(`Round ${message.k + 1} is over. You collected ${message.score[0]}, the robot ${message.score[1]}.`);
    if (message.k + 1 >= message.of) endPage(message.totals);
    else {
      const next = message.k + 2;
      betweenPage(`Round ${message.k + 1} of ${message.of} is over`, "Go on when you are ready.", `Start round ${next}`, message);
    }
  },

  withdrawn(message) {
    over = true;
    leaving = false;
    session = round = null;
    store(null);
    rounds(-1, 0);
    $("withdrawn-text").textContent = message.words === "delete"
      ? "Everything that was recorded of your rounds has been deleted."
      : "The rounds you finished before are kept without your name. Nothing is added.";
    show("withdrawn");
    socket.close();
  },

  sorry(message) {
    sorryPage(message.words, message.anew);
  },
};

// -- the panel, and every frame ---------------------------------------------------------------------
function panel(all) {
  const left = Math.max(0, state.left * round.tick_seconds);
  $("seconds").textContent = Math.ceil(left);
  $("bar").style.transform = `scaleX(${left / round.seconds})`;
  for (const [i, who] of ["you", "robot"].entries()) {
    const place = $(`score-${who}`), text = String(state.score[i]);
    if (place.textContent === text) continue;
    place.textContent = text;
    place.classList.remove("bump");
    if (!all) { void place.offsetWidth; place.classList.add("bump"); }
  }
}

function frame() {
  requestAnimationFrame(frame);
  if (!round) return;
  const now = performance.now();
  if (now < begins) cover(String(Math.ceil((begins - now) / 1000)), true);
  else if (!$("cover").hidden) cover("");
  board.draw(state, figures, now);
}

// The player's own step is drawn at once where the rules, as far as they can be seen, allow it.
function pressed(move, fresh) {
  send({ type: "key", move, pressed: fresh });
  const now = performance.now();
  if (!fresh || !round || now < begins) return;
  const you = figures.you, tick = round.tick_seconds * 1000;
  you.facing = move;
  if (you.guess || state.left === 0 || state.ready * tick - (now - heard) > tick / 2) return;
  const cell = state.you.map((at, i) => at + STEPS[move][i]);
  const letter = round.map[cell[0]]?.[cell[1]] ?? "#";
  const at = round.doors.findIndex(([row, column]) => row === cell[0] && column === cell[1]);
  if (letter === "#" || (at >= 0 && state.doors[at] !== "r")) return;
  you.expect(move, cell, now, tick);
}

const keys = new Keys(pressed, () => { if (round) words.say(words.where(state)); });

// -- buttons ----------------------------------------------------------------------------------------
$("agree").addEventListener("change", () => { $("agreed").disabled = !$("agree").checked; });
$("agreed").addEventListener("click", () => { $("agreed").disabled = true; send({ type: "consent" }); });
for (const id of ["first", "next"]) $(id).addEventListener("click", () => send({ type: "start" }));
$("withdraw").addEventListener("click", () => {
  keys.clear();
  $("sure-text").textContent = welcome.withdrawal;
  $("sure").showModal();
});
$("stay").addEventListener("click", () => $("sure").close());
$("sure").addEventListener("close", () => { if (phase === "play") $("board").focus({ preventScroll: true }); });
$("leave").addEventListener("click", () => {
  $("sure").close();
  leaving = true; // also if the connection is lost right now: it is said as soon as it is back
  send({ type: "withdraw" });
});
for (const id of ["another", "anew"]) $(id).addEventListener("click", () => { store(null); location.reload(); });

pictures();
requestAnimationFrame(frame);
connect();
