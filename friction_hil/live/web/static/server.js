// The page's connection to its server: the token, the stream of data, and requests that change something.

const KEY = "friction-hil token";
const SILENCE_MS = 3000; // the server sends something at least every second
const RETRY_MS = 1000;

let token = takeToken();

// The token comes in the fragment of the address, which browsers do not send; it does not stay there.
function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    keep(given);
    history.replaceState(null, "", location.pathname);
    return given;
  }
  try {
    return sessionStorage.getItem(KEY) ?? "";
  } catch {
    return ""; // storage is switched off
  }
}

function keep(given) {
  try {
    sessionStorage.setItem(KEY, given);
  } catch {
    // then it is asked for again
  }
}

export function hasToken() {
  return token !== "";
}

export function useToken(given) {
  token = given;
  keep(given);
}

function headers() {
  return token ? { Authorization: `Bearer ${token}` } : {};
}

// Ask for a change. Returns the server's answer: ok, and problems where it is refused.
export async function post(path, content) {
  try {
    const answer = await fetch(path, {
      method: "POST",
      headers: { ...headers(), "Content-Type": "application/json" },
      body: JSON.stringify(content),
    });
    const said = await answer.json();
    return { ...said, status: answer.status };
  } catch (error) {
    return { ok: false, status: 0, problems: [`no answer: ${error.message}`] };
  }
}

// Read the stream for ever. `take` gets each message; `lost` the reason when there is none any more.
export async function follow(take, lost) {
  for (;;) {
    const { reason, status } = await readOnce(take);
    lost(reason, status);
    await new Promise((resume) => setTimeout(resume, RETRY_MS));
  }
}

async function readOnce(take) {
  const stop = new AbortController();
  let timer = 0;
  const wait = () => {
    clearTimeout(timer);
    timer = setTimeout(() => stop.abort(), SILENCE_MS);
  };
  try {
    wait();
    const answer = await fetch("api/stream", { headers: headers(), signal: stop.signal });
    if (!answer.ok) {
      const said = await answer.json();
      return { reason: said.problems.join(" "), status: answer.status };
    }
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return { reason: "the server of this page has ended", status: 0 };
      wait();
      const lines = (rest + value).split("\n");
      rest = lines.pop();
      for (const line of lines) if (line) take(JSON.parse(line));
    }
  } catch {
    const how = stop.signal.aborted ? "does not answer" : "cannot be reached";
    return { reason: `the server of this page ${how}`, status: 0 };
  } finally {
    clearTimeout(timer);
    stop.abort();
  }
}
