// The shell: routes, theme, the bar on top. Data only ever becomes text.

import { AGAIN_MS, all, get, often } from "./api.js";
import { byId, memory, toast } from "./dom.js";
import { ago, when } from "./format.js";
import { answered, begin, listen, noted, state } from "./live.js";
import { plantView } from "./plant.js";
import { logOut, may, session, whoAmI } from "./session.js";
import { isUp, upWords } from "./states.js";
import { watchStore } from "./store.js";

const VIEWS = {
  "": async () => plantView,
  loop: async () => (await import("./loop.js")).loopView,
  alarms: async () => (await import("./alarms.js")).alarmsView,
  work: async () => (await import("./work.js")).workView,
  groups: async () => (await import("./groups.js")).groupsView,
  fleet: async () => (await import("./fleet.js")).fleetView,
  audit: async () => (await import("./audit.js")).auditView,
  login: async () => (await import("./login.js")).loginView,
  settings: async () => (await import("./settings.js")).settingsView,
};

let leave = null, shown = 0, first = true;

// A part of an address that is not well-formed is taken as it is.
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

// Routes are #/view/part?query; every one can be bookmarked.
async function route() {
  const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
  const [name, ...parts] = path.split("/").map(decoded);
  const mine = ++shown;
  // Who may not read is asked for a name, and comes where they wanted to go.
  const view = await (may("viewer") ? (VIEWS[name] ?? VIEWS[""]) : VIEWS.login)().catch(() => null);
  if (mine !== shown) return;
  if (!view) return fetchAgain(mine);
  leave?.();
  const main = byId("main");
  main.replaceChildren();
  main.className = name || "plant";
  document.title = parts[0] ? `${parts[0]} · stictiond` : "stictiond";
  for (const link of document.querySelectorAll("nav [data-view]")) {
    if (link.dataset.view === ({ loop: "plant", groups: "work" }[name] ?? (name || "plant"))) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  leave = view(main, parts, new URLSearchParams(query ?? ""));
  if (!first) {
    scrollTo(0, 0);
    if (!main.contains(document.activeElement)) main.focus({ preventScroll: true });
  }
  first = false;
}

// A part of the page that did not come. Some browsers remember that, so the page is fetched whole once the daemon answers.
async function fetchAgain(mine) {
  while (mine === shown) {
    toast("this part of the page cannot be fetched; trying again", true);
    await new Promise((done) => setTimeout(done, AGAIN_MS));
    if (mine === shown && (await get("/session").catch(() => null))) return location.reload();
  }
}

const THEMES = { auto: "◐ auto", light: "○ light", dark: "● dark" };

function theme(name) {
  if (name === "auto") document.documentElement.removeAttribute("data-theme");
  else document.documentElement.dataset.theme = name;
  memory.set("theme", name);
  const button = byId("theme");
  button.textContent = THEMES[name];
  button.setAttribute("aria-label", `Colours: ${name}; change`);
  dispatchEvent(new Event("recolour"));
}

byId("theme").addEventListener("click", () => {
  const names = Object.keys(THEMES), now = memory.get("theme") ?? "auto";
  theme(names[(names.indexOf(now) + 1) % names.length]);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => dispatchEvent(new Event("recolour")));
{
  const stored = memory.get("theme");
  theme(stored in THEMES ? stored : "auto");
}

// Of every kind, those of collectors too, which are of no loop. Many changes ask for one count.
let counting = null;
const recount = (milliseconds) => (counting ??= setTimeout(count, milliseconds));

async function count() {
  counting = null;
  try {
    const { to_acknowledge: total } = await get("/alarms?limit=1"), badge = byId("alarm-count");
    badge.hidden = total === 0;
    badge.textContent = String(total);
    badge.title = `${total} not acknowledged`;
  } catch {
    recount(5000);
  }
}

function bar(name, data) {
  if (name === "link") {
    const link = byId("link");
    link.textContent = state.link === "live" ? "live" : "no connection: what is shown is old";
    link.classList.toggle("bad", state.link !== "live");
    link.classList.toggle("good", state.link === "live");
  }
  if (name === "failed") toast("the loops cannot be fetched; trying again", true);
  // A whole list comes at the beginning, and after changes of which nothing was heard.
  if (name === "alarm" || (name === "loops" && data === null)) recount(400);
}

// The shell asks so often (ms), and then knows whether the daemon still answers: a stream is silent also where the host is gone.
const WATCH_MS = 5000, PATIENCE_MS = 10000;

async function collectors() {
  const pill = byId("collectors"), asked = performance.now();
  try {
    const { items, time } = await all("/collectors", { patience: PATIENCE_MS });
    noted(time);
    answered(true, asked);
    const up = items.filter(isUp).length;
    pill.textContent = `collectors ${up}/${items.length}`;
    pill.classList.toggle("bad", up < items.length);
    pill.title = items.map((item) => `${item.name}: ${upWords(item)}, last good sample ${ago(item.age_s)}`).join("\n");
    const stamp = byId("clock");
    stamp.textContent = when(time);
    stamp.dateTime = time;
  } catch (error) {
    // A daemon that is busy says so.
    if (error.told === false) answered(false, asked);
    pill.textContent = "collectors ?";
    pill.classList.add("bad");
    pill.title = `they cannot be asked: ${error.message}`;
  }
}

addEventListener("hashchange", route);
addEventListener("keydown", (event) => {
  const typing = event.target.closest?.("input, textarea, select, dialog");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  const go = { p: "#/", a: "#/alarms", w: "#/work", s: "#/settings", Escape: location.hash.startsWith("#/loop/") ? "#/" : null }[event.key];
  if (go) location.hash = go;
  if (event.key === "/" && byId("q")) {
    event.preventDefault();
    byId("q").focus();
  }
});

// The name of who sits here, and what only some may open.
function identity() {
  byId("who").hidden = byId("log-out").hidden = !session.name;
  byId("who").textContent = session.name ?? "";
  byId("who").title = session.roles.join(", ");
  byId("log-in").hidden = Boolean(session.name) || !session.log_in || !may("viewer");
  document.querySelector('nav [data-view="audit"]').hidden = !(session.audited && may("engineer"));
  for (const link of document.querySelectorAll("nav [data-view]:not([data-view=audit], [data-view=fleet]), #collectors, #link")) link.hidden = !may("viewer");
}

// Who is alone has no fleet to show.
async function inFleet() {
  const fleet = may("viewer") && (await get("/fleet").catch(() => null));
  document.querySelector('nav [data-view="fleet"]').hidden = !fleet || fleet.role === "alone";
}

byId("log-out").addEventListener("click", async () => {
  await logOut().catch((error) => toast(error.message, true));
  location.reload();
});
// Once: the page that comes then asks who sits there.
addEventListener("signed-out", () => session.name && location.reload(), { once: true });

listen(bar);
try {
  await whoAmI();
} catch (error) {
  toast(`your log-in cannot be checked: ${error.message}`, true);
}
identity();
route();
inFleet();
if (may("viewer")) {
  begin();
  often(collectors, WATCH_MS);
  watchStore();
}
