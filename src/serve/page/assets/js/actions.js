// What an operator does about an alarm: dialogs that ask who and why. The daemon has the last word.

import { alarmPath, get, post } from "./api.js";
import { h, memory, toast } from "./dom.js";
import { lasting } from "./format.js";
import { touch } from "./live.js";
import { session } from "./session.js";

const name = () => session.name ?? memory.get("name") ?? "";

/** Asks for what `fields` make, then acts; resolves to true when it was done. */
function ask(title, fields, verb, act) {
  return new Promise((done) => {
    const wrong = h("p", { class: "wrong", role: "alert" });
    const by = h("input", { name: "by", maxlength: "100", autocomplete: "name", required: true, value: name() });
    const form = h("form", { method: "dialog" }, h("h2", { id: "asked" }, title), session.name ? h("p", { class: "note" }, `as ${session.name}`) : h("label", null, "Your name", by), ...fields, wrong,
      h("div", { class: "acts" }, h("button", { type: "button", on: { click: () => dialog.close() } }, "Cancel"), h("button", { class: "main" }, verb)));
    const dialog = h("dialog", { "aria-labelledby": "asked" }, form);
    let acted = false, busy = false;
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      // What waits for its answer is not done twice: the record of a change may take seconds.
      if (busy) return;
      busy = true;
      const said = Object.fromEntries(new FormData(form));
      if (said.by) memory.set("name", said.by);
      try {
        await act(said);
        acted = true;
        dialog.close();
      } catch (error) {
        wrong.textContent = error.message;
      } finally {
        busy = false;
      }
    });
    dialog.addEventListener("close", () => {
      dialog.remove();
      done(acted);
    });
    document.body.append(dialog);
    dialog.showModal();
    if (name()) (form.querySelector("[autofocus]") ?? form.querySelector(".main")).focus();
  });
}

// `name` is what people call the alarm, `loop` whose it is: both are the alarm's own where it is a loop's stiction.
async function alarm(id, loop, action, body, done) {
  const answer = await post(alarmPath(id, action), body);
  if (loop) touch(loop);
  toast(answer.survives_restart === false ? `${done} (not kept over a restart)` : done);
}

const comment = (label, more) => h("label", null, label, h("textarea", { name: "comment", rows: "2", maxlength: "1000", ...more }));
const remark = () => comment("Remark (optional)");

/** Asks for a name and a remark, then posts. */
const simple = (title, fields, verb, action, done) => (id, name = id, loop = id) =>
  ask(`${title} ${name}`, fields(), verb, ({ by, comment: said }) => alarm(id, loop, action, { by, comment: said || null }, `${name}: ${done}`));

export const acknowledge = simple("Acknowledge the alarm of", () => [remark()], "Acknowledge", "ack", "acknowledged");
export const unshelve = simple("End the shelving of", () => [remark()], "Unshelve", "unshelve", "no longer shelved");
export const reset = simple("Reset the latched alarm of", () => [remark()], "Reset", "reset", "reset");
export const takeOut = simple("Take out of service the alarm of", () => [comment("Reason", { required: true, autofocus: true })], "Take out", "out-of-service", "out of service");
export const giveBack = simple("Give back to service the alarm of", () => [remark()], "Give back", "in-service", "back in service");

const DURATIONS = [["1 hour", 3600], ["8 hours: a shift", 28800], ["24 hours", 86400], ["3 days", 259200], ["7 days", 604800]];
const ONCE = "once", WEEK_S = 604800;

export function shelve(id, name = id, loop = id) {
  const once = h("option", { value: ONCE }), options = DURATIONS.map(([text, seconds]) => h("option", { value: seconds, selected: seconds === 28800 }, text));
  const choice = h("select", { name: "duration", autofocus: true }, options, once);
  let most;
  // Offers no more than is allowed (s).
  function bound(seconds) {
    most = seconds;
    once.textContent = `until its condition goes, at most ${lasting(most)}`;
    for (const own of options) if (Number(own.value) > most) own.remove();
    if (choice.options.length > 1) return;
    once.before(h("option", { value: most }, lasting(most)));
    choice.selectedIndex = 0;
  }
  // The dialog does not wait for the daemon, which refuses what is too long.
  bound(WEEK_S);
  get("/system").then((system) => bound(system.max_shelve_s), () => {});
  return ask(`Shelve the alarm of ${name}`, [h("label", null, "For", choice), comment("Reason", { required: true })], "Shelve", ({ by, comment: said, duration }) => {
    const how = duration === ONCE ? { duration_s: most, one_shot: true } : { duration_s: Number(duration) };
    return alarm(id, loop, "shelve", { by, comment: said, ...how }, `${name}: shelved`);
  });
}

const WORK = { order: ["Order the work on", "Order", "ordered"], repaired: ["Say that the work is done on", "Done", "done; the next looks decide whether it helped"], dismiss: ["Take off the list", "Dismiss", "dismissed"], reopen: ["Open again the order for", "Reopen", "open again"] };

/** Asks for a name and a note, then acts on the order of a loop. */
export function workAct(id, action) {
  const [title, verb, done] = WORK[action];
  return ask(`${title} ${id}`, [comment("Note (optional): number of the order, what was done")], verb, async ({ by, comment: note }) => {
    const answer = await post(`/work/${encodeURIComponent(id)}/${action}`, { by, note: note || null });
    toast(`${id}: ${done}${answer.survives_restart === false ? " (not kept over a restart)" : ""}`);
  });
}
