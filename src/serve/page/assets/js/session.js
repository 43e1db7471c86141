// Who sits here, and what they may do. Buttons that would be refused are not shown; the daemon has the last word.

import { credentials, get, post, remove } from "./api.js";

/** As GET /session says; until it was asked nobody may anything. */
export const session = { log_in: true, audited: false, name: null, roles: [], may: [], csrf: null };

/** Asks who sits here. */
export async function whoAmI() {
  known(await get("/session"));
}

function known(view) {
  Object.assign(session, view);
  credentials.csrf = view.csrf;
}

/** Whether somebody with this role may act, or may from here. */
export const may = (role) => session.may.includes(role);

export const logIn = async (user, password) => known(await post("/session", { user, password }));

export const logOut = () => remove("/session");
