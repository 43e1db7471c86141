"""What the page does where something is not as usual: a daemon that is busy, a value that is bad, a clock that was set back."""

import json
import re
from datetime import datetime, timezone
from urllib.parse import parse_qs, quote, urlsplit

from playwright.sync_api import expect

from walk import check

BUSY = {"type": "urn:stictiond:problem:busy", "detail": "too much at once"}
SAMPLES = re.compile(r"/api/v1/loops/FIC102/samples\?")
HEALTH = "**/api/v1/healthz"
COLLECTORS = re.compile(r"/api/v1/collectors")

# Live samples come from the test alone, which hands them to the newest stream by `say`. What is written on canvas is kept.
SCRIPT = """(() => {
    const Real = window.EventSource, canvas = CanvasRenderingContext2D.prototype, write = canvas.fillText;
    window.streams = [];
    window.written = new Set();
    canvas.fillText = function (text, ...at) {
        window.written.add(text);
        return write.call(this, text, ...at);
    };
    window.EventSource = Object.assign(function (url) {
        if (!url.endsWith("/live")) return new Real(url);
        const own = Object.assign(new EventTarget(), { readyState: 1, close() { this.readyState = 2; } });
        window.streams.push(own);
        return own;
    }, { OPEN: 1, CLOSED: 2 });
    window.say = (data, name = "samples") => void window.streams.at(-1).dispatchEvent(new MessageEvent(name, { data: JSON.stringify(data) }));
})()"""


def quick(page, *waits):
    """What is done after or every so long (ms) is done after a fifth of a second."""
    page.add_init_script(f"""for (const name of ["setTimeout", "setInterval"]) {{
        const real = window[name];
        window[name] = (act, wait, ...more) => real(act, {json.dumps(waits)}.includes(wait) ? 200 : wait, ...more);
    }}""")


def patch(page, pattern, change):
    """Changes the JSON of an answer on its way."""
    def patched(route):
        answer = route.fetch().json()
        change(answer)
        route.fulfill(json=answer)

    page.route(pattern, patched)


def instead(walk, pattern, path, change):
    """Answers with what there is at a path, changed once: what is asked for every fifth of a second."""
    answer = walk.page.request.get(f"{walk.base}/api/v1/{path}").json()
    change(answer)
    walk.page.route(pattern, lambda route: route.fulfill(json=answer))


def refuse(page, pattern, times):
    page.route(pattern, lambda route: route.fulfill(status=503, json=BUSY), times=times)


def refuse_once(page, pattern):
    refuse(page, pattern, 1)


def refused(walk, what):
    """The browser itself reports the one answer that was refused."""
    check(len(walk.faults) == 1 and "503" in walk.faults[0], what)
    walk.faults.clear()


def changes(walk):
    """A change whose fetch fails, and one of a loop that was not among those held."""
    page = walk.open(1440, 900)
    walk.go()
    tile = page.locator(".tile[data-id=FIC103]")
    expect(tile).to_have_attribute("data-kind", "waiting")
    expect(page.locator("#link")).to_have_text("live")
    refuse_once(page, re.compile(r"/api/v1/loops/FIC103$"))
    diagnose = f"{walk.base}/api/v1/loops/FIC103/diagnosis?wait_s=0"
    page.request.post(diagnose)
    expect(tile).to_have_attribute("data-kind", "unacknowledged", timeout=60_000)
    refused(walk, "a change whose fetch failed is asked for again")
    check("diagnosed 2026-01-01 " in tile.get_attribute("title"), "a tile says when its loop was diagnosed")
    expect(page.locator("#alarm-count")).to_have_text("4")

    def without(route):
        answer = route.fetch().json()
        answer["items"] = [item for item in answer["items"] if item["id"] != "FIC103"]
        route.fulfill(json=answer)

    page.route(re.compile(r"/api/v1/loops\?"), without)
    page.reload()
    expect(page.locator(".tile")).to_have_count(5)
    expect(page.locator("#link")).to_have_text("live")
    page.request.post(diagnose)
    expect(tile).to_have_attribute("data-kind", "unacknowledged", timeout=60_000)
    print("ok: a loop that was not held comes with its alarm")


def rfc3339(t):
    return datetime.fromtimestamp(t, timezone.utc).isoformat().replace("+00:00", "Z")


def column(name, times, values, **more):
    """The samples of a tag as the API has them."""
    return {"tag": name, "unit": "%", "found": len(times), "before": None, "by_changes": False, "time": [rfc3339(t) for t in times], "value": values, "quality": ["good"] * len(times), **more}


def tag(name, t, value, quality="good"):
    return column(name, [t], [value], quality=[quality])


def plant_time(walk):
    told = walk.page.request.get(f"{walk.base}/api/v1/healthz").json()["time"]
    return int(datetime.fromisoformat(f"{told[:19]}+00:00").timestamp())


def live(walk):
    """The first samples are refused; then a value gets bad, and the clock is set back."""
    page = walk.open(1440, 1000)
    page.add_init_script(SCRIPT)
    quick(page, 30000)
    refuse_once(page, SAMPLES)
    with page.expect_request(re.compile(r"/alarms/history\?.*kind=stiction")):
        page.goto(f"{walk.base}/#/loop/FIC102")
    expect(page.get_by_text("The trends cannot be fetched")).to_be_visible()
    expect(page.locator(".verdict strong")).to_contain_text("The valve sticks")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-newest", re.compile(r"^\d+"))
    expect(page.locator(".verdict strong")).to_contain_text("The valve sticks")
    check(page.evaluate("streams.map((own) => own.readyState)") == [2, 1], "of a trend that failed no stream is left")
    refused(walk, "a trend whose first samples were refused is begun again")

    age = page.locator(".verdict p span[title]")
    check(re.fullmatch(r"2026-01-01 \d\d:\d\d:\d\d", age.get_attribute("title")), "when it was diagnosed is told")
    expect(age).not_to_have_text(age.text_content())
    print("ok: how long ago that is grows")

    def say(*tags):
        page.evaluate("(tags) => say(tags)", tags)

    newest = max(int(float(frame.get_attribute("data-newest"))), plant_time(walk))
    op = page.locator("[aria-label='Latest values'] [data-tag=op]")
    say(tag("op", newest + 2, None, "bad:timeout"))
    expect(op).to_have_class("bad")
    expect(op).to_contain_text("– % bad:timeout")
    say(tag("op", newest + 4, 42.0))
    expect(op).not_to_have_class("bad")
    expect(op).to_have_text("OP42 %")
    expect(frame).to_have_attribute("data-newest", str(newest + 4))
    print("ok: a value is shown with its own quality")

    then = newest - 600
    since = [tag(name, then, 41.0) for name in ("op", "pv", "sp")]
    page.route(SAMPLES, lambda route: answer_samples(route, since))
    say(*since)
    expect(frame).to_have_attribute("data-newest", str(then))
    say(tag("op", then + 2, 43.0))
    expect(frame).to_have_attribute("data-newest", str(then + 2))
    print("ok: the trend goes on where the clock was set back to")
    pv = page.locator("[aria-label='Latest values'] [data-tag=pv]")
    expect(pv).to_have_text("PV41 %")
    expect(pv).not_to_have_class("bad")
    print("ok: what comes is new, whatever its stamp says")


def answer_samples(route, tags):
    route.fulfill(json={"loop": "FIC102", "from": None, "to": None, "tags": tags})


def reads(page, t, pattern, what):
    """What the trend says of a time (s). The mouse is moved again and again: an answer is drawn some time after it has come."""
    frame, box = page.locator(".trend"), page.locator(".u-over").first.bounding_box()
    for turn in range(100):
        begins, ends = (float(frame.get_attribute(f"data-{name}")) for name in ("from", "to"))
        page.mouse.move(box["x"] + box["width"] * (t - begins) / (ends - begins), box["y"] + 40 + turn % 2)
        said = page.locator("#trend p.note").text_content()
        if re.search(pattern, said):
            break
        page.wait_for_timeout(100)
    check(re.search(pattern, said), f"{what}: {said}")


def lines(walk):
    """A set point that did not change in what is shown, a silence, a stream that says nothing any more, and a fetch that fails after it."""
    page = walk.open(1440, 1000)
    page.add_init_script(SCRIPT)
    quick(page, 5000)
    newest = plant_time(walk)
    first = newest - 600
    times = [t for t in range(first, newest + 1, 2) if not first + 200 < t < first + 400]

    def samples(route):
        of = {name: column(name, times, [40.0 + (t // 2) % 2 for t in times]) for name in ("op", "pv")}
        held = {"time": rfc3339(first - 4000), "value": 50.0, "quality": "good"}
        sp = column("sp", [], [], before=held, by_changes=True) if "from=" in route.request.url else column("sp", [first], [50.0], by_changes=True)
        answer_samples(route, [*of.values(), sp])

    page.route(SAMPLES, samples)
    page.goto(f"{walk.base}/#/loop/FIC102")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-newest", str(newest))
    page.wait_for_function("() => { const { newest, to } = document.querySelector('.trend').dataset; return Number(to) > Number(newest) + 20 }")
    page.wait_for_function("() => written.has('01-01')")
    print("ok: what is followed ends now though nothing arrives, and its axis has a date")

    with page.expect_response(SAMPLES):
        page.get_by_role("button", name="Everything that is remembered").click()
    expect(frame).to_have_attribute("data-from", str(first))
    expect(frame).to_have_attribute("data-to", str(newest))
    reads(page, first + 100, r"^2026-01-01 .*PV 4[01] %.*SP 50 %.*OP 4[01] %", "a set point that did not change is known")
    reads(page, first + 300, r"PV –.*SP –.*OP –", "in a silence nothing is")
    reads(page, first + 500, r"PV 4[01] %.*SP 50 %.*OP 4[01] %", "after it the set point is known again")

    with page.expect_response(SAMPLES):
        page.get_by_role("button", name="Live", exact=True).click()
    page.evaluate("say({}, 'hello')")
    refuse_once(page, SAMPLES)
    with page.expect_response(lambda answer: SAMPLES.search(answer.url) and answer.ok):
        page.evaluate("say({}, 'hello')")
    refused(walk, "what was missed is asked for again where its fetch failed")
    many = [newest + 1 + k / 1000 for k in range(12_100)]
    times[:] = [newest - 400 + k / 4 for k in range(1600)]
    with page.expect_response(SAMPLES) as fetched:
        page.evaluate("""(tags) => {
            let k = 0;
            const next = (own) => ({ ...own, time: [new Date(Date.parse(own.time.at(-1)) + 1000 * k).toISOString()], value: [41], quality: ["good"] });
            say(tags);
            setInterval(() => ((k += 1), say(tags.map(next))), 100);
        }""", [column("op", many, [41.0] * len(many))])
    expect(frame).to_have_attribute("data-points", re.compile(r"^1[6-9]\d\d$"))
    begins = parse_qs(urlsplit(fetched.value.url).query)["from"][0]
    begins = datetime.fromisoformat(begins.replace("Z", "+00:00")).timestamp()
    shown = float(frame.get_attribute("data-from"))
    check(begins <= shown, f"what has grown too long is fetched anew, from where the window begins: {begins} of {shown}")


def answers(walk):
    """What is no answer of the daemon, a stream that is refused, a host that says nothing, and a part of the page that does not come."""
    page = walk.open(1440, 1000)
    quick(page, 5000)
    page.add_init_script("(() => { const real = AbortSignal.timeout.bind(AbortSignal); AbortSignal.timeout = (wait) => real(window.hurried && wait === 10000 ? 500 : wait); })()")
    proxied = []

    def bad_gateway(route):
        proxied.append(route.request.url)
        if len(proxied) > 10:
            return route.continue_()
        route.fulfill(status=502, content_type="text/html", body="<html>Bad Gateway</html>")

    page.route(re.compile(r"/api/v1/loops/FIC102$"), bad_gateway)
    refuse_once(page, re.compile(r"/api/v1/loops/FIC102/live$"))
    page.goto(f"{walk.base}/#/loop/FIC102")
    expect(page.get_by_text("the daemon does not answer: 502")).to_be_visible()
    expect(page.locator(".verdict strong")).to_contain_text("The valve sticks")
    print("ok: a proxy's page is no answer, and the loop is asked for again")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-newest", re.compile(r"^\d+"))
    page.wait_for_function("(t) => Number(document.querySelector('.trend').dataset.newest) > t + 20", arg=float(frame.get_attribute("data-newest")))
    check(all("502" in fault or "503" in fault for fault in walk.faults), f"a stream that was refused is opened again: {walk.faults}")
    walk.faults.clear()

    expect(page.locator("#link")).to_have_text("live")
    page.evaluate("window.hurried = true")
    page.route(COLLECTORS, lambda route: None)
    expect(page.locator("#link")).to_have_text("no connection: what is shown is old")
    expect(page.locator("#collectors")).to_have_text("collectors ?")
    page.evaluate("window.hurried = false")
    page.unroute(COLLECTORS)
    expect(page.locator("#link")).to_have_text("live")
    expect(page.locator("#collectors")).to_have_text("collectors 1/1")
    print("ok: a host that says nothing is told, and so is that it is back")

    instead(walk, COLLECTORS, "collectors", lambda answer: answer["items"][0].update(down=True))
    expect(page.locator("#collectors")).to_have_text("collectors 0/1")
    expect(page.locator("#collectors")).to_have_class(re.compile(r"\bbad\b"))
    refuse_once(page, re.compile(r"/js/settings\.js$"))
    refuse(page, re.compile(r"/api/v1/session$"), 10)
    page.keyboard.press("s")
    expect(page.locator("#toast")).to_contain_text("this part of the page cannot be fetched")
    expect(page.locator("main h1")).to_have_text("Settings")
    expect(page.locator("section[aria-label=Collectors] tbody tr")).to_contain_text("no good sample")
    check(all("503" in fault for fault in walk.faults), f"a part of the page that did not come is fetched again; a device that says nothing is not up: {walk.faults}")
    walk.faults.clear()


def away(walk):
    """What happened while the page was out of sight, and what no page of the list had."""
    page = walk.open(1440, 1000)
    hide = "(hidden) => { Object.defineProperty(document, 'hidden', { configurable: true, get: () => hidden }); document.dispatchEvent(new Event('visibilitychange')); }"
    walk.go("loop/FIC102")
    verdict = page.locator(".verdict")
    expect(verdict).to_have_attribute("data-kind", "unacknowledged")
    expect(page.locator("#link")).to_have_text("live")
    page.evaluate(hide, True)
    check(page.request.post(f"{walk.base}/api/v1/alarms/FIC102/ack").ok, "somebody else acknowledges the alarm")
    page.evaluate(hide, False)
    expect(verdict).to_have_attribute("data-kind", "acknowledged")
    print("ok: a loop's page that was out of sight shows what has changed meanwhile")

    listed = page.request.get(f"{walk.base}/api/v1/loops").json()["items"]
    sound = next(item["id"] for item in listed if item["severity"] == 0)

    def change(answer):
        answer["items"] = [item for item in answer["items"] if item["id"] != sound]
        answer["items"][0]["time"] = "2025-12-01T00:00:00Z"

    patch(page, re.compile(r"/api/v1/loops\?"), change)
    walk.go()
    tiles = page.locator(".tile")
    expect(tiles).to_have_count(5)
    old = page.locator(".tile[data-old]")
    expect(old).to_have_count(1)
    expect(old.locator(".tag")).to_contain_text("OLD")
    check("d ago: it should have been diagnosed again" in old.get_attribute("title"), "a tile says that its verdict is old, and how old")
    expect(page.locator("#link")).to_have_text("live")
    alarm = f"{walk.base}/api/v1/alarms/{quote(sound, safe='')}"
    check(page.request.post(f"{alarm}/out-of-service", data={"by": "a test", "comment": "none"}).ok, "the alarm of a sound loop is taken out of service")
    expect(tiles).to_have_count(6)
    check(page.request.post(f"{alarm}/in-service").ok, "and given back")
    print("ok: a sound loop that no page of the list had comes with its change")


def other_unit(walk):
    """Diagnoses of before the span was known, and times without a date."""
    page = walk.open(1440, 1000)

    def change(answer):
        answer["items"].append({**answer["items"][0], "f": 40.0, "f_ci95": [38.0, 42.0], "f_unit": "OP units", "outcome": "stiction"})

    patch(page, re.compile(r"/api/v1/loops/FIC102/diagnoses\?"), change)
    walk.go("loop/FIC102")
    expect(page.locator("#months .note")).to_have_text("One diagnosis has f in OP units and is not drawn.")
    expect(page.locator("#months .dot")).to_have_count(len(page.request.get(f"{walk.base}/api/v1/loops/FIC102/diagnoses").json()["items"]))
    expect(page.locator("section[aria-label='Latest diagnoses'] tbody tr").last).to_contain_text("40 OP units")
    texts = page.locator("#months text").all_text_contents()
    check(any(re.match(r"01-01", text) for text in texts), f"the axis of f over time has a date: {texts}")

    page = walk.open(1440, 1000)
    patch(page, re.compile(r"/api/v1/loops/FIC102/diagnoses\?"), lambda answer: [item.update(f_unit="OP units") for item in answer["items"]])
    walk.go("loop/FIC102")
    expect(page.locator("#months")).to_contain_text(re.compile(r"(One diagnosis has|\d diagnoses have) f in OP units and (is|are) not drawn\."))
    expect(page.locator("#months")).not_to_contain_text("No diagnosis yet.")
    expect(page.locator("#months svg")).to_have_count(0)


def shelving(walk):
    """No more is offered than is allowed."""
    page = walk.open(1440, 1000)
    patch(page, re.compile(r"/api/v1/system$"), lambda answer: answer.update(max_shelve_s=7200))
    walk.go("loop/FIC102")
    page.get_by_role("button", name="Shelve …").click()
    dialog = page.get_by_role("dialog")
    choice = dialog.locator("select")
    expect(choice.locator("option")).to_have_text(["1 hour", "until its condition goes, at most 2 h"])
    choice.select_option("once")
    dialog.get_by_label("Your name").fill("M. Keller")
    dialog.get_by_label("Reason").fill("until it is gone")
    with page.expect_request(re.compile(r"/alarms/FIC102/shelve$")) as asked:
        dialog.get_by_role("button", name="Shelve", exact=True).click()
    check(asked.value.post_data_json == {"by": "M. Keller", "comment": "until it is gone", "duration_s": 7200, "one_shot": True}, "an alarm is shelved once, for no longer than is allowed")
    expect(page.locator(".verdict")).to_have_attribute("data-kind", "shelved")


def groups(walk):
    """Groups whose fetch failed once, and a group that another look numbers anew."""
    page = walk.open(1440, 1000)
    quick(page, 15000)
    look = {"time": "2026-01-01T01:00:00Z", "took_s": 1, "looked_at": 6, "skipped": [], "items": [group(1, "AB")]}
    page.route(re.compile(r"/api/v1/groups$"), lambda route: route.fulfill(json=look))
    page.route(re.compile(r"/api/v1/groups/\d+$"), lambda route: route.fulfill(json={"time": look["time"], "pictures": [], **next(own for own in look["items"] if route.request.url.endswith(f"/{own['number']}"))}))
    page.goto(f"{walk.base}/#/groups")
    summary = page.locator(".summary")
    expect(summary).to_contain_text("1 group, by a look at 6 loops")
    refuse(page, re.compile(r"/api/v1/groups$"), 10)
    expect(summary).to_contain_text("the groups cannot be fetched")
    expect(summary).to_contain_text("1 group, by a look at 6 loops")
    check(len(walk.faults) == 10 and all("503" in fault for fault in walk.faults), "what failed is not said any more once the groups are there")
    walk.faults.clear()

    page.goto(f"{walk.base}/#/groups/1")
    expect(page.locator("main .card").first).to_contain_text("A, B")
    look.update(time="2026-01-01T02:00:00Z", items=[group(1, "XY"), group(2, "ABCD")])
    expect(page.locator("main h1")).to_have_text("Group 2")
    expect(page.locator("main .card").first).to_contain_text("A, B, C, D")
    expect(page).to_have_url(re.compile(r"#/groups/2$"))
    look.update(time=None, items=[])
    for _ in range(3):
        with page.expect_response(re.compile(r"/api/v1/groups$")):
            pass
    check("4 loops swing together. Looked at " in summary.text_content(), "a daemon that was started again has not looked yet: what is shown stands")
    look.update(time="2026-01-01T03:00:00Z", items=[group(1, "XY")])
    expect(summary).to_contain_text("This group is not found any more")
    expect(page.locator("main .card").first).to_contain_text("A, B, C, D")
    print("ok: an open group stays the group of its loops")


def group(number, members):
    return {"number": number, "period_s": 40, "words": f"{len(members)} loops swing together.", "members": list(members), "suspects": []}


def colours(walk):
    """The colours change before the first samples are there."""
    page = walk.open(1440, 1000)
    held = []
    page.route(SAMPLES, lambda route: held.append(route))
    page.goto(f"{walk.base}/#/loop/FIC102")
    expect(page.locator("#trend .ranges")).to_be_visible()
    page.locator("#theme").click()
    for route in held:
        route.continue_()
    page.unroute(SAMPLES)
    expect(page.locator("#trend .u-cursor-pt")).to_have_count(3)
    print("ok: PV, SP and OP are drawn all the same")


def no_unit(walk):
    page = walk.open(1440, 900)
    walk.go("fleet?group=")
    only = page.get_by_role("button", name="only no unit")
    expect(page.get_by_text("No loop is like this.")).to_be_visible()
    only.click()
    expect(page.get_by_text("6 of 6 loops, worst first")).to_be_visible()
    expect(only).to_be_hidden()
    print("ok: loops without a unit are a choice of their own")


def list_again(walk):
    """The list of the fleet's page is refused once, and then changes."""
    page = walk.open(1440, 900)
    quick(page, 5000)
    refuse_once(page, re.compile(r"/api/v1/loops\?limit=50&q=fic"))
    page.goto(f"{walk.base}/#/fleet?q=fic")
    expect(page.get_by_text("4 of 4 loops, worst first")).to_be_visible()
    refused(walk, "a list that was refused is asked for again")
    instead(walk, re.compile(r"/api/v1/loops\?limit=50&q=fic"), "loops?limit=50&q=fic", lambda answer: answer["items"][0].update(description="changed meanwhile", time="2025-12-01T00:00:00Z"))
    first = page.locator("section[aria-label=Loops] tbody tr").first
    expect(first).to_contain_text("changed meanwhile")
    expect(first.locator(".bad")).to_contain_text("d ago")
    print("ok: the list changes with its loops, and says which diagnosis is old")


def store(walk):
    """A store that is damaged: what is said of it above every view, in both colours and on a phone; then it only fails, then it works."""
    for name, width, height, scheme in [("light", 1440, 900, "light"), ("dark", 1440, 900, "dark"), ("phone", 390, 844, "light")]:
        page = walk.open(width, height, scheme)
        for route in ("", "alarms"):
            walk.go(route)
            said = page.get_by_role("alert")
            expect(said).to_be_visible()
            expect(said).to_contain_text("The store is damaged: nothing is written to it.")
            expect(said).to_contain_text("page 7 of <img src=x onerror=alert(1)> is not what was written")
            expect(said).to_contain_text("3 records of alarms and models are lost.")
            expect(said).to_contain_text("stictiond store check --repair")
        check(page.locator("#store img").count() == 0, "what is said of the store is text")
        walk.axe(f"a damaged store, {name}")
        walk.shot(f"store-{name}")
        if width < 500:
            walk.fits("a damaged store on a phone")

    def answers(**other):
        def patched(route):
            answer = route.fetch().json()
            answer["store"].update(other)
            route.fulfill(json=answer)

        page.unroute(HEALTH)
        page.route(HEALTH, patched)

    answers(damaged=False, reason="the disk is full", lost_states=0)
    expect(said).to_contain_text("The store fails: nothing is written to it.")
    expect(said).to_contain_text("the disk is full")
    expect(said).to_contain_text("Check that its disk is there and has room")
    expect(said).not_to_contain_text("--repair")
    answers(state="working", damaged=False, reason=None, since=None, lost_states=0)
    expect(page.locator("#store")).to_be_hidden()
    print("ok: it goes when the store works again")

    def recorded(**audit):
        def patched(route):
            answer = route.fetch().json()
            answer["store"].update(state="working", damaged=False, reason=None, since=None, lost_states=0)
            answer["audit"] = audit
            route.fulfill(json=answer)

        page.unroute(HEALTH)
        page.route(HEALTH, patched)

    recorded(state="failing", damaged=True, reason="audit log <img src=x onerror=alert(1)>.3: line 2: changed")
    expect(said).to_contain_text("The audit log is damaged: changes are refused.")
    expect(said).to_contain_text("audit log <img src=x onerror=alert(1)>.3: line 2: changed")
    expect(said).to_contain_text("stictiond audit renew")
    check(page.locator("#record img").count() == 0, "what is said of the audit log is text")
    walk.axe("a damaged audit log")
    recorded(state="failing", damaged=False, reason="the disk is full")
    expect(said).to_contain_text("Changes are refused: they cannot be put on record.")
    expect(said).not_to_contain_text("renew")
    recorded(state="working", damaged=False, reason=None)
    expect(page.locator("#record")).to_be_hidden()
    page.unroute(HEALTH)
    print("ok: a damaged audit log is told until it works again")


def stem_unit(walk):
    """A measured stem whose unit is not that of OP."""
    page = walk.open(1440, 1000)
    patch(page, re.compile(r"/api/v1/loops/%3Cimg[^/]*$"), lambda answer: [own.update(unit="mm") for own in answer["values"] if own["tag"] == "mv"])
    page.goto(f"{walk.base}/#/loop/{quote('<img src=x onerror=alert(1)>', safe='')}")
    expect(page.locator("#stem svg").get_by_text("stem [%], MV [mm]")).to_be_visible()
    print("ok: an axis has the unit of each of what it shows")


def left(walk):
    """Charts of a page that is left, and opinions whose pictures are refused once."""
    page = walk.open(1440, 1000)
    page.add_init_script("""(() => {
        let library;
        window.charts = new Set();
        const construct = (made, given) => {
            const chart = new made(...given), destroy = chart.destroy;
            window.charts.add(chart);
            chart.destroy = () => (window.charts.delete(chart), destroy());
            return chart;
        };
        Object.defineProperty(window, "uPlot", { configurable: true, get: () => library, set: (made) => (library = new Proxy(made, { construct })) });
    })()""")
    walk.go("loop/FIC102")
    page.wait_for_function("() => charts.size === 4")
    print("ok: a trend, a position and a residual are drawn")
    opinion = page.locator("details[data-method=lee_2008]")
    refuse_once(page, re.compile(r"/opinions/lee_2008$"))
    opinion.locator("summary").click()
    expect(opinion.locator(".pictures")).to_have_text(BUSY["detail"])
    opinion.locator("summary").click()
    opinion.locator("summary").click()
    expect(opinion.locator("svg.plot").first).to_be_attached()
    refused(walk, "pictures that were refused are asked for when the line is opened again")
    page.locator("nav [data-view=plant]").click()
    expect(page.locator(".tile")).to_have_count(6)
    page.wait_for_function("() => charts.size === 0")
    print("ok: a page that is left keeps no chart")


trouble = [changes, live, lines, answers, away, other_unit, shelving, groups, colours, no_unit, list_again, stem_unit, left]
