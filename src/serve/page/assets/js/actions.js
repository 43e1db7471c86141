// What an operator does about an alarm: dialogs that ask who and why. The daemon has the last word.

import { alarmPath, post } from "./api.js";
import { h, memory, toast } from "./dom.js";
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
    let acted = false;
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const said = Object.fromEntries(new FormData(form));
      if (said.by) memory.set("name", said.by);
      try {
        await act(said);
        acted = true;
        dialog.close();
      } catch (error) {
        wrong.textContent = error.message;
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

async function alarm(id, action, body, done) {
  await post(alarmPath(id, action), body);
  touch(id);
  toast(done);
}

const comment = (label, more) => h("label", null, label, h("textarea", { name: "comment", rows: "2", maxlength: "1000", ...more }));

export const acknowledge = (id) =>
  ask(`Acknowledge the alarm of ${id}`, [comment("Remark (optional)")], "Acknowledge", ({ by, comment: said }) => alarm(id, "ack", { by, comment: said || null }, `${id}: acknowledged`));

const DURATIONS = [["1 hour", 3600], ["8 hours: a shift", 28800], ["24 hours", 86400], ["3 days", 259200], ["7 days", 604800]];

export const shelve = (id) =>
  ask(`Shelve the alarm of ${id}`, [h("label", null, "For", h("select", { name: "duration", autofocus: true }, DURATIONS.map(([text, seconds]) => h("option", { value: seconds, selected: seconds === 28800 }, text)))), comment("Reason", { required: true })], "Shelve",
    ({ by, comment: said, duration }) => alarm(id, "shelve", { by, comment: said, duration_s: Number(duration) }, `${id}: shelved`));

export const unshelve = (id) =>
  ask(`End the shelving of ${id}`, [comment("Remark (optional)")], "Unshelve", ({ by, comment: said }) => alarm(id, "unshelve", { by, comment: said || null }, `${id}: no longer shelved`));
