// One loop: the verdict in words, the trends, and the picture that makes one believe it.

import { AGAIN_MS, get, href, loopPath, mayPass, often, orNull, post } from "./api.js";
import { acknowledge, shelve, unshelve } from "./actions.js";
import { h, scroll, toast } from "./dom.js";
import { ago, frictionNamed, lasting, percent, short, when } from "./format.js";
import { listen, since, state as known, touch } from "./live.js";
import { drawEvidence, leaveEvidence } from "./evidence.js";
import { health } from "./health.js";
import { opinionsPanel } from "./opinions.js";
import { may } from "./session.js";
import { alarmWords, isShelved, kindOf, mayAck, mayShelve, VERDICTS, words } from "./states.js";
import { trend } from "./trend.js";

const AGE_MS = 30_000; // After how long it is said anew how old things are.
const OLD_S = 120, SCANS = 10; // A value that is older, and by more than so many sample periods, has its age beside it.
const TERM_MS = 5_000; // How often write-back is asked for: nothing tells that a term changes.
const AGING = new Set(["age_s", "values", "writeback"]); // What may differ each time it is fetched, and is drawn by itself.

const link = (id) => h("a", { href: `#/loop/${encodeURIComponent(id)}` }, id);
// Why it was not at rest by the latest look at the plant, where that is not its valve, of which the verdict speaks. A cause that is not
// known has no probability.
const causeLine = ({ time, name, probability, neighbour, why }) => h("p", { class: "cause" }, `Cause by the look at the plant of ${when(time)}: ${name}`, neighbour ? [" ", link(neighbour)] : null, `${probability === null ? "" : `, ${percent(probability)}`}: ${why}.`);
const card = (title, size, ...children) => h("section", { class: `card ${size}`, "aria-label": title }, h("header", null, h("h2", null, title)), ...children);
const pairs = (list) => list.map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value)));

// The collector decodes the mode: 1 is automatic.
const reading = (tag, value) => (tag === "mode" && value !== null ? (value === 1 ? "automatic" : "manual") : short(value));

export function loopView(main, [id]) {
  let over = false, endTrend = null, begun = false, showing = null, again = false, drawn = null, retry = null, diagnosed = null, oldest = OLD_S;
  const newest = new Map(); // What is known of each tag, and until when it is known to have held (ms), by our own clock.
  const head = h("div", { class: "head" }, h("a", { class: "back", href: "#/" }, "← Plant"), h("h1", null, id), h("p"));
  const banner = h("section", { class: "verdict", "aria-label": "Verdict" });
  const age = h("span");
  const values = h("dl", { class: "values", "aria-label": "Latest values" });
  const boxes = Object.fromEntries(["trend", "pvop", "stem", "position", "aic", "months", "effects", "series", "spectrum", "acf", "ccf", "facts", "runs", "writeback", "opinions", "health"].map((name) => [name, h("div")]));
  const figure = (name, caption, keys) => h("figure", { id: name }, boxes[name], keys ? h("div", { class: "keys" }, keys.map(([look, text]) => h("span", { class: look }, text))) : null, h("figcaption", null, caption));
  boxes.effects.className = "story";
  const residual = card("What the model leaves over", "", boxes.effects, h("div", { class: "cards" },
    h("div", { class: "card two" }, h("h3", null, "Residual, one step ahead"), figure("series", "The smaller and the more like noise, the more of PV is explained.", [["sp2", "friction and linear process alone"], ["op", "with the effects"]])),
    h("div", { class: "card third" }, h("h3", null, "Spectrum"), figure("spectrum", "A peak is a swing that is not explained yet.")),
    h("div", { class: "card half" }, h("h3", null, "Correlation with its own past"), figure("acf", "Within the dashed lines it is noise.")),
    h("div", { class: "card half" }, h("h3", null, "Correlation with past OP"), figure("ccf", "Outside the dashed lines the valve's way to PV is not fully described."))));
  const term = h("dl", { class: "facts" }), effect = scroll("Before and with the term");
  boxes.writeback.append(term, effect);
  const writeback = card("Write-back", "", boxes.writeback);
  const opinions = card("Opinions", "", h("p", { class: "note" }, "What published methods say of the same window. They are information beside the verdict; a line opens what the method looked at."), boxes.opinions), second = opinionsPanel(id, boxes.opinions);
  const indicators = card("Health", "", h("p", { class: "note" }, "How the loop does its work, valve or not: the latest hour beside its shift, day and week."), boxes.health);
  const cards = h("div", { class: "cards" },
    card("Trend", "", values, h("figure", { id: "trend" }, boxes.trend, h("div", { class: "keys" }, h("span", { class: "pv" }, "PV"), h("span", { class: "sp" }, "SP"), h("span", { class: "op" }, "OP"), h("span", { class: "mv" }, "MV, measured stem")))),
    card("PV over OP, with the dead band plus stick band", "half", figure("pvop", "Inside the band OP moves and the valve does not.", [["pv", "measured"], ["stem", "PV if it followed the fitted stem"], ["band", "dead band plus stick band (2f)"]])),
    card("Stem over OP", "half", figure("stem", "On each reversal the stem stands still until OP has come back by 2f.", [["stem", "fitted stem"], ["mv", "measured, where there is one"], ["band", "dead band plus stick band (2f)"]])),
    card("Estimated valve position", "", figure("position", "The steps of a sticking valve beside the OP that asks for a smooth movement.", [["op", "OP"], ["stem", "fitted stem"], ["mv", "measured, where there is one"]])),
    card("How sure: AIC over f", "half", figure("aic", "The lower the AIC, the better the model explains PV. The shaded interval is the 95 % interval of f.")),
    card("f over time", "half", figure("months", "Each dot is a diagnosis with its 95 % interval; triangles are changes of the alarm.")),
    residual, opinions, indicators, writeback, card("Facts", "half", boxes.facts), card("Latest diagnoses", "half", boxes.runs));
  main.append(head, banner, cards);
  residual.hidden = opinions.hidden = indicators.hidden = writeback.hidden = true;

  const button = (text, act, main_ = false) => may("operator") && h("button", { type: "button", class: main_ ? "main" : null, on: { click: act } }, text);
  const acted = async (act) => (await act(id)) && show();

  async function run(event) {
    const asked = event.currentTarget;
    asked.disabled = true;
    try {
      const answer = await post(`${loopPath(id)}/diagnosis?wait_s=30`);
      toast(answer.state === "running" ? "begun; the result follows" : `${id}: ${VERDICTS[answer.verdict] ?? answer.verdict}`);
      touch(id);
      await show();
    } catch (error) {
      toast(error.message, true);
    } finally {
      asked.disabled = false;
    }
  }

  function drawBanner(detail, report, said) {
    const kind = kindOf(detail), state = detail.alarm;
    banner.dataset.kind = kind.key;
    // Friction may be likely and its f still be too small to matter, or 0 within its interval: beside f = 0 that would read as a contradiction.
    const likely = report && (report.verdict === "stiction" || report.posterior <= 0.5);
    const odds = !report ? "" : report.posterior === null ? ` · evidence ${short(report.delta_aic, 3)}` : likely ? ` · probability of friction ${percent(report.posterior)}` : "";
    const f = report && report.verdict !== "not_identifiable" ? ` · ${frictionNamed(report)}${odds}` : "";
    const acts = [mayAck(state) && button("Acknowledge", () => acted(acknowledge), true), isShelved(state) ? button("Unshelve", () => acted(unshelve)) : mayShelve(state) && button("Shelve …", () => acted(shelve)),
      button("Diagnose now", run), h("a", { class: "button", href: href(`${loopPath(id)}/report.html`), target: "_blank", rel: "noopener" }, "Report")];
    diagnosed = report?.time ?? null;
    age.textContent = ago(report?.age_s);
    age.title = when(diagnosed);
    const focused = banner.contains(document.activeElement) ? document.activeElement.textContent : null;
    banner.replaceChildren(h("span", { class: "mark" }), h("div", null, h("strong", null, said ? said.words : "Not diagnosed yet."), h("p", null, `${kind.label}${f}`, report ? [" · diagnosed ", age] : null, detail.failure ? ` · latest run: ${words(detail.failure)}` : null),
      detail.cause && detail.cause.name !== "valve" ? causeLine(detail.cause) : null,
      detail.swings_with ? h("p", null, "It swings with ", link(detail.swings_with), `, the likeliest source, and may calm down when ${detail.swings_with} does: see the `, h("a", { href: "#/work" }, "work list"), ".") : null,
      detail.other_alarms?.length ? h("p", { class: "others" }, h("a", { href: "#/alarms" }, "Other alarms"), `: ${detail.other_alarms.map((one) => `${alarmWords(one.kind)}, ${words(one.state)}`).join("; ")}`) : null), h("div", { class: "acts" }, acts));
    if (focused) [...banner.querySelectorAll("button, a")].find((one) => one.textContent === focused)?.focus();
  }

  // What was said when it was fetched grows old. Of a value that nothing has come of, the daemon may know that it still holds.
  async function grow() {
    const seconds = since(diagnosed), asked = performance.now();
    if (seconds !== null) age.textContent = ago(seconds);
    const detail = [...newest.keys()].some(isLate) && (await get(loopPath(id)).catch(() => null));
    if (detail && !over) drawValues(detail.values, asked);
    else for (const tag of newest.keys()) drawValue(tag);
  }

  // How old a value is (s): the clock that stamped it may be hours off.
  function ageOf(tag) {
    const { at } = newest.get(tag);
    return at === null ? null : (performance.now() - at) / 1000;
  }
  const isLate = (tag) => ageOf(tag) > oldest;
  // Only PV never stands still: a source may send the others when they change, and OP may be in manual. Where PV is late OP is, too.
  const isLost = (tag) => (tag === "pv" || tag === "op") && isLate(tag) && newest.has("pv") && isLate("pv");

  // A value that is not good says why, and one that is old says how old.
  function drawValue(tag) {
    const { value, unit, quality } = newest.get(tag), good = quality === "good";
    const box = values.querySelector(`[data-tag="${CSS.escape(tag)}"]`);
    box?.classList.toggle("bad", !good || isLost(tag));
    box?.lastChild.replaceChildren(reading(tag, value), " ", h("small", null, [unit, good ? "" : quality, isLate(tag) ? ago(ageOf(tag)) : ""].filter(Boolean).join(" ")));
  }

  // The values of an answer to what was asked at a time (ms).
  function drawValues(list, asked) {
    const name = (tag) => (["op", "pv", "sp", "mv"].includes(tag) ? tag.toUpperCase() : tag);
    values.replaceChildren(...list.map(({ tag }) => h("div", { "data-tag": tag }, h("dt", null, name(tag)), h("dd"))));
    const before = new Map(newest);
    newest.clear();
    for (const own of list) newest.set(own.tag, latest(own, asked, before.get(own.tag)));
    for (const tag of newest.keys()) drawValue(tag);
  }

  // What came since then is newer. We may have heard the same sample when it came.
  function latest(own, asked, kept) {
    if (kept?.at > asked) return kept;
    const at = own.age_s === null ? null : asked - 1000 * own.age_s;
    return { ...own, at: at !== null && kept?.time === own.time ? Math.max(at, kept.at) : at };
  }

  // What drives a loop is taken from measured disturbances alone. Where loops drive each other, the only one whose valve sticks is named.
  const source = (origin) => (!origin.starts_in ? "some of these loops drive each other." : origin.sticky ? `the valve of ${origin.starts_in} sticks, and such a valve can swing by itself.` : `nothing known drives ${origin.starts_in}.`);

  function drawEffects(report, said, origin) {
    const { residual: r } = report;
    const gain = (before, after) => (!before || !after || before === after ? "" : ` (${short(Math.abs((100 * (before - after)) / before), 2)} % ${after < before ? "less" : "more"})`);
    const found = said.effects.map((one) =>
      h("li", null, h("strong", null, one.title), one.meaning && h("span", null, one.meaning), one.advice && h("span", null, one.advice), h("p", null, one.posterior === null ? one.detail : `${one.detail}; probability ${percent(one.posterior)}`)));
    const model = report.verdict === "stiction" ? "Friction and a linear process explain PV" : "A linear process explains PV";
    const nothing = said.notes.length ? "" : r.white_after ? `${model}: what is left over is noise.` : r.unexplained ? "Something is left that no known effect explains." : "";
    boxes.effects.replaceChildren(found.length ? h("ul", { class: "effects" }, found) : h("p", null, nothing), found.length && r.unexplained ? h("p", null, "Something more is left that no known effect explains.") : "",
      ...said.notes.map((note) => h("p", null, note)),
      origin ? h("p", null, "A disturbance comes along ", origin.path.toReversed().flatMap((id, i) => [i ? " → " : "", h("a", { href: `#/loop/${encodeURIComponent(id)}` }, id)]), `: ${source(origin)}`) : "",
      said.left.length ? h("p", { class: "note" }, `The residual is no noise yet: ${said.left.join("; ")}.`) : "",
      h("dl", { class: "facts" }, pairs([
        ["one-step error before, after", `${short(r.one_step_rmse_before, 3)}, ${short(r.one_step_rmse_after, 3)}${gain(r.one_step_rmse_before, r.one_step_rmse_after)}`],
        ["free-run error before, after", `${short(r.free_run_rmse_before, 3)}, ${short(r.free_run_rmse_after, 3)}${gain(r.free_run_rmse_before, r.free_run_rmse_after)}`],
        ["noise only, before and after", `${r.white_before ? "yes" : "no"}, ${r.white_after ? "yes" : "no"}`], ["f before, after", `${short(r.f_before, 3)}, ${short(r.f_after, 3)} ${report.f_unit}`],
        ...(report.acquisition?.note ? [["sampling", report.acquisition.note]] : [])])));
  }

  function drawWriteback(view) {
    const row = (name, key, unit) => h("tr", null, h("th", { scope: "row" }, name), ...["before", "with", "running"].map((of) => h("td", { class: "number" }, view.effect?.[of] ? `${short(view.effect[of][key], 3)}${unit}` : "–")));
    const table = h("table", null, h("thead", null, h("tr", null, ["", "before", "with the term", "under way"].map((text, i) => h("th", { scope: "col", class: i ? "number" : null }, text)))),
      h("tbody", null, row("length (s)", "length_s", ""), row("ISE", "ise", ""), row("IAE", "iae", ""), row("PV standard deviation", "pv_sd", ""), row("stem travel", "travel_percent", " %"), row("reversals", "reversals", "")));
    term.replaceChildren(...pairs([["state", words(view.state)], ["since", when(view.since)], ["term", `${short(view.term_percent)} %`], ["in force", `${short(view.in_force_percent)} %`],
      ["ISE before over ISE with", view.effect ? short(view.effect.ise_gain, 3) : "–"], ["stem travel, with over before", view.effect ? short(view.effect.travel_ratio, 3) : "–"], ["granted by", view.grant ? `${view.grant.by}${view.grant.approved_by ? `, approved by ${view.grant.approved_by}` : ", not approved"}` : "nobody"],
      ["speaks against it", view.denials.map((denial) => denial.text).join("; ") || "nothing"], ["tripped by", view.tripped_by?.text ?? "nothing"]]));
    // What has the focus is the frame around it.
    effect.replaceChildren(table);
  }

  // Where write-back is enabled; what is not answered now is asked for again.
  async function lookAtTerm() {
    if (writeback.hidden || document.hidden) return;
    const view = await get(`${loopPath(id)}/writeback`).catch(() => null);
    if (view && !over) drawWriteback(view);
  }

  function drawFacts(detail, report) {
    const facts = [["unit", detail.group || "–"], ["diagnosed every", lasting(detail.period_s)], ["OP span, limits", `${short(detail.op_span)}; ${detail.op_limits ? detail.op_limits.map((v) => short(v)).join(" … ") : "–"}`]];
    if (report) {
      const { window: used, oscillation: swing, model, preparation: made, denoise } = report;
      facts.push(["window", `${used.n} samples, ${short(used.ts_s)} s apart, quality ${used.quality}`], ["from", when(report.window_start)], ["to", when(report.window_end)]);
      const { traced } = report.residual;
      // Of a stretch of its own, which may reach beyond the window.
      if (traced && (traced.n !== used.n || Math.abs(traced.start - used.start) > used.ts_s / 2)) facts.push(["effects looked for in", `${traced.n} samples, ${when(report.traced_start)} to ${when(report.traced_end)}`]);
      if (swing) facts.push(["oscillation", `period ${lasting(swing.period_s)}, regularity ${short(swing.regularity_r, 3)}, OP ± ${short(swing.op_amplitude, 3)}`]);
      if (model) facts.push(["model", `na ${model.na}, nb ${model.nb}, nc ${model.nc}, delay ${model.nk}; error ${short(model.rmse, 3)}`]);
      if (report.posterior !== null) facts.push(["evidence for friction", short(report.delta_aic, 3)]);
      if (report.rival) facts.push(["best other explanation of the declared model", report.rival]);
      if (report.f_detectable !== null) facts.push(["would have shown", `f above ${short(report.f_detectable, 3)} ${report.f_unit}`]);
      facts.push(["f as a share of OP's range", short(report.f_of_op_range, 3)], ["Srinivasan's d", `${short(report.d_srinivasan, 3)} ${report.f_unit}`], ["evenness of the evidence", short(report.steadiness, 3)]);
      if (made) facts.push(["filled in", `${short(100 * made.gap_share, 2)} %; skew ${short(made.worst_skew_s, 3)} s`]);
      if (denoise) facts.push(["denoised", denoise.applied ? `yes, noise ${short(100 * denoise.noise_share, 2)} %` : "no"]);
      facts.push(["took", `${short(report.took_s, 3)} s`]);
    }
    boxes.facts.replaceChildren(h("dl", { class: "facts" }, pairs(facts)));
  }

  function drawRuns(runs) {
    const cells = (run) => [h("td", { class: "time" }, when(run.time)), h("td", null, VERDICTS[run.outcome] ?? words(run.outcome)), h("td", { class: "number" }, run.f === null ? "–" : `${short(run.f, 3)} ${run.f_unit}`), h("td", { class: "number" }, short(run.delta_aic, 3))];
    boxes.runs.replaceChildren(scroll("Latest diagnoses", h("table", null, h("thead", null, h("tr", null, h("th", { scope: "col" }, "Time"), h("th", { scope: "col" }, "Outcome"), h("th", { scope: "col", class: "number" }, "f"), h("th", { scope: "col", class: "number" }, "Evidence"))), h("tbody", null, runs.slice(0, 12).map((run) => h("tr", null, cells(run)))))));
  }

  // What is under way ends first: changes that come faster than they can be shown hold nothing up.
  function show() {
    again = true;
    return (showing ??= showAll());
  }

  async function showAll() {
    while (again && !over) {
      again = false;
      await showOnce();
    }
    showing = null;
  }

  async function showOnce() {
    clearTimeout(retry);
    const asked = performance.now();
    try {
      const detail = await get(loopPath(id)), told = (part) => (detail.verdict ? orNull(get(`${loopPath(id)}/${part}`)) : null);
      const [report, evidence, model, runs, log] = await Promise.all([told("diagnosis"), told("evidence"), told("model"), get(`${loopPath(id)}/diagnoses?limit=2000`), get(`/alarms/history?limit=500&kind=stiction&loop=${encodeURIComponent(id)}`)]);
      if (over) return;
      oldest = Math.max(OLD_S, SCANS * (report?.window.ts_s ?? 0));
      drawValues(detail.values, asked);
      writeback.hidden = !detail.writeback;
      if (detail.writeback) drawWriteback(detail.writeback);
      health(id, boxes.health).then((found) => (indicators.hidden = !found), () => {});
      // What is the same is not drawn anew: somebody may be looking into a plot.
      const all = JSON.stringify([detail, report, evidence, model, runs, log], (key, value) => (AGING.has(key) ? undefined : value));
      if (all === drawn) return;
      head.lastChild.textContent = [detail.description, detail.group].filter(Boolean).join(" · ");
      drawBanner(detail, report, evidence);
      drawFacts(detail, report);
      drawRuns(runs.items);
      residual.hidden = !report || !evidence || report.verdict === "not_identifiable" && !report.residual.effects.length;
      if (!residual.hidden) drawEffects(report, evidence, model?.origin);
      opinions.hidden = !second.show(report, evidence?.notes);
      const measured = detail.values.some((v) => v.tag === "mv");
      for (const key of cards.querySelectorAll(".keys .mv")) key.hidden = !measured;
      const draw = () => drawEvidence(boxes, { detail, report, evidence, runs: runs.items, alarms: log.items });
      await draw();
      drawn = all;
      redraw = () => (second.redraw(), draw());
      if (!begun) begin(report?.oscillation?.period_s);
    } catch (error) {
      if (over) return;
      drawn = null;
      if (mayPass(error)) retry = setTimeout(show, AGAIN_MS);
      banner.replaceChildren(h("span", { class: "mark" }), h("div", null, h("strong", null, error.status === 404 ? `There is no loop ${id}.` : "The loop cannot be fetched."), h("p", null, error.message)));
    }
  }

  function drawNewest(tags) {
    for (const { tag, unit, time, value, quality } of tags) {
      if (!newest.has(tag) || !time.length) continue;
      newest.set(tag, { unit, time: time.at(-1), value: value.at(-1), quality: quality.at(-1), at: performance.now() });
      drawValue(tag);
    }
  }

  // Once a visit; where it fails, again after a while. What is said of the valve does not wait for it.
  async function begin(period) {
    begun = true;
    try {
      const end = await trend(boxes.trend, id, period, drawNewest);
      if (over) end();
      else endTrend = end;
    } catch (error) {
      boxes.trend.replaceChildren(h("p", { class: "note" }, `The trends cannot be fetched: ${error.message}`));
      setTimeout(() => over || begin(period), AGAIN_MS);
    }
  }

  let redraw = () => {};
  let width = innerWidth;
  const resized = () => innerWidth !== width && ((width = innerWidth), redraw());
  const recoloured = () => redraw();
  addEventListener("resize", resized);
  addEventListener("recolour", recoloured);
  // Each change of the loop, and all of them where nobody knows what was missed.
  const end = listen((name, data) => name === "loops" && (data === null ? known.complete : data.has(id)) && show());
  const endAges = often(grow, AGE_MS), endTerm = often(lookAtTerm, TERM_MS);
  show();
  return () => {
    over = true;
    endAges();
    endTerm();
    clearTimeout(retry);
    end();
    endTrend?.();
    leaveEvidence(boxes);
    removeEventListener("resize", resized);
    removeEventListener("recolour", recoloured);
  };
}
