"""Small cases: few samples, streams that say nothing, values that nothing comes of, very many changes at once, and what is read or pressed meanwhile.
Streams say what the test says."""

import re
from urllib.parse import parse_qs, urlsplit

from playwright.sync_api import expect

from trouble import BUSY, COLLECTORS, HEALTH, answer_samples, column, patch, plant_time, quick, reads, refuse_once, refused, rfc3339, tag
from walk import check

LOOP = "FIC00000"
DETAIL = re.compile(rf"/api/v1/loops/{LOOP}$")
RUNS = re.compile(rf"/api/v1/loops/{LOOP}/diagnoses\?")
SAMPLES = re.compile(rf"/api/v1/loops/{LOOP}/samples\?")
LIST = re.compile(r"/api/v1/loops\?")
TERM = re.compile(rf"/api/v1/loops/{LOOP}/writeback$")
ALARMS = re.compile(r"/api/v1/alarms$")
WORK = re.compile(r"/api/v1/work\?all=false$")

# Streams come from the test alone, by the last part of their address. What is not answered is given up soon while `hurried`, and the
# page's own clock is `ahead` by so much (ms).
SCRIPT = """(() => {
    const now = performance.now.bind(performance), timeout = AbortSignal.timeout.bind(AbortSignal);
    Object.assign(window, { streams: {}, hurried: false, ahead: 0 });
    performance.now = () => now() + window.ahead;
    AbortSignal.timeout = (wait) => timeout(window.hurried && wait === 10000 ? 300 : wait);
    window.EventSource = Object.assign(function (url) {
        const own = Object.assign(new EventTarget(), { readyState: 1, close() { this.readyState = 2; } });
        (window.streams[url.split("/").at(-1)] ??= []).push(own);
        return own;
    }, { CONNECTING: 0, OPEN: 1, CLOSED: 2 });
    window.say = (stream, name, data = {}) => void window.streams[stream].at(-1).dispatchEvent(new MessageEvent(name, { data: JSON.stringify(data) }));
})()"""


def begun(walk, *waits):
    page = walk.open(1440, 1000)
    page.add_init_script(SCRIPT)
    quick(page, *waits)
    return page


def hello(page):
    """The stream of events begins, and the list of loops comes."""
    page.wait_for_function("() => streams.events")
    with page.expect_response(LIST):
        page.evaluate("say('events', 'hello', { resumed: false })")


def until(page, holds, what):
    for _ in range(300):
        if holds():
            break
        page.wait_for_timeout(50)
    check(holds(), what)


def lines(walk):
    """When an interval is a silence, and what is drawn across one."""
    page = walk.open(1440, 900)
    page.goto(walk.base)
    found = page.evaluate("""async () => {
        const { line, longest, silences } = await import("/js/lines.js");
        const after = (...intervals) => longest(intervals.reduce((all, own) => [...all, all.at(-1) + own], [0])), many = (n, own) => Array(n).fill(own);
        const limits = [after(), after(1), after(1, 100), after(100, 1, 1), after(...many(10, 1), 11), after(...many(10, 1), 9), after(...many(20, 1), ...many(3, 200)), after(...many(60, 1), ...many(40, 20)), after(...many(9, 0), 1, 1)];
        const times = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 200, 201, 202], silent = silences(times, longest(times));
        const held = [[[0, 5, 6, 200], [50, null, 51, 52]], [[0], [50]], [[0, 5], [50, null]]].map((column) => line(column, silent, true, 202));
        return { limits, silent, polled: line([times, times], silent, false, 202), held };
    }""")
    check(found["limits"] == [float("inf"), float("inf"), 10, 10, 10, 190 / 11, 10, 86, 10], f"ten mean intervals are usual, and silences do not count in the mean: {found['limits']}")
    check(found["silent"] == [[11, 200]], "a silence is far longer than the usual interval")
    check(found["polled"][0][11:14] == [11, 105.5, 200] and found["polled"][1][11:14] == [11, None, 200], "a line breaks in a silence")
    changed, same, bad = found["held"]
    check(changed == [[0, 4.999, 5, 6, 11, 105.5, 200, 202], [50, 50, None, 51, 51, None, 52, 52]], "what holds ends at a mark, and breaks in a silence")
    check(same == [[0, 11, 105.5, 200, 202], [50, 50, None, 50, 50]], "what nothing else was heard of holds after a silence")
    check(bad == [[0, 4.999, 5, 105.5], [50, 50, None, None]], "what was bad before a silence is not known after it")


def parted(walk):
    """A window that shows two samples, and the silence between them."""
    page = begun(walk)
    newest = plant_time(walk)
    first = newest - 600
    times = [t for t in range(first, newest + 1, 2) if not first + 200 < t < first + 400]

    def samples(route):
        shown = [first + 200, first + 400] if "from=" in route.request.url else times
        answer_samples(route, [column(name, shown, [41.0] * len(shown)) for name in ("op", "pv")])

    page.route(SAMPLES, samples)
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    expect(page.locator(".trend")).to_have_attribute("data-newest", str(newest))
    with page.expect_response(SAMPLES):
        page.get_by_role("button", name="Everything that is remembered").click()
    expect(page.locator(".trend")).to_have_attribute("data-from", str(first))
    reads(page, first + 300, r"PV –.*OP –", "between two samples alone a silence is one, too")


def changes(walk):
    """Whole lists of loops, and more changes than are fetched one by one, while one loop is shown."""
    page = begun(walk)
    held, asked = [], []
    page.route(RUNS, lambda route: held.append(route))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    until(page, lambda: len(held) == 1, "the loop is asked for")
    hello(page)
    for _ in range(3):
        with page.expect_response(LIST):
            page.evaluate("say('events', 'lagged')")
    check(len(held) == 1, "what is under way is not begun anew")
    held.pop().continue_()
    expect(page.locator(".verdict")).to_have_attribute("data-kind", "unacknowledged")
    until(page, lambda: len(held) == 1, "what came first is shown, and then it is asked for once more")
    with page.expect_response(RUNS):
        held.pop().continue_()
    page.unroute(RUNS)

    page.on("request", lambda request: asked.append(request.url) if DETAIL.search(request.url) else None)
    with page.expect_response(LIST):
        page.evaluate("(ids) => ids.forEach((loop) => say('events', 'diagnosis', { loop }))", [f"FIC{at:05}" for at in range(1, 16)])
    with page.expect_response(RUNS):
        page.evaluate("(loop) => say('events', 'diagnosis', { loop })", LOOP)
    check(len(asked) == 2, f"changes of other loops ask for nothing of this one, and its own for its tile and its page: {asked}")


def busy(walk):
    """A daemon that is too busy, then a host that says nothing, while some streams go on."""
    page = begun(walk, 5000)
    page.goto(walk.base)
    hello(page)
    link, pill = page.locator("#link"), page.locator("#collectors")
    expect(link).to_have_text("live")
    expect(pill).to_have_text("collectors 1/1")
    page.route(COLLECTORS, lambda route: route.fulfill(status=503, json=BUSY))
    expect(pill).to_have_text("collectors ?")
    expect(link).to_have_text("live")
    page.unroute(COLLECTORS)
    expect(pill).to_have_text("collectors 1/1")
    check(page.evaluate("streams.events.length") == 1, "a daemon that is busy is not gone: its streams stay")
    check(walk.faults and all("503" in fault for fault in walk.faults), f"it said so: {walk.faults}")
    walk.faults.clear()

    page.evaluate("""async () => {
        const { stream } = await import("/js/api.js");
        for (const name of ["silent", "telling", "broken"]) stream(`/${name}`, { news() {} });
        streams.broken[0].readyState = EventSource.CONNECTING;
        setInterval(() => say("telling", "news"), 20);
        window.hurried = true;
    }""")
    page.route(COLLECTORS, lambda route: None)
    expect(link).to_have_text("no connection: what is shown is old")
    check(page.evaluate("(say('events', 'alarm'), document.querySelector('#link').textContent)") == "live", "where news come there is a connection")
    expect(link).to_have_text("no connection: what is shown is old")
    page.evaluate("window.hurried = false")
    page.unroute(COLLECTORS)
    page.wait_for_function("() => streams.events.length === 2 && streams.silent.length === 2")
    hello(page)
    expect(link).to_have_text("live")
    count = page.evaluate("Object.fromEntries(Object.entries(streams).map(([name, all]) => [name, all.map((own) => own.readyState)]))")
    check(count == {"events": [2, 1], "silent": [2, 1], "telling": [1], "broken": [0]}, f"what was silent is opened anew, what told something or opens itself is not: {count}")


def patience(walk):
    """What is not answered is not asked again meanwhile."""
    page = begun(walk, 5000)
    held = []
    page.route(HEALTH, lambda route: held.append(route))
    page.goto(walk.base)
    for _ in range(3):
        with page.expect_response(COLLECTORS):
            pass
    check(len(held) == 1, f"one question at a time: {len(held)}")


def ages(walk):
    """Values that are old, a source whose clock is hours behind, one that stands still and one that is gone."""
    page = begun(walk, 30000)
    now = plant_time(walk)
    stamps = range(now - 7800, now - 7200, 2)
    told = {"op": 1, "pv": 1, "sp": 1}

    def change(answer):
        answer["values"] = [{"tag": name, "value": 41.0, "unit": "%", "time": rfc3339(now - 7200), "age_s": age, "quality": "good"} for name, age in told.items()]

    patch(page, DETAIL, change)
    page.route(SAMPLES, lambda route: answer_samples(route, [column(name, stamps, [41.0] * len(stamps)) for name in told]))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    op, pv, sp = (page.locator(f"[aria-label='Latest values'] [data-tag={name}]") for name in told)
    live = page.locator(".trend")

    def says(*texts):
        for shown, text in zip((op, pv, sp), texts):
            expect(shown).to_have_text(text)

    says("OP41 %", "PV41 %", "SP41 %")
    expect(pv).not_to_have_class("bad")
    expect(live).to_have_attribute("data-newest", str(stamps[-1]))
    page.evaluate("(tags) => say('live', 'samples', tags)", [tag("pv", now - 7199, 42.0)])
    says("OP41 %", "PV42 %", "SP41 %")
    expect(pv).not_to_have_class("bad")
    print("ok: what has just come is new, though it is stamped two hours ago")

    with page.expect_response(DETAIL):
        page.evaluate("window.ahead = 200_000")
    says("OP41 %", "PV41 %", "SP41 %")
    expect(pv).not_to_have_class("bad")
    print("ok: where nothing comes the daemon is asked, and knows that the value still holds")

    told.update(op=900, pv=900, sp=900)
    with page.expect_response(DETAIL):
        page.evaluate("window.ahead = 400_000")
    says(*(re.compile(rf"^{name}41 % [\d.]+ min ago$") for name in ("OP", "PV", "SP")))
    expect(pv).to_have_class("bad")
    print("ok: or that nobody knows")

    told.update(op=700, pv=600, sp=3600)
    page.reload()
    says("OP41 % 12 min ago", "PV41 % 10 min ago", "SP41 % 60 min ago")
    expect(pv).to_have_class("bad")
    expect(op).to_have_class("bad")
    expect(sp).not_to_have_class("bad")
    print("ok: a value that is old says how old, and a PV that is old is not good")


def full(walk):
    """A trend that has grown too long, and a daemon that is too busy to send it anew."""
    page = begun(walk)
    newest = plant_time(walk)
    times = range(newest - 600, newest + 1, 2)
    asked, busy = [], []

    def samples(route):
        asked.append(route.request.url)
        if busy:
            route.fulfill(status=503, json=BUSY)
        else:
            answer_samples(route, [column(name, times, [41.0] * len(times)) for name in ("op", "pv")])

    page.route(SAMPLES, samples)
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    until(page, lambda: len(asked) == 2, "everything is fetched, and then what the window shows")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-points", str(len(times)))
    busy.append(True)
    many = [newest + 1 + k / 1000 for k in range(12_100)]
    with page.expect_response(lambda answer: SAMPLES.search(answer.url) and answer.status == 503):
        page.evaluate("""([many, next]) => {
            say("live", "samples", [many]);
            window.said = 0;
            setInterval(() => ((said += 1), say("live", "samples", [{ ...next, time: [new Date(Date.parse(next.time[0]) + 1000 * said).toISOString()] }])), 50);
        }""", [column("op", many, [41.0] * len(many)), tag("op", newest + 20, 41.0)])
    page.wait_for_function("(before) => said > before + 5", arg=page.evaluate("said"))
    check(len(asked) == 3, f"while it waits to ask again, what arrives asks for nothing: {len(asked)}")
    busy.clear()
    with page.expect_response(lambda answer: SAMPLES.search(answer.url) and answer.ok):
        pass
    expect(frame).to_have_attribute("data-points", re.compile(r"^\d{3}$"))
    check(len(asked) == 4, f"then it is asked for once: {len(asked)}")
    refused(walk, "what was refused has come")


def old_tiles(walk):
    """How old a verdict is grows, also where nothing else changes; and a plant that is held whole."""
    page = walk.open(1440, 900)
    # As while a loop is added.
    patch(page, LIST, lambda answer: answer.update(total=answer["total"] + 1))
    page.goto(walk.base)
    expect(page.locator("#link")).to_have_text("live")
    expect(page.locator(".summary")).to_have_text("20 loops")
    print("ok: a small plant is held whole")
    last = page.evaluate("""async () => {
        const { noted } = await import("/js/live.js"), { tileOf } = await import("/js/tiles.js");
        const item = { id: "X", description: "", group: "", verdict: null, alarm: "normal", time: "2026-01-01T00:00:00Z", period_s: 600 };
        return ["01:00", "01:31"].map((time) => {
            noted(`2026-01-01T${time}:00Z`);
            return tileOf(item).title.split("\\n").at(-1);
        });
    }""")
    check(last == [f"that is {age} min ago: it should have been diagnosed again" for age in (60, 91)], f"a tile says how old its verdict is by now: {last}")


def pages(walk):
    """A list that is longer than what the server hands out at a time."""
    page = walk.open(1440, 900)
    total = 2500

    def listed(route):
        query = parse_qs(urlsplit(route.request.url).query)
        begins, limit = (int(query.get(name, ["0"])[0]) for name in ("after", "limit"))
        ends = min(begins + limit, total)
        items = [{"id": f"L{at}", "description": "", "group": "", "verdict": None, "alarm": "normal", "f": None, "time": None, "age_s": None, "period_s": 60, "severity": 0} for at in range(begins, ends)]
        route.fulfill(json={"time": "2026-01-01T00:00:00Z", "total": total, "items": items, "next": str(ends) if ends < total else None})

    page.route(LIST, listed)
    page.goto(f"{walk.base}/#/fleet")
    shown, more = page.locator("section[aria-label=Loops] .summary"), page.get_by_role("button", name="More", exact=True)
    for count in [*range(50, 1001, 50), 2000]:
        expect(shown).to_have_text(f"{count} of {total} loops, worst first")
        more.click()
    expect(shown).to_have_text(f"{total} of {total} loops, worst first")
    expect(more).to_be_hidden()
    print("ok: More shows more, also past what is handed out at a time")


def grown(walk):
    """A trend that has been open for an hour: its ring has begun anew since."""
    page = begun(walk)
    newest = plant_time(walk)
    times = list(range(newest - 600, newest + 1, 2))
    page.route(SAMPLES, lambda route: answer_samples(route, [column(name, times, [41.0] * len(times)) for name in ("op", "pv")]))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-newest", str(newest))
    times[:] = range(newest + 3000, newest + 3601, 2)
    page.evaluate("(tags) => say('live', 'samples', tags)", [tag(name, newest + 3600, 42.0) for name in ("op", "pv")])
    expect(frame).to_have_attribute("data-newest", str(newest + 3600))
    page.get_by_role("button", name="Everything that is remembered").click()
    expect(frame).to_have_attribute("data-from", str(newest + 3000))
    expect(frame).to_have_attribute("data-to", str(newest + 3600))
    print("ok: everything that is remembered is what is remembered now")


def units(walk):
    """OP and a measured stem in units of their own, over one axis."""
    page = begun(walk)
    page.add_init_script("""(() => {
        const canvas = CanvasRenderingContext2D.prototype, write = canvas.fillText;
        window.written = new Set();
        canvas.fillText = function (text, ...at) {
            window.written.add(text);
            return write.call(this, text, ...at);
        };
    })()""")
    newest = plant_time(walk)
    times = range(newest - 600, newest + 1, 2)
    own = [column(name, times, [12.0] * len(times), unit=unit) for name, unit in (("pv", "%"), ("sp", "%"), ("op", "mA"), ("mv", "mm"))]
    page.route(SAMPLES, lambda route: answer_samples(route, own))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    page.wait_for_function("() => written.has('PV, SP [%]') && written.has('OP [mA], MV [mm]')")
    print("ok: an axis has the unit of each of its tags")


def keys(walk):
    """Keys with Alt, Ctrl and Meta are the browser's: a page back, all larger, the address."""
    page = begun(walk)
    newest = plant_time(walk)
    page.route(SAMPLES, lambda route: answer_samples(route, [column(name, range(newest - 600, newest + 1, 2), [41.0] * 301) for name in ("op", "pv")]))
    page.goto(walk.base)
    hello(page)
    taken = """(selector) => [{}, { altKey: true }, { ctrlKey: true }, { metaKey: true }].map((keys) =>
        !document.querySelector(selector).dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true, cancelable: true, ...keys })))"""
    expect(page.locator(".tile")).to_have_count(20)
    check(page.evaluate(taken, ".tile") == [True, False, False, False], "tiles take arrow keys alone")
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    expect(page.locator(".trend")).to_have_attribute("data-newest", str(newest))
    check(page.evaluate(taken, ".trend") == [True, False, False, False], "and so does a trend")


def term(walk):
    """A term of write-back that changes while nothing else does."""
    page = begun(walk, 5000)
    view = {"state": "active", "since": "2026-01-01T00:00:00Z", "term_percent": 0.0, "in_force_percent": 0.0, "denials": [], "tripped_by": None, "grant": None, "baseline_s": None, "effect": None}
    patch(page, DETAIL, lambda answer: answer.update(writeback=view))
    page.route(TERM, lambda route: route.fulfill(json={**view, "in_force_percent": 1.25}))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    expect(page.locator("section[aria-label=Write-back] dl")).to_contain_text("in force1.25 %")
    print("ok: the term that is shown is the one in force now")


def pressed_twice(walk):
    """A button that is pressed again before the daemon has answered."""
    page = begun(walk)
    held = []
    page.route(re.compile(rf"/api/v1/alarms/{LOOP}/ack$"), lambda route: held.append(route))
    page.goto(f"{walk.base}/#/loop/{LOOP}")
    page.get_by_role("button", name="Acknowledge").click()
    page.get_by_label("Your name").fill("M. Keller")
    page.keyboard.press("Enter")
    until(page, lambda: len(held) == 1, "it is asked for")
    page.keyboard.press("Enter")
    # What was asked before has been seen by then.
    page.evaluate("fetch('/api/v1/healthz').then((answer) => answer.text())")
    check(len(held) == 1, f"what waits for its answer is not asked for again: {len(held)}")
    held.pop().fulfill(json={"survives_restart": True})
    expect(page.get_by_role("dialog")).to_have_count(0)


def reading(walk):
    """Alarms and work that somebody reads while other loops are diagnosed, and alarms that are refused once."""
    page = begun(walk, 5000, 15000)
    asked, answered = [], []
    page.goto(f"{walk.base}/#/alarms")
    hello(page)
    row = page.locator(f"tr[data-id={LOOP}]")
    expect(row).to_contain_text("feed to column 0")

    def diagnosed(loop):
        with page.expect_response(re.compile(rf"/api/v1/loops/{loop}$")):
            page.evaluate("(loop) => say('events', 'diagnosis', { loop })", loop)

    diagnosed("FIC00005")
    diagnosed("FIC00009")
    page.on("request", lambda request: asked.append(request.url) if ALARMS.search(request.url) else None)
    diagnosed("FIC00006")
    diagnosed("FIC00007")
    check(not asked, f"diagnoses of loops without an alarm ask for no alarms: {asked}")
    row.locator("a").focus()
    page.evaluate("(row) => void (document.querySelector(row).kept = true)", f"tr[data-id={LOOP}]")
    with page.expect_response(ALARMS):
        page.evaluate("(loop) => say('events', 'alarm', { loop })", LOOP)
    diagnosed("FIC00008")
    check(page.evaluate("(row) => document.querySelector(row).kept === true && document.activeElement.matches(`${row} a`)", f"tr[data-id={LOOP}]"), "alarms that are the same stay in the document")
    patch(page, ALARMS, lambda answer: [item.update(detail="changed meanwhile") for item in answer["items"]])
    page.evaluate("(loop) => say('events', 'alarm', { loop })", LOOP)
    expect(row).to_contain_text("changed meanwhile")
    check(page.evaluate("(row) => document.activeElement.matches(`${row} a`)", f"tr[data-id={LOOP}]"), "what has the focus keeps it when its row changes")
    page.on("response", lambda answer: answered.append(answer.status) if ALARMS.search(answer.url) else None)
    refuse_once(page, ALARMS)
    page.evaluate("say('events', 'alarm')")
    until(page, lambda: 503 in answered and answered[-1] == 200, "what was refused comes")
    refused(walk, "alarms that were refused are asked for again")

    item = {"id": LOOP, "part": "first", "state": "open", "since": None, "first": None, "cause": "valve", "probability": 0.9, "why": "it sticks", "victims": [f"FIC{at:05}" for at in range(1, 9)], "cost": None, "cost_unit": None, "by": None, "note": None, "reopened": 0, "before": None, "after": None}
    page.route(WORK, lambda route: route.fulfill(json={"time": None, "standing": 1, "unknown": 0, "watched": 0, "items": [item]}))
    page.goto(f"{walk.base}/#/work")
    page.locator("tbody summary").click()
    for _ in range(2):
        with page.expect_response(WORK):
            pass
    check(page.locator("tbody details[open]").count() == 1, "work that is the same stays in the document")
    page.locator("tbody a").first.focus()
    item.update(why="it sticks more")
    expect(page.locator("tbody tr[data-id]")).to_contain_text("it sticks more")
    check(page.evaluate("document.activeElement.getAttribute('href')") == f"#/loop/{LOOP}", "and what has the focus keeps it when it changes")


def summer_time(walk):
    """Days on an axis on either side of a change to summer time, and from it."""
    page = walk.open(1440, 900, zone="Europe/Berlin")
    page.goto(walk.base)
    found = page.evaluate("""async () => {
        const { plot } = await import("/js/svg.js"), box = document.createElement("div");
        document.body.append(box);
        return [["2026-03-25", "2026-04-02"], ["2026-10-21", "2026-10-29"]].map(([from, to]) => {
            const range = [from, to].map((day) => new Date(`${day}T12:00:00`).getTime()), days = [];
            for (const day = new Date(`${from}T00:00:00`); day.setDate(day.getDate() + 1) < range[1]; ) days.push(day.getTime());
            const made = plot(box, [{ kind: "points", class: "pv", size: 1, x: days, y: days.map(() => 0.5) }], { x: { time: true, range, label: "" }, y: { range: [0, 1], label: "" } });
            const ticks = [...made.querySelectorAll("text")].filter((own) => /^[0-9]{2}-[0-9]{2}$/.test(own.textContent)), midnights = [...made.querySelectorAll("circle")];
            return { texts: ticks.map((own) => own.textContent), off: ticks.map((own, i) => Math.abs(own.getAttribute("x") - midnights[i].getAttribute("cx"))) };
        });
    }""")
    texts = [own["texts"] for own in found]
    check(texts[0] == [*(f"03-{day}" for day in range(26, 32)), "04-01", "04-02"] and texts[1] == [f"10-{day}" for day in range(22, 30)], f"each day has its date: {texts}")
    check(max(max(own["off"]) for own in found) < 0.1, f"where it begins: {found}")


small = [lines, parted, changes, busy, patience, ages, full, old_tiles, pages, grown, units, keys, term, pressed_twice, reading, summer_time]
