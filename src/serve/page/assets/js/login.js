// The log-in: a form, and nothing of the plant.

import { h } from "./dom.js";
import { logIn } from "./session.js";

export function loginView(main) {
  const wrong = h("p", { class: "wrong", role: "alert" });
  const user = h("input", { name: "user", autocomplete: "username", autocapitalize: "none", spellcheck: "false", maxlength: "64", required: true });
  const password = h("input", { name: "password", type: "password", autocomplete: "current-password", maxlength: "1024", required: true });
  const enter = h("button", { class: "main" }, "Log in");
  const form = h("form", { class: "card login", "aria-labelledby": "login" }, h("h1", { id: "login" }, "Log in"), h("label", null, "Name", user), h("label", null, "Password", password), wrong, h("div", { class: "acts" }, enter));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    enter.disabled = true;
    wrong.textContent = "";
    try {
      await logIn(user.value, password.value);
      // Everything that was not fetched is fetched now, by who it is for.
      if (location.hash.startsWith("#/login")) history.replaceState(null, "", "#/");
      location.reload();
    } catch (error) {
      wrong.textContent = error.message;
      enter.disabled = false;
      password.value = "";
      password.focus();
    }
  });
  main.append(form);
  user.focus();
  return () => {};
}
