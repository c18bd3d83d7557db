// The conversation with the server: its stream, and what is asked of it.
const state = { page: null, now: null, holder: "nobody", heard: 0 };
const listeners = [];

export const here = state;
export const listen = listener => listeners.push(listener);
export const holds = () => state.holder === "you";

async function answer(response) {
  const text = await response.text();
  let value = {};
  try { value = JSON.parse(text); } catch { /* A refusal of the HTTP library is plain text. */ }
  if (!response.ok) throw new Error(value.error ?? (text || `the server says ${response.status}`));
  return value;
}

export async function get(path, query = {}) {
  const words = new URLSearchParams(query).toString();
  return answer(await fetch(words ? `${path}?${words}` : path));
}

export async function post(path, body = {}) {
  return answer(await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) }));
}

// What moves the motor is asked for by the page that holds it.
export const command = (path, what) => post(path, what === undefined ? { page: state.page } : { page: state.page, what });

// The token stands in the address that the server printed; it is kept as a cookie that no script reads.
async function login() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (!token) return;
  history.replaceState(null, "", location.pathname);
  await post("/api/login", { token });
}

function open() {
  const stream = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream`);
  stream.onmessage = event => {
    const message = JSON.parse(event.data);
    if (message.page) state.page = message.page;
    const first = Boolean(message.page);
    Object.assign(state, { now: message.state, holder: message.holder, heard: performance.now(), open: true });
    for (const listener of listeners) listener(message, first);
    // Answered after it was shown: a page that does not keep up does not hold the motor.
    stream.send(JSON.stringify({ beat: message.beat }));
  };
  stream.onclose = () => {
    Object.assign(state, { page: null, holder: "nobody", open: false });
    for (const listener of listeners) listener(null, false);
    setTimeout(open, 1000);
  };
}

export async function begin() {
  await login();
  window.addEventListener("hashchange", () => { if (location.hash.startsWith("#token=")) login().catch(() => {}); });
  open();
}
